"""Places at which a vehicle may close a loop: far back on its way, near in the map."""

import math

import numpy as np
from grid_worlds import drawn_world

from explore_slam.agent import AgentConfig
from explore_slam.data import Plan, VehicleBody
from explore_slam.geometry import Pose2
from explore_slam.settings import with_values
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.grid.grid_simulator import GridSimulator, GridSimulatorConfig
from explore_slam.studies.team_mapping import TeamSlam

RING = [
    '####################',
    *['#..................#'] * 4,
    *['#....##########....#'] * 5,
    *['#..................#'] * 4,
    '####################',
]  # 10 x 7 m
CORNERS = np.array([[8.5, 1.5], [8.5, 5.5], [1.5, 5.5], [1.5, 1.5]])  # 22 m round


def drive_round(ask):
    """Drive round and on to the second corner; return the team, and the places asked for then."""
    simulator = GridSimulator(
        drawn_world(RING), {'a': Pose2(1.5, 1.5, 0.0)}, GridSimulatorConfig(beams=91), seed=2
    )
    config = with_values(AgentConfig(), {'particles': 20, 'resolution': 0.1})
    team = TeamSlam(simulator, config, SimulatedOdometryConfig(), {'a': VehicleBody()}, 2)
    asked = []
    for corner in [*CORNERS, *CORNERS[:2]]:
        waypoints = np.array([simulator.true_pose('a')[:2], corner])
        simulator.set_plan('a', Plan(simulator.time, 'a', Pose2(*corner, 0.0), waypoints))
        for step in range(300):
            if simulator.is_idle('a'):
                break
            simulator.step()
            team.move()
            if step % 3 == 0:
                team.scan()
            if ask and step % 30 == 0:
                asked.append((len(asked), team.agent.known_places('a', 15.0)))
    return team, asked


def test_places_are_far_back_on_the_way_and_near_in_the_map_and_to_ask_for_them_changes_nothing():
    team, asked = drive_round(ask=True)
    numbers = [number for number, places in asked if places]
    assert numbers[0] > 0.6 * len(asked)  # 25 m of 33 m driven
    places = team.agent.known_places('a', 6.0)
    here = team.agent.map_pose('a')[:2]
    assert len(places) >= 2
    for place, deviation in places:
        assert math.dist(place, here) < 6.5
        assert 0.0 < deviation < 0.3
    apart = [math.dist(a.place, b.place) for a in places for b in places if a is not b]
    assert min(apart) >= 1.0
    assert len(team.agent.known_places('a', 15.0)) > len(places)

    other, _ = drive_round(ask=False)
    assert np.array_equal(other.agent.trajectory('a')[1], team.agent.trajectory('a')[1])
    assert other.map_rms() == team.map_rms()
