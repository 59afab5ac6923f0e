"""Scenarios of the grid simulator: what events do, and files that are refused."""

import math
import re

import numpy as np
import pytest
from grid_worlds import drawn_world

from explore_slam.data import Plan
from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.grid.grid_simulator import GridSimulator, GridSimulatorConfig
from explore_slam.simulation.grid.scenario import Event, Scenario, load_scenario
from explore_slam.simulation.worlds.grid_world import FREE, GLASS, SOLID

HALL = drawn_world(['################', *['#..............#'] * 4, '################'])  # 8 x 3 m
EXACT = GridSimulatorConfig(range_noise=0.0, beams=3, field_of_view=0.2)
START = {'robot1': Pose2(1.0, 1.5, 0.0)}


def simulate(*events, start=START):
    return GridSimulator(HALL, start, EXACT, scenario=Scenario(events))


def ahead(simulator):
    """Range (m) of the middle beam."""
    return float(simulator.scan('robot1').ranges[1])


def drive(simulator, seconds, x=6.5):
    goal = Pose2(x, 1.5, 0.0)
    points = np.array([[1.0, 1.5], [x, 1.5]])
    simulator.set_plan('robot1', Plan(simulator.time, 'robot1', goal, points))
    run(simulator, seconds)
    return simulator.true_pose('robot1').x


def run(simulator, seconds):
    for _ in range(round(seconds / simulator.config.time_step)):
        simulator.step()


def door(kind='door', start=0.0, duration=math.inf):
    return Event(kind, start, duration, ((4.0, 0.2), (4.0, 2.8)))


def test_a_door_is_closed_from_start_to_end_for_beams_and_bodies():
    simulator = simulate(door(start=2.0, duration=5.0))
    assert ahead(simulator) == pytest.approx(6.5, abs=0.06)
    run(simulator, 3.0)
    assert ahead(simulator) == pytest.approx(3.0, abs=0.11)
    assert drive(simulator, 3.9) < 3.9
    assert drive(simulator, 20.0) > 6.0
    assert simulator.collisions == []


def test_glass_stops_bodies_and_no_beams():
    simulator = simulate(door('glass'))
    assert math.isinf(ahead(simulator))
    assert drive(simulator, 20.0) < 3.9


def test_a_person_is_a_disc_that_appears_as_soon_as_no_vehicle_is_near():
    simulator = simulate(Event('person', 0.0, math.inf, ((1.5, 1.5),)))
    assert ahead(simulator) > 6.0  # the vehicle is 0.5 m away
    drive(simulator, 4.0, x=2.6)
    turned = Plan(simulator.time, 'robot1', Pose2(2.6, 1.5, math.pi), np.array([[2.6, 1.5]]))
    simulator.set_plan('robot1', turned)
    run(simulator, 8.0)
    x = simulator.true_pose('robot1').x
    assert ahead(simulator) == pytest.approx(x - 1.5 - 0.25, abs=0.08)


def test_a_stuck_vehicle_does_not_move_and_a_slow_one_less():
    assert drive(simulate(Event('stuck', 0.0, vehicle='robot1', factor=0.0)), 5.0) == 1.0
    slow = drive(simulate(Event('slow', 0.0, vehicle='robot1', factor=0.3)), 5.0) - 1.0
    usual = drive(simulate(), 5.0) - 1.0
    assert 0.2 * usual < slow < 0.45 * usual


def test_a_silent_vehicle_is_silent_from_start_to_end():
    simulator = simulate(Event('silent', 1.0, 2.0, vehicle='robot1', factor=0.0))
    heard = []
    for _ in range(4):
        heard.append(simulator.is_silent('robot1'))
        run(simulator, 1.0)
    assert heard == [False, True, True, False]


def test_coverage_is_that_of_what_can_be_reached_after_all_events():
    everything = simulate().reachable_cells
    assert simulate(door(duration=60.0)).reachable_cells == everything
    assert 0.4 * everything < simulate(door()).reachable_cells < 0.5 * everything
    after = Scenario((door('glass'),)).final_world(HALL)
    assert (after.cells == GLASS).any()
    assert ((after.cells == SOLID) == (HALL.cells == SOLID)).all()
    assert (HALL.cells != GLASS).all()  # the world itself is unchanged
    assert (HALL.cells == FREE).any()


def load(tmp_path, text, vehicles=('robot1', 'robot2')):
    path = tmp_path / 'events.yaml'
    path.write_text(text)
    return load_scenario(path, HALL, vehicles)


def test_a_file_with_every_event(tmp_path):
    scenario = load(
        tmp_path,
        """
        events:
          - {type: person, start: 20, duration: 60, position: [4.0, 1.5]}
          - {type: door, start: 0, duration: 12, from: [4.0, 0.2], to: [4.0, 2.8]}
          - {type: glass, start: 0, from: [5.0, 0.2], to: [5.0, 2.8]}
          - {type: stuck, start: 30, vehicle: robot2}
          - {type: slow, start: 0, vehicle: robot1}
          - {type: silent, start: 40, duration: 60, vehicle: robot1}
        """,
    )
    assert [event.kind for event in scenario.events] == [
        'person', 'door', 'glass', 'stuck', 'slow', 'silent',
    ]  # fmt: skip
    assert scenario.events[0] == Event('person', 20.0, 60.0, ((4.0, 1.5),))
    assert scenario.events[2].end == math.inf
    assert scenario.events[4].factor == 0.3
    assert scenario.conditions('robot1', 50.0) == (0.0, True)
    assert scenario.conditions('robot2', 29.9) == (1.0, False)


@pytest.mark.parametrize(
    ('event', 'message'),
    [
        ('{type: flood, start: 0}', r"events\[0\].type is 'flood', expected one of \['person'"),
        ('{start: 0}', r"events\[0\] is .* expected a mapping with the key 'type'"),
        ('7', r"events\[0\] is 7, expected a mapping with the key 'type'"),
        ('{type: stuck, start: -1, vehicle: robot1}', r'events\[0\].start is -1, expected a num'),
        ('{type: stuck, start: .nan, vehicle: robot1}', r'events\[0\].start is nan, expected'),
        ('{type: stuck, vehicle: robot1}', r"events\[0\] lacks 'start'"),
        ('{type: stuck, start: 0, vehicle: robot7}', r"vehicle is 'robot7', expected one of \["),
        ('{type: stuck, start: 0, vehicle: 3}', r'events\[0\].vehicle is 3, expected the name'),
        ('{type: stuck, start: 0, vehicel: robot1}', r"has no key 'vehicel'; did you mean 'vehi"),
        ('{type: slow, start: 0, vehicle: robot1, factor: 2}', r'factor is 2, expected a number'),
        ('{type: person, start: 0, position: [0.1, 1.5]}', r'position is .* in a wall'),
        ('{type: person, start: 0, position: [99, 1.5]}', r'events\[0\].* outside of the map'),
        ('{type: person, start: 0, position: [4]}', r'events\[0\].position is \[4\], expected'),
        ('{type: door, start: 0, from: [4, 1]}', r"events\[0\] lacks 'to'"),
        ('{type: door, start: 0, from: [0.1, 1], to: [0.1, 2]}', r'all in a wall, expected free'),
        ('{type: door, start: 0, duration: -3, from: [4, 1], to: [4, 2]}', r'duration is -3'),
    ],
)
def test_files_with_mistakes_are_refused_with_file_and_key(tmp_path, event, message):
    with pytest.raises(SimulationError) as failure:
        load(tmp_path, f'events:\n  - {event}\n')
    assert 'events.yaml' in str(failure.value)
    assert re.search(message, str(failure.value)), str(failure.value)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('[1, 2]', "expected a mapping with the key 'events'"),
        ('event: []', "has no key 'event'; did you mean 'events'"),
        ('{}', "lacks 'events'"),
        ('events: 5', 'events is 5, expected a list'),
    ],
)
def test_files_without_a_list_of_events_are_refused(tmp_path, text, message):
    with pytest.raises(SimulationError, match=re.escape(message)):
        load(tmp_path, text)


def test_the_simulator_refuses_a_scenario_of_another_world():
    with pytest.raises(SimulationError, match='in a wall'):
        simulate(Event('person', 0.0, math.inf, ((0.1, 0.1),)))
    with pytest.raises(SimulationError, match=r"'robot9', expected one of \['robot1'\]"):
        simulate(Event('stuck', 0.0, vehicle='robot9', factor=0.0))
