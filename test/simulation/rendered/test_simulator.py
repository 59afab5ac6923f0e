"""The rendered simulator: motion, collisions, odometry, sensors, determinism, errors."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from explore_slam.data import LaserScan, OdometryReading, RgbdFrame
from explore_slam.errors import ConfigError, SimulationError
from explore_slam.geometry import Pose2, to_world
from explore_slam.settings import with_values
from explore_slam.simulation import (
    SimulationConfig,
    Simulator,
    TruePose,
    load_world,
    world_path,
)
from explore_slam.simulation.config import SimulatedOdometryConfig
from explore_slam.simulation.records import HAZARD
from explore_slam.simulation.wheel_odometry import WheelOdometry
from explore_slam.sweeps import Sweep, deskewed

BLIND = {'simulated_camera_rate': 0.0}
SMALL = {'simulated_image_width': 160, 'simulated_image_height': 120}


def config(**values):
    return with_values(SimulationConfig(), values)


@pytest.fixture(scope='module')
def world():
    return load_world(world_path('small'))


def run(simulator, seconds, kind=None):
    end, events = simulator.time + seconds - 1e-9, []
    while simulator.time < end:
        events += simulator.step()
    return [event.record for event in events if kind is None or isinstance(event.record, kind)]


# -- driving ------------------------------------------------------------------------------------


def test_speeds_keep_to_the_limits_of_base_and_command(world):
    with Simulator(world, {'a': Pose2(1.0, 1.5, 0.0)}, config(**BLIND)) as simulator:
        simulator.set_velocity('a', 5.0, 0.0)
        truth = run(simulator, 0.5, TruePose)
        assert truth[-1].linear == pytest.approx(0.8 * 0.5, abs=0.02)  # m/s²
        run(simulator, 0.7)
        assert simulator.velocity('a') == pytest.approx((0.75, 0.0))
        simulator.set_velocity('a', 0.0, -9.0)
        run(simulator, 1.5)
        assert simulator.velocity('a') == pytest.approx((0.0, -1.75))


def test_a_vehicle_drives_a_circle(world):
    with Simulator(world, {'a': Pose2(1.5, 1.5, 0.0)}, config(**BLIND)) as simulator:
        simulator.set_velocity('a', 0.3, 0.6)
        run(simulator, 1.0)
        poses = [t.pose for t in run(simulator, math.tau / 0.6, TruePose)]
    points = np.array([(p.x, p.y) for p in poses])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    assert np.hypot(*(points - middle).T) == pytest.approx(np.full(len(points), 0.5), abs=0.003)


def test_a_wall_stops_a_vehicle_and_counts_once_per_contact(world):
    with Simulator(world, {'a': Pose2(1.0, 1.5, math.pi)}, config(**BLIND)) as simulator:
        for linear in (0.75, 0.0, 0.7, 0.3):  # pushing on is no other collision
            simulator.set_velocity('a', linear, 0.0)
            run(simulator, 2.5)
        assert simulator.collisions == {'a': 1}
        assert simulator.true_pose('a').x == pytest.approx(0.26, abs=0.001)
        assert simulator.true_pose('a').x >= 0.26
        (contact,) = simulator.collision_log
        assert (contact.vehicle, contact.obstacle) == ('a', 'wall')
        simulator.set_velocity('a', -0.5, 0.0)
        run(simulator, 1.5)
        assert simulator.true_pose('a').x > 0.5
        simulator.set_velocity('a', 0.7, 0.0)
        run(simulator, 4.0)
        assert simulator.collisions == {'a': 2}


def test_odometry_of_a_vehicle_that_stands_against_a_wall_stands(world):
    with Simulator(world, {'a': Pose2(0.27, 1.5, math.pi)}, config(**BLIND)) as simulator:
        simulator.set_velocity('a', 0.7, 0.0)
        reading = run(simulator, 3.0, OdometryReading)[-1]
    assert math.hypot(reading.pose.x, reading.pose.y) < 0.02


def test_vehicles_do_not_drive_through_each_other(world):
    starts = {'a': Pose2(0.8, 1.5, 0.0), 'b': Pose2(2.2, 1.5, 0.0)}
    with Simulator(world, starts, config(**BLIND)) as simulator:
        simulator.set_velocity('a', 0.5, 0.0)
        run(simulator, 4.0)
        assert simulator.collisions == {'a': 1, 'b': 0}
        assert simulator.collision_log[0].obstacle == 'b'
        assert simulator.true_pose('b').x - simulator.true_pose('a').x >= 0.52


# -- odometry -----------------------------------------------------------------------------------


def test_odometry_noise_is_that_of_table_one():
    """One step of 0.5 m: 12.5 mm along, 1.5 degrees of heading; the covariance says the same."""
    ends, covariances = [], []
    for seed in range(400):
        odometry = WheelOdometry(SimulatedOdometryConfig(), np.random.default_rng(seed))
        for _ in range(50):
            odometry.move(Pose2(0.01, 0.0, 0.0))
        ends.append(odometry.pose)
        covariances.append(odometry.covariance)
    deviation = np.std(ends, axis=0)
    assert deviation[0] == pytest.approx(0.0125, rel=0.12)
    assert deviation[2] == pytest.approx(math.radians(1.5), rel=0.12)
    assert np.sqrt(np.mean([np.diag(c) for c in covariances], axis=0)) == pytest.approx(
        deviation, rel=0.12
    )
    assert np.mean(ends, axis=0) == pytest.approx([0.5, 0.0, 0.0], abs=0.004)


def test_a_turn_has_the_heading_noise_of_a_step():
    ends = []
    for seed in range(400):
        odometry = WheelOdometry(SimulatedOdometryConfig(), np.random.default_rng(seed))
        for _ in range(50):
            odometry.move(Pose2(0.0, 0.0, math.pi / 100))
        ends.append(odometry.pose.theta - math.pi / 2)
    assert np.std(ends) == pytest.approx(math.radians(1.5), rel=0.12)


# -- sensors ------------------------------------------------------------------------------------


def test_readings_come_at_their_rates_with_rising_stamps(world):
    values = config(**SMALL, simulated_odometry_rate=20.0, simulated_scan_rate=10.0)
    with Simulator(world, None, values) as simulator:
        assert simulator.vehicles == ['robot1', 'robot2', 'robot3']
        events = [event for _ in range(100) for event in simulator.step()]
    assert [e.stamp for e in events] == sorted(e.stamp for e in events)
    assert all(e.stamp == e.record.stamp for e in events)
    for name in ('robot1', 'robot2', 'robot3'):
        kinds = [type(e.record) for e in events if e.vehicle == name]
        counts = [kinds.count(k) for k in (OdometryReading, TruePose, LaserScan, RgbdFrame)]
        assert counts == [pytest.approx(n, abs=1) for n in (40, 40, 20, 8)]


def test_the_laser_measures_walls_with_noise_and_nothing_beyond_its_range(world):
    starts = {'a': Pose2(1.0, 2.5, math.pi)}
    with Simulator(world, starts, config(**BLIND)) as simulator:
        scans = np.array([s.ranges for s in run(simulator, 6.0, LaserScan)])
    assert scans.shape[1] == 361
    # the laser sits 0.1 m ahead: the wall at x = 0 is 0.9 m away, walls at y = 0 and 5
    assert scans[:, 180].mean() == pytest.approx(0.9, abs=0.005)
    assert scans[:, 360].mean() == pytest.approx(2.5, abs=0.005)
    assert scans[:, 180].std() == pytest.approx(0.01, rel=0.35)
    near = config(**BLIND, simulated_scan_range=1.5)
    with Simulator(world, starts, near) as simulator:
        (scan,) = run(simulator, 0.02, LaserScan)
    assert np.isposinf(scan.ranges[360])
    assert scan.ranges[180] == pytest.approx(0.9, abs=0.05)


def test_laser_and_camera_see_other_vehicles(world):
    starts = {'a': Pose2(0.6, 1.5, 0.0), 'b': Pose2(2.2, 1.5, 1.0)}
    with Simulator(world, starts, config(simulated_depth_noise=0.0)) as simulator:
        events = [e for _ in range(8) for e in simulator.step() if e.vehicle == 'a']
    scan = next(e.record for e in events if isinstance(e.record, LaserScan))
    frame = next(e.record for e in events if isinstance(e.record, RgbdFrame))
    distance = 1.6 - 0.1 - 0.24  # the body is 2 cm less wide than the circle of collisions
    assert scan.ranges[180] == pytest.approx(distance, abs=0.05)
    assert scan.ranges[180 + 60] > distance + 0.3
    below = frame.depth[290:330, 310:330]  # the body ends below the camera's height
    assert np.median(below) == pytest.approx(1000 * distance, abs=15)


def test_depth_agrees_with_the_laser_and_colour_with_depth(world):
    """The middle row of a level camera sees what the laser sees, moved by the mounts."""
    values = config(simulated_depth_noise=0.0, simulated_scan_noise=0.0)
    pose = Pose2(2.0, 3.9, -2.6)
    with Simulator(world, {'a': pose}, values) as simulator:
        records = run(simulator, 0.02)
        camera = simulator.intrinsics
    scan = next(r for r in records if isinstance(r, LaserScan))
    frame = next(r for r in records if isinstance(r, RgbdFrame))
    depth = frame.depth[240].astype(float) / 1000.0
    columns = np.flatnonzero(depth)
    assert len(columns) > 300
    angle = -np.arctan((columns - camera.cx) / camera.fx)
    expected = np.interp(angle, scan.angles, scan.ranges) * np.cos(angle)
    assert np.median(np.abs(depth[columns] - expected)) < 0.002


LASER = Pose2(0.1, 0.0, 0.0)  # the usual mount


def returns(scan):
    """The returns of a scan as points (N, 2) in the vehicle frame."""
    seen = np.isfinite(scan.ranges)
    directions = np.stack([np.cos(scan.angles), np.sin(scan.angles)], axis=1)
    return to_world(LASER, directions[seen] * scan.ranges[seen, None])


def test_beams_of_a_sweep_start_where_the_vehicle_is_at_their_time(world):
    values = {
        **BLIND, 'simulated_field_of_view': 358.0, 'simulated_scan_noise': 0.0,
        'simulated_odometry_rate': 50.0,
    }  # fmt: skip
    spinning = config(**values, simulated_beams=180, simulated_sweep_time=0.18,
                      simulated_scan_rate=5.5)  # fmt: skip
    with Simulator(world, {'a': Pose2(1.5, 1.5, 0.5)}, spinning) as simulator:
        simulator.set_velocity('a', 0.2, 0.9)
        records = run(simulator, 2.0)
    truth = [record for record in records if isinstance(record, TruePose)]
    scans = [record for record in records if isinstance(record, LaserScan)]
    assert len(scans) == 11  # the last one has begun at 1.82 s
    assert scans[3].time_increment == pytest.approx(0.18 / 179)
    assert scans[3].scan_time == pytest.approx(1.0 / 5.5)
    at, path = np.array([t.stamp for t in truth]), np.array([t.pose for t in truth])
    still = deskewed(scans[8], Sweep(0.18), at, path, LASER)
    middle = Pose2(*(float(np.interp(still.stamp, at, column)) for column in path.T))
    dense = config(**values, simulated_beams=3000)
    with Simulator(world, {'a': middle}, dense) as simulator:
        (exact,) = run(simulator, 0.02, LaserScan)
    walls = cKDTree(returns(exact))
    assert np.quantile(walls.query(returns(still))[0], 0.95) < 0.006
    assert np.quantile(walls.query(returns(scans[8]))[0], 0.5) > 0.02


def test_a_sweep_cannot_take_longer_than_the_time_between_scans():
    with pytest.raises(ConfigError, match=r'simulated_sweep_time is 0.2 s, expected at most the'):
        config(simulated_sweep_time=0.2, simulated_scan_rate=10.0)


def test_depth_is_valid_from_0_8_to_3_5_m_with_noise_that_grows(world):
    def depths(distance):
        starts = {'a': Pose2(distance + 0.1, 2.5, math.pi)}
        with Simulator(world, starts, config(simulated_camera_rate=25.0)) as simulator:
            frames = run(simulator, 0.4, RgbdFrame)
        assert {f.depth.dtype for f in frames} == {np.dtype(np.uint16)}
        return np.array([f.depth[150:250, 300:340] for f in frames]).astype(float)

    assert (depths(0.7) == 0).all()
    one, three = depths(1.0), depths(3.0)
    assert one.mean() == pytest.approx(1000, abs=2)
    assert three.mean() == pytest.approx(3000, abs=3)
    assert one.std() == pytest.approx(3.0, rel=0.2)
    assert three.std() == pytest.approx(27.0, rel=0.2)
    assert np.mean(depths(3.6) > 0) < 0.05


def test_landmarks_seen_twice_lie_at_the_same_place(world):
    from explore_slam.vision import FeatureExtractor

    extractor, exact = FeatureExtractor(), config(simulated_depth_noise=0.0)
    found = []
    for pose in (Pose2(1.9, 2.2, 2.9), Pose2(1.7, 2.5, -3.0)):
        with Simulator(world, {'a': pose}, exact) as simulator:
            (frame,) = run(simulator, 0.02, RgbdFrame)
        seen = extractor.extract(frame)
        assert len(seen) == 200
        found.append((to_world(pose, seen.positions), seen.descriptors))
    (first, a), (second, b) = found
    squared = 2.0 - 2.0 * a @ b.T
    order = np.sort(squared, axis=1)
    sure = (order[:, 0] < 0.2) & (order[:, 0] < 0.4 * order[:, 1])
    gaps = np.linalg.norm(first - second[squared.argmin(axis=1)], axis=1)[sure]
    assert sure.sum() >= 30
    assert np.median(gaps) < 0.003


def test_most_views_are_rich_in_features():
    from explore_slam.simulation.worlds.obstacles import Obstacles
    from explore_slam.vision import FeatureExtractor, VisionConfig

    world, rng = load_world(world_path('office')), np.random.default_rng(0)
    room = Obstacles(world).clearance
    extractor = FeatureExtractor(with_values(VisionConfig(), {'feature_budget': 2000}))
    counts = []
    with Simulator(world, {'a': world.starts['robot1']}, config()) as simulator:
        while len(counts) < 20:
            x, y = rng.uniform(0, 17), rng.uniform(0, 10.5)
            if room(x, y) < 0.4:
                continue
            simulator.place('a', Pose2(x, y, rng.uniform(-math.pi, math.pi)))
            (frame,) = run(simulator, 0.26, RgbdFrame)[:1]
            if np.mean(frame.depth > 0) > 0.25:
                counts.append(len(extractor.extract(frame)))
    assert np.mean(np.array(counts) >= 200) > 0.8


# -- repeatability, mistakes --------------------------------------------------------------------


def test_the_same_seed_gives_the_same_records(world):
    def records(seed):
        with Simulator(world, None, config(**SMALL), seed) as simulator:
            for index, name in enumerate(simulator.vehicles):
                simulator.set_velocity(name, 0.2, 0.3 * index)
            return run(simulator, 1.0)

    first, again, other = records(4), records(4), records(5)
    assert len(first) == len(again) == len(other)
    differs = 0
    for a, b, c in zip(first, again, other, strict=True):
        if isinstance(a, LaserScan):
            assert np.array_equal(a.ranges, b.ranges)
            differs += not np.array_equal(a.ranges, c.ranges)
        elif isinstance(a, RgbdFrame):
            assert np.array_equal(a.rgb, b.rgb)
            assert np.array_equal(a.depth, b.depth)
            differs += not np.array_equal(a.depth, c.depth)
        elif isinstance(a, OdometryReading):
            assert a.pose == b.pose
            assert np.array_equal(a.covariance, b.covariance)
        else:
            assert a == b == c  # the truth does not depend on noise
    assert differs > 20


@pytest.mark.parametrize(
    ('starts', 'words'),
    [
        ({'a': Pose2(3.2, 1.0, 0.0)}, "'a' (3.2, 1, 0) lies inside a wall"),
        ({'a': Pose2(1.0, 0.1, 0.0)}, '0.10 m from a wall, expected at least 0.26 m'),
        ({'a': Pose2(9.0, 1.0, 0.0)}, "outside world 'small', expected x in -0.1..6.1"),
        ({'a': Pose2(math.nan, 1.0, 0.0)}, 'outside world'),
        ({'a': Pose2(1, 1, 0), 'b': Pose2(1.3, 1, 0)}, "lies 0.30 m from that of 'a'"),
        ({}, 'no start poses'),
    ],
)
def test_start_poses_must_be_free(world, starts, words):
    with pytest.raises(SimulationError) as caught:
        Simulator(world, starts, config(**BLIND))
    assert words in str(caught.value)


def test_commands_must_make_sense(world):
    with Simulator(world, {'a': Pose2(1.0, 1.5, 0.0)}, config(**BLIND)) as simulator:
        with pytest.raises(SimulationError, match="no vehicle 'b', only"):
            simulator.set_velocity('b', 0.0, 0.0)
        with pytest.raises(SimulationError, match='nan'):
            simulator.set_velocity('a', math.nan, 0.0)


def test_a_kidnapped_vehicle_stands_elsewhere_and_its_odometry_does_not_know(world):
    starts = {'a': Pose2(1.0, 1.5, 0.0), 'b': Pose2(2.0, 3.0, 0.0)}
    with Simulator(world, starts, config(**BLIND)) as simulator:
        before = run(simulator, 0.1, OdometryReading)[-2].pose
        simulator.place('a', Pose2(4.5, 2.5, 1.0))
        records = run(simulator, 0.1)
        assert next(r.pose for r in records if isinstance(r, OdometryReading)) == before
        assert simulator.true_pose('a') == Pose2(4.5, 2.5, 1.0)
        with pytest.raises(SimulationError, match=r"pose of 'a'.* lies 0.00 m from that of 'b'"):
            simulator.place('a', Pose2(2.0, 3.0, 0.0))
        with pytest.raises(SimulationError, match="no vehicle 'c'"):
            simulator.place('c', Pose2(2.0, 3.0, 0.0))


def test_closing_twice_does_nothing(world):
    with Simulator(world, None, config(**SMALL)) as simulator:
        frames = run(simulator, 0.3, RgbdFrame)
    assert frames
    simulator.close()


# -- what the laser does not see ------------------------------------------------------------------

HAZARDS = """
size: [8.0, 4.0]
furniture:
  - {kind: table, at: [2.5, 2.0], size: [1.0, 1.2, 0.7]}
  - {kind: step, at: [6.0, 2.0], size: [1.0, 2.0, 0.2]}
starts: {a: [1.0, 2.0, 0.0]}
"""


@pytest.fixture
def hazards(tmp_path):
    path = tmp_path / 'hazards.yaml'
    path.write_text(HAZARDS, encoding='utf-8')
    return load_world(path)


@pytest.mark.parametrize(('start', 'edge'), [(1.0, 2.0), (4.0, 5.5)])
def test_a_vehicle_stops_at_a_table_top_and_at_a_step_which_its_laser_does_not_see(
    hazards, start, edge
):
    pose = Pose2(start, 2.0, 0.0)
    with Simulator(hazards, {'a': pose}, config(**BLIND)) as simulator:
        scan = run(simulator, 0.2, LaserScan)[0]
        assert scan.ranges[180] > 3.0  # straight ahead: between the legs, and beyond the step
        simulator.set_velocity('a', 0.5, 0.0)
        run(simulator, 6.0)
        assert simulator.true_pose('a').x == pytest.approx(edge - 0.26, abs=0.01)
        (collision,) = simulator.collision_log
        assert collision.obstacle == HAZARD
    with Simulator(hazards, {'a': pose}, config(**BLIND, simulated_height=0.6)) as simulator:
        simulator.set_velocity('a', 0.5, 0.0)
        run(simulator, 3.0)
        assert len(simulator.collision_log) == (edge == 5.5)  # a low vehicle fits below a table


def test_the_camera_sees_the_lower_side_of_a_table_and_the_lower_floor(hazards):
    exact = config(simulated_depth_noise=0.0)
    with Simulator(hazards, {'a': Pose2(1.0, 2.0, 0.0)}, exact) as simulator:
        frame = run(simulator, 0.3, RgbdFrame)[0]
        camera, column = simulator.intrinsics, 320
        depth = frame.depth[:, column] * 1e-3
        heights = 0.4 + depth * (camera.cy - np.arange(480)) / camera.fy
        below = (np.abs(heights - 0.67) < 0.003) & (depth > 0.0)
        # from the edge at 0.9 m on, all along the top
        assert depth[below].min() == pytest.approx(0.9, abs=0.01)
        assert depth[below].max() == pytest.approx(1.9, abs=0.05)
    with Simulator(hazards, {'a': Pose2(4.0, 2.0, 0.0)}, exact) as simulator:
        frame = run(simulator, 0.3, RgbdFrame)[0]
        depth = frame.depth[:, column] * 1e-3
        heights = 0.4 + depth * (camera.cy - np.arange(480)) / camera.fy
        floor = (np.abs(heights) < 0.003) & (depth > 0.0) & (depth < 2.0)
        assert depth[floor].max() == pytest.approx(1.4, abs=0.01)  # up to the edge
        assert heights[depth > 0.0].min() == pytest.approx(-0.2, abs=0.003)
