"""Every setting of the agent changes what comes out; a new one without a test fails here.

Settings of the parts of the agent are tested with those parts.
"""

import math
from functools import partial

import pytest
from registration.ray_caster import scan_of
from slam.closures.drives import along
from slam.closures.test_loop_search import LAP, OFFICE
from synthetic import SyntheticVehicle, SyntheticWorld

from explore_slam.agent import Agent, AgentConfig
from explore_slam.data import OdometryReading
from explore_slam.exploration import ExplorationConfig
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import GridConfig
from explore_slam.registration import ScanMatchingConfig
from explore_slam.settings import settings_of, values_of, with_values
from explore_slam.slam import FastSlamConfig
from explore_slam.slam.closures import ClosureConfig
from explore_slam.vision import VisionConfig

STARTS = {'a': Pose2(-1.0, 0.0, 0.0), 'b': Pose2(1.0, 0.0, math.pi)}
USUAL = with_values(AgentConfig(), {'particles': 50})


def team_of(config):
    world = SyntheticWorld()
    team = {
        name: SyntheticVehicle(world, pose, seed=number)
        for number, (name, pose) in enumerate(STARTS.items())
    }
    return Agent(config, STARTS, seed=1), team


def outcome(agent):
    """Everything that an agent returns about its vehicles and the map."""
    poses = [(tuple(pose), P.tobytes()) for pose, P in map(agent.estimate, STARTS)]
    states = [(status.vehicle, status.state) for status in agent.statuses()]
    return poses, states, agent.summary(), agent.grid.probability().tobytes()


# -- experiments: from settings to something that can be compared ---------------------------------


def drive(config, seconds=6.0, landmarks=True, scans=True, step=None):
    """Drive two vehicles, which begin face to face, on circles or by another step per 0.1 s."""
    agent, team = team_of(config)
    for tick in range(round(10.0 * seconds)):
        for name, vehicle in team.items():
            vehicle.step = step or vehicle.step
            agent.add(name, vehicle.advance())
            if landmarks and tick % 5 == 0:
                agent.add(name, vehicle.landmarks())
            if scans and tick % 3 == 0:
                scan = vehicle.scan()
                scan.ranges[85:96] = 1.61  # near the body of the other vehicle
                agent.add(name, scan)
    return outcome(agent)


def report_after(*readings):
    """Return an experiment: drive, then pass further odometry, relative to the newest stamp."""

    def experiment(config):
        agent, team = team_of(config)
        for _ in range(20):
            for name, vehicle in team.items():
                agent.add(name, vehicle.advance())
        last, pose = team['a'].stamp, team['a'].odometry
        for later, ahead in readings:
            moved = pose.compose(Pose2(ahead, 0.0, 0.0))
            agent.add('a', OdometryReading(last + later, moved))
        return outcome(agent)

    return experiment


def measure_before_odometry(config):
    """Pass landmarks of the seconds to come, then the odometry that reaches them."""
    agent, team = team_of(config)
    vehicle = team['a']
    readings = []
    for tick in range(30):
        readings.append(vehicle.advance())
        if tick % 10 == 5:
            agent.add('a', vehicle.landmarks())
    for reading in readings:
        agent.add('a', reading)
    return len(agent.landmarks()), agent.summary()


def fall_silent(config):
    """Let one vehicle drive on for five seconds while the other says nothing."""
    agent, team = team_of(config)
    for tick in range(60):
        for name, vehicle in team.items():
            if tick < 10 or name == 'a':
                agent.add(name, vehicle.advance())
    return outcome(agent)


def a_lap(config):
    """Return how many closures a lap through an office ends with, or nothing."""
    path = along(*LAP, LAP[1])
    agent = Agent(config, {'a': path[0]}, seed=1)
    for number, pose in enumerate(path):
        agent.add('a', OdometryReading(float(number), pose))
        agent.add('a', scan_of(OFFICE, pose, stamp=float(number)))
    return agent.summary()['a'].get('closures')


BY_ODOMETRY = partial(drive, seconds=20.0, landmarks=False, scans=False)
AT_REST = partial(drive, landmarks=False, step=IDENTITY)
TURNING = partial(drive, seconds=3.0, landmarks=False, step=Pose2(0.0, 0.0, 0.05))

EFFECTS = {
    'odometry_duration': (1.0, BY_ODOMETRY),
    'odometry_jump_speed': (10.0, report_after((0.1, 0.6))),
    'clock_jump_threshold': (0.2, report_after((-0.5, 0.1))),
    'measurement_queue_length': (1, measure_before_odometry),
    'silent_timeout': (10.0, fall_silent),
    'lost_deviation': (100.0, BY_ODOMETRY),
    'laser_x': (0.3, drive),
    'laser_y': (0.1, drive),
    'laser_yaw': (0.1, drive),
    'map_scan_distance': (0.3, drive),
    'map_scan_heading': (0.3, TURNING),
    'map_scan_period': (0.5, AT_REST),
    'body_margin': (0.0, AT_REST),
    'scan_matching': (False, drive),
    'scan_wait_timeout': (0.0, drive),
    'laser_closures': (False, a_lap),
}
PARTS = (
    FastSlamConfig, ScanMatchingConfig, ClosureConfig, GridConfig, ExplorationConfig, VisionConfig,
)  # fmt: skip
OWN = {'scan_matching', 'scan_wait_timeout', 'laser_closures'}  # which only the agent uses
NAMES = OWN | (
    {info.name for info, _ in settings_of(AgentConfig())}
    - {name for part in PARTS for name in values_of(part())}
)


@pytest.fixture(scope='module')
def usual():
    """Outcomes with usual settings, which effects are compared with."""
    return {experiment: experiment(USUAL) for _, experiment in EFFECTS.values()}


@pytest.mark.parametrize('name', sorted(NAMES))
def test_every_setting_changes_what_comes_out(name, usual):
    value, experiment = EFFECTS[name]
    assert experiment(with_values(USUAL, {name: value})) != usual[experiment]


@pytest.mark.parametrize('experiment', dict.fromkeys(run for _, run in EFFECTS.values()))
def test_the_same_settings_give_the_same(experiment, usual):
    assert experiment(USUAL) == usual[experiment]


def test_no_effect_is_listed_for_a_setting_that_does_not_exist():
    assert EFFECTS.keys() == NAMES
