"""The grid world and its simulator: cells, beams, coverage, motion, collisions."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from grid_worlds import drawn_world
from hypothesis import example, given, settings
from hypothesis import strategies as st

from explore_slam.data import Plan
from explore_slam.errors import ConfigError, ExploreSlamError, SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.grid.grid_simulator import (
    ARRIVAL_DISTANCE,
    LOOKAHEAD,
    GridSimulator,
    GridSimulatorConfig,
)
from explore_slam.simulation.worlds.grid_world import SOLID, GridWorld
from explore_slam.simulation.worlds.loading import load_grid_world
from explore_slam.simulation.worlds.world import Block, World
from explore_slam.sweeps import Sweep, deskewed

ROOM = ['##########', *['#........#'] * 6, '##########']  # 4 m x 3 m inside
EXACT = GridSimulatorConfig(range_noise=0.0)


def plan(vehicle, *points, stamp=0.0):
    return Plan(stamp, vehicle, Pose2(*points[-1], 0.0), np.array(points, dtype=np.float64))


def drive(simulator, seconds):
    for _ in range(round(seconds / simulator.config.time_step)):
        simulator.step()


def distance_to_walls(pose, angle):
    """Distance to the inner walls of ROOM along the angle, by hand."""
    dx, dy = math.cos(angle), math.sin(angle)
    reach = [((4.5 if dx > 0 else 0.5) - pose.x) / dx] if abs(dx) > 1e-12 else []
    reach += [((3.5 if dy > 0 else 0.5) - pose.y) / dy] if abs(dy) > 1e-12 else []
    return min(value for value in reach if value >= 0)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.6, 4.4), st.floats(0.6, 3.4), st.floats(-math.pi, math.pi))
@example(1.0, 1.0, -5e-324)
def test_beams_in_an_empty_room_end_in_its_walls(x, y, theta):
    pose = Pose2(x, y, theta)
    simulator = GridSimulator(drawn_world(ROOM), {'a': pose}, EXACT)
    scan = simulator.scan('a')
    expected = np.array([distance_to_walls(pose, theta + angle) for angle in scan.angles])
    # a hit lies inside of the wall's first cell, at most one diagonal behind its face
    excess = scan.ranges - expected
    assert excess.min() > -1e-5
    assert excess.max() <= 0.05 * math.sqrt(2.0)


def test_other_vehicles_are_seen_and_shade_what_lies_behind():
    world = drawn_world(ROOM)
    starts = {'a': Pose2(1.0, 2.0, 0.0), 'b': Pose2(3.0, 2.0, 0.0)}
    simulator = GridSimulator(world, starts, EXACT)
    middle = simulator.scan('a').ranges[180]
    assert middle == pytest.approx(2.0 - 0.22, abs=1e-6)
    row, col = world.to_cell(np.array([[4.0, 2.0]]))[0]
    assert not simulator.seen('a')[row, col]
    simulator.scan('b')
    assert simulator.seen('b')[row, col]


def test_no_return_beyond_the_longest_range_and_from_glass():
    long_hall = drawn_world(['#' * 40, '#' + ' ' * 38 + '#', '#' * 40])
    simulator = GridSimulator(long_hall, {'a': Pose2(1.0, 0.75, 0.0)}, EXACT)
    assert simulator.scan('a').ranges[180] == np.inf
    behind_glass = drawn_world(['######', '#  g #', '######'])
    simulator = GridSimulator(behind_glass, {'a': Pose2(0.8, 0.75, 0.0)}, EXACT)
    assert simulator.scan('a').ranges[180] == np.inf
    row, col = behind_glass.to_cell(np.array([[2.25, 0.75]]))[0]
    assert not simulator.seen('a')[row, col]


def test_range_noise_has_the_deviation_asked_for():
    simulator = GridSimulator(
        drawn_world(ROOM),
        {'a': Pose2(2.5, 2.0, 0.0)},
        GridSimulatorConfig(range_noise=0.03),
        seed=5,
    )
    exact = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.5, 2.0, 0.0)}, EXACT).scan('a')
    errors = np.concatenate([simulator.scan('a').ranges - exact.ranges for _ in range(20)])
    assert errors.std() == pytest.approx(0.03, rel=0.05)
    assert abs(errors.mean()) < 0.002


def test_beams_of_a_sweep_start_where_the_vehicle_is_at_their_time():
    cells = np.zeros((200, 260), np.int8)
    cells[:, [0, -1]] = cells[[0, -1]] = cells[60:90, 180:] = SOLID
    world = GridWorld(cells, 0.02)
    config = GridSimulatorConfig(
        range_noise=0.0, sweep_time=0.2, beams=360, field_of_view=2.0 * math.pi
    )
    simulator = GridSimulator(world, {'a': Pose2(1.5, 2.0, 0.0)}, config)
    first = simulator.scan('a')  # nothing has moved before the simulation began
    assert (first.stamp, first.time_increment) == (0.0, 0.0)
    behind = Plan(0.0, 'a', Pose2(0.8, 2.0, math.pi), np.array([[1.5, 2.0], [0.8, 2.0]]))
    simulator.set_plan('a', behind)
    truth = []
    while simulator.time < 1.0:
        simulator.step()
        truth.append((simulator.time, *simulator.true_pose('a')))
    path = np.array(truth)
    assert path[-1, 3] - path[-3, 3] > 0.19  # it turns on the spot at 1 rad/s
    scan = simulator.scan('a')
    assert scan.stamp == pytest.approx(0.8)
    assert scan.time_increment * 359 == pytest.approx(0.2)
    still = deskewed(scan, Sweep(0.2), path[:, 0], path[:, 1:], Pose2(0.0, 0.0, 0.0))
    middle = Pose2(*(float(np.interp(0.9, path[:, 0], column)) for column in path[:, 1:].T))
    at_once = GridSimulator(world, {'a': middle}, replace(config, sweep_time=0.0)).scan('a')
    seen = np.interp(at_once.angles, still.angles, still.ranges, period=2.0 * math.pi)
    off = np.abs(seen - at_once.ranges)
    skew = np.abs(scan.ranges - at_once.ranges)
    assert np.quantile(off, 0.9) < 0.02
    assert np.quantile(skew, 0.9) > 0.1


def test_coverage_counts_every_reachable_cell_once():
    world = drawn_world(ROOM)
    simulator = GridSimulator(
        world, {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(4.0, 3.0, math.pi)}, EXACT
    )
    assert simulator.team_coverage() == 0.0
    for _ in range(2):  # looking twice from one place adds nothing
        simulator.scan('a')
        simulator.scan('b')
    seen = [simulator.seen(name) & simulator.reachable for name in ('a', 'b')]
    cells = simulator.reachable_cells
    assert simulator.own_coverage('a') == pytest.approx(seen[0].sum() / cells)
    assert simulator.own_coverage('b') == pytest.approx(seen[1].sum() / cells)
    assert simulator.team_coverage() == pytest.approx((seen[0] | seen[1]).sum() / cells)


@pytest.mark.parametrize(('radius', 'passes'), [(0.22, True), (0.26, False)])
def test_reachable_ends_at_a_door_that_is_too_narrow(radius, passes):
    rows = ['#' * 21, *['#.........#.........#'] * 7, '#' * 21]
    rows[4] = rows[4].replace('.#.', '...')  # a door of 0.5 m
    world = drawn_world(rows, 0.5)
    row, col = world.to_cell(np.array([[8.0, 2.25]]))[0]
    assert world.reachable(np.array([[1.5, 2.25]]), radius)[row, col] == passes


def test_reachable_holds_no_wall_and_all_of_an_open_room_but_its_corners():
    world = drawn_world(ROOM)
    reached = world.reachable(np.array([[1.0, 1.0]]), 0.26)
    assert not reached[world.cells != 0].any()
    assert 0.98 < reached.sum() * 0.05**2 / 12.0 <= 1.0


def test_a_start_too_tight_reaches_only_its_own_place():
    world = drawn_world(['###', '# #', '###'], size=0.4)
    reached = world.reachable(np.array([[0.6, 0.6]]), 0.3)
    assert 0 < reached.sum() <= 64


def test_start_poses_are_near_each_other_roomy_and_nested():
    world = drawn_world(ROOM)
    for seed in range(5):
        four = world.start_poses(4, seed, 0.26)
        two = world.start_poses(2, seed, 0.26)
        assert [pose[:2] for pose in two] == [pose[:2] for pose in four[:2]]
        for index, pose in enumerate(four):
            row, col = world.to_cell(np.array([pose[:2]]))[0]
            assert world.clearance[row, col] >= 0.26
            assert all(math.dist(pose[:2], other[:2]) >= 0.9 for other in four[:index])
        headings = [pose.theta for pose in four]
        assert len(set(headings)) == 4
        assert all(-math.pi < heading <= math.pi for heading in headings)
    assert world.start_poses(2, 1, 0.26) != world.start_poses(2, 2, 0.26)


def test_start_poses_stay_on_one_side_of_a_wall():
    rows = ['#' * 17, *['#.......#.......#'] * 8, '#' * 17]
    world = drawn_world(rows, 0.5)
    for seed in range(10):
        sides = {pose.x > 4.25 for pose in world.start_poses(4, seed, 0.26)}
        assert len(sides) == 1


def test_a_crowd_that_does_not_fit_is_refused():
    with pytest.raises(SimulationError, match='room for'):
        drawn_world(ROOM).start_poses(30, 0, 0.26)


def test_a_vehicle_drives_its_plan_within_its_limits():
    config = GridSimulatorConfig(range_noise=0.0)
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(1.0, 1.0, math.pi)}, config)
    path = plan('a', (1.0, 1.0), (4.0, 1.0), (4.0, 3.0))
    simulator.set_plan('a', path)
    speeds, poses = [0.0], [simulator.true_pose('a')]
    while not simulator.is_idle('a') and simulator.time < 60:
        simulator.step()
        poses.append(simulator.true_pose('a'))
        speeds.append(math.dist(poses[-1][:2], poses[-2][:2]) / config.time_step)
    assert math.dist(poses[-1][:2], (4.0, 3.0)) <= ARRIVAL_DISTANCE
    assert max(speeds) <= config.cruise_speed + 1e-9
    assert max(np.diff(speeds)) <= config.acceleration * config.time_step + 1e-9
    turns = [abs(a.between(b).theta) / config.time_step for a, b in itertools.pairwise(poses)]
    assert max(turns) <= config.turn_rate + 1e-9
    # pure pursuit cuts the corner at (4, 1) but never leaves the path by more than its lookahead
    off = [min(abs(p.y - 1.0) if p.x < 4.0 else 9.0, abs(p.x - 4.0)) for p in poses]
    assert max(off) < LOOKAHEAD
    assert simulator.travelled('a') == pytest.approx(5.0, abs=0.5)
    assert simulator.time == pytest.approx(math.pi / 1.0 + 5.0 / 0.5, abs=5.0)
    assert simulator.collisions == []


def test_a_plan_through_a_wall_ends_before_it_without_contact():
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.0)}, EXACT)
    simulator.set_plan('a', plan('a', (2.0, 2.0), (6.0, 2.0)))
    drive(simulator, 30)
    pose = simulator.true_pose('a')
    assert 3.9 < pose.x <= 4.5 - 0.22
    assert simulator.collisions == []
    assert simulator.stalled_for('a') > 10
    assert not simulator.is_idle('a')


def test_a_vehicle_without_a_plan_stays_where_it_is():
    start = Pose2(2.0, 2.0, 0.5)
    simulator = GridSimulator(drawn_world(ROOM), {'a': start}, EXACT)
    simulator.set_plan('a', plan('a', (2.0, 2.0), (3.0, 2.0)))
    simulator.set_plan('a', None)
    drive(simulator, 30)
    assert simulator.true_pose('a') == start


def test_glass_stops_a_vehicle_too():
    rows = ['##########', *['#.....g..#'] * 6, '##########']
    simulator = GridSimulator(drawn_world(rows), {'a': Pose2(1.0, 2.0, 0.0)}, EXACT)
    simulator.set_plan('a', plan('a', (1.0, 2.0), (4.0, 2.0)))
    drive(simulator, 20)
    assert simulator.true_pose('a').x < 3.0 - 0.22 + 1e-6
    assert simulator.collisions == []


def test_contacts_with_walls_are_counted_where_nothing_brakes():
    blind = GridSimulatorConfig(range_noise=0.0, braking=10.0, time_step=0.5)
    simulator = GridSimulator(
        drawn_world(['###', '# #', '###'], size=0.5),
        {'a': Pose2(0.75, 0.75, 0.3)},
        blind,
    )
    simulator._safe_speed = lambda _index: 1.0
    simulator.set_plan('a', plan('a', (0.75, 0.75), (3.0, 0.75)))
    drive(simulator, 10)
    assert [contact.obstacle for contact in simulator.collisions] == ['wall']
    assert math.dist(simulator.true_pose('a')[:2], (0.75, 0.75)) < 0.3


@pytest.mark.parametrize('seed', range(6))
def test_vehicles_sent_across_each_other_never_touch(seed):
    world = drawn_world(ROOM)
    rng = np.random.default_rng(seed)
    poses = world.start_poses(4, seed, 0.26)
    simulator = GridSimulator(world, {f'r{i}': pose for i, pose in enumerate(poses)}, EXACT)
    closest = np.inf
    for tick in range(1200):
        for name in simulator.vehicles:
            if simulator.is_idle(name) or simulator.stalled_for(name) > 2.0:
                place = simulator.true_pose(name)[:2]
                goal = (rng.uniform(0.8, 4.2), rng.uniform(0.8, 3.2))
                simulator.set_plan(name, plan(name, place, goal, stamp=simulator.time))
        simulator.step()
        if tick % 5 == 0:
            places = np.array([simulator.true_pose(name)[:2] for name in simulator.vehicles])
            gaps = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
            closest = min(closest, gaps[np.triu_indices(4, 1)].min())
    assert simulator.collisions == []
    assert closest >= 2 * 0.22
    assert sum(simulator.travelled(name) for name in simulator.vehicles) > 3.0


def test_known_pose_wanders_about_the_true_one():
    noisy = GridSimulatorConfig(position_noise=0.05, heading_noise=0.02, error_time_constant=1.0)
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.0)}, noisy, seed=3)
    errors = []
    for _ in range(5000):
        simulator.step()
        errors.append(simulator.true_pose('a').between(simulator.known_pose('a')))
    deviation = np.std(np.array(errors), axis=0)
    np.testing.assert_allclose(deviation, [0.05, 0.05, 0.02], rtol=0.15)
    steps = np.diff([error.x for error in errors])
    assert steps.std() < 0.6 * deviation[0]  # it wanders, it does not jump
    exact = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.0)}, EXACT)
    drive(exact, 1.0)
    assert exact.known_pose('a') == exact.true_pose('a')


def test_the_same_seed_gives_the_same_run():
    def run(seed):
        simulator = GridSimulator(
            drawn_world(ROOM),
            {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(4.0, 3.0, 0.0)},
            GridSimulatorConfig(position_noise=0.02, heading_noise=0.01),
            seed,
        )
        simulator.set_plan('a', plan('a', (1.0, 1.0), (4.0, 2.0)))
        drive(simulator, 5)
        return simulator.true_pose('a'), simulator.scan('b').ranges.tobytes()

    assert run(1) == run(1)
    assert run(1) != run(2)


def write_map(folder, values, name='map'):
    image = folder / f'{name}.pgm'
    height, width = values.shape
    image.write_bytes(b'P5\n%d %d\n255\n' % (width, height) + values.astype(np.uint8).tobytes())
    return image


def test_a_map_alone_and_with_its_yaml(tmp_path):
    values = np.full((20, 30), 254)
    values[0, :] = values[-1, :] = values[:, 0] = values[:, -1] = 0
    values[5, 7] = 0
    values[15:, 20:] = 205
    values[10, 10] = 205  # a speck: a hole of the recording
    image = write_map(tmp_path, values)
    alone = load_grid_world(image)
    assert (alone.resolution, alone.origin, alone.shape) == (0.05, (0.0, 0.0), (20, 30))
    expected = (values != 254)[::-1]
    expected[20 - 1 - 10, 10] = False
    np.testing.assert_array_equal(alone.cells != 0, expected)
    facts = tmp_path / 'map.yaml'
    facts.write_text(
        'image: map.pgm\nresolution: 0.1\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n'
        'occupied_thresh: 0.65\nfree_thresh: 0.196\n'
    )
    named = load_grid_world(facts)
    assert named.resolution == 0.1
    assert named.origin == pytest.approx((-1.0, 2.0))
    np.testing.assert_array_equal(named.cells, alone.cells)


def test_a_world_file(tmp_path):
    path = tmp_path / 'hall.yaml'
    path.write_text('size: [6.0, 4.0]\nfurniture:\n  - {kind: crate, at: [3.0, 2.0]}\n')
    world = load_grid_world(path)
    row, col = world.to_cell(np.array([[3.0, 2.0]]))[0]
    assert world.cells[row, col] != 0
    row, col = world.to_cell(np.array([[1.0, 1.0]]))[0]
    assert world.cells[row, col] == 0
    assert 22.0 < world.reachable(np.array([[1.0, 1.0]]), 0.26).sum() * 0.05**2 < 24.0


def test_the_willow_map_is_one_large_place(recordings):
    world = load_grid_world(recordings('maps') / 'willow-full-0.05.pgm')
    assert world.shape == (945, 1138)  # without the unknown margin, which is grey 205
    (pose,) = world.start_poses(1, 0, 0.26)
    area = world.reachable(np.array([pose[:2]]), 0.26).sum() * 0.05**2
    assert 1150.0 < area < 1300.0


@pytest.mark.parametrize(
    'content', [b'', b'P6\n2 2\n255\n', b'P5\n20 20\n255\nabc', b'P5\nx y\n255\n']
)
def test_damaged_maps_are_refused(tmp_path, content):
    path = tmp_path / 'map.pgm'
    path.write_bytes(content)
    with pytest.raises(ExploreSlamError, match=r'map\.pgm'):
        load_grid_world(path)


def test_vehicles_that_differ_have_their_own_disc_speed_and_laser():
    world = drawn_world(ROOM)
    starts = {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(1.0, 2.5, 0.0)}
    own = replace(
        EXACT, disc_radius=0.4, cruise_speed=0.2, beam_range=1.0, field_of_view=1.0, beams=11
    )
    simulator = GridSimulator(world, starts, EXACT, own_configs={'b': own})
    usual, short = simulator.scan('a'), simulator.scan('b')
    assert (usual.ranges.size, short.ranges.size) == (EXACT.beams, 11)
    assert (short.angle_min, short.range_max) == (-0.5, 1.0)
    assert np.isinf(short.ranges).all()
    assert np.isfinite(usual.ranges).any()
    for name, pose in starts.items():
        path = np.array([pose[:2], (pose.x + 1.5, pose.y)])
        simulator.set_plan(name, Plan(0.0, name, Pose2(*path[1], 0.0), path))
    for _ in range(20):
        simulator.step()
    assert simulator.travelled('b') < 0.6 * simulator.travelled('a')
    for _ in range(200):
        simulator.step()
    assert simulator.collisions == []


def test_the_larger_disc_keeps_others_away():
    world = drawn_world(ROOM)
    starts = {'a': Pose2(1.0, 1.5, 0.0), 'b': Pose2(3.0, 1.5, 0.0)}
    stops = {}
    for radius in (0.22, 0.5):
        own = {'b': replace(EXACT, disc_radius=radius)}
        simulator = GridSimulator(world, starts, EXACT, own_configs=own)
        path = np.array([(1.0, 1.5), (3.0, 1.5)])
        simulator.set_plan('a', Plan(0.0, 'a', Pose2(3.0, 1.5, 0.0), path))
        reached = []
        for _ in range(60):
            simulator.step()
            reached.append(simulator.true_pose('a').x)
        stops[radius] = max(reached)
    assert stops[0.22] - stops[0.5] == pytest.approx(0.28, abs=0.05)
    near = {'a': starts['a'], 'b': Pose2(1.6, 1.5, 0.0)}
    GridSimulator(world, near, EXACT)
    with pytest.raises(SimulationError, match=r'disc 0\.12 m within that of another'):
        GridSimulator(world, near, EXACT, own_configs={'b': replace(EXACT, disc_radius=0.5)})


def test_bad_worlds_starts_and_settings_are_refused(tmp_path):
    with pytest.raises(ExploreSlamError, match=r'none\.pgm'):
        load_grid_world(tmp_path / 'none.pgm')
    with pytest.raises(SimulationError, match='resolution'):
        GridWorld(np.zeros((2, 2), np.int8), 0.0)
    with pytest.raises(SimulationError, match='shape'):
        GridWorld(np.zeros((0, 2), np.int8), 0.05)
    world = drawn_world(ROOM)
    with pytest.raises(SimulationError, match='outside'):
        GridSimulator(world, {'a': Pose2(50.0, 1.0, 0.0)})
    with pytest.raises(SimulationError, match='in an obstacle'):
        GridSimulator(world, {'a': Pose2(0.1, 0.1, 0.0)})
    with pytest.raises(SimulationError, match=r'disc 0\.34 m within that of another'):
        GridSimulator(world, {'a': Pose2(1.0, 1.0, 0.0), 'b': Pose2(1.1, 1.0, 0.0)})
    with pytest.raises(SimulationError, match='0 vehicles'):
        GridSimulator(world, {})
    with pytest.raises(ConfigError, match='cruise_speed'):
        GridSimulatorConfig(cruise_speed=-1.0)
    with pytest.raises(SimulationError, match='no place'):
        drawn_world(['###', '# #', '###'], 0.3).start_poses(1, 0, 0.26)


# -- single time steps, by hand -------------------------------------------------------------------

HALL = ['#' * 40, *['#' + ' ' * 38 + '#'] * 6, '#' * 40]  # 19 m x 3 m inside


def at_speed(simulator, speed, vehicle=0):
    simulator._drives[vehicle].speed = speed
    return simulator


def test_speed_rises_and_falls_with_acceleration_and_braking():
    simulator = GridSimulator(drawn_world(HALL), {'a': Pose2(1.0, 2.0, 0.0)}, EXACT)
    simulator.set_plan('a', plan('a', (1.0, 2.0), (15.0, 2.0)))
    speeds = []
    for _ in range(12):
        simulator.step()
        speeds.append(simulator._drives[0].speed)
    assert speeds[:3] == pytest.approx([0.05, 0.1, 0.15])
    assert speeds[-1] == pytest.approx(0.5)
    simulator.set_plan('a', None)
    simulator.step()
    assert simulator._drives[0].speed == pytest.approx(0.4)
    assert simulator.travelled('a') == pytest.approx(0.1 * (sum(speeds) + 0.4))


def test_turn_rate_is_ramped_and_the_vehicle_moves_along_the_mean_heading():
    simulator = GridSimulator(drawn_world(HALL), {'a': Pose2(2.0, 2.0, 0.0)}, EXACT)
    simulator.set_plan('a', plan('a', (2.0, 2.0), (2.5, 2.4)))
    at_speed(simulator, 0.3)
    simulator.step()
    drive_state, pose = simulator._drives[0], simulator.true_pose('a')
    assert drive_state.turn == pytest.approx(0.2)  # 2 rad/s² for 0.1 s
    moved = 0.1 * drive_state.speed
    assert pose.theta == pytest.approx(0.02)
    expected = (2.0 + moved * math.cos(0.01), 2.0 + moved * math.sin(0.01))
    assert pose[:2] == pytest.approx(expected)


@pytest.mark.parametrize(('gap', 'stops'), [(0.02, True), (0.2, False), (3.0, False)])
def test_the_safe_speed_stops_before_a_wall(gap, stops):
    """Room from the disc to the wall, less half a step at cruise speed; braking at 1 m/s²."""
    wall = 19.5
    simulator = GridSimulator(drawn_world(HALL), {'a': Pose2(wall - 0.22 - gap, 2.0, 0.0)}, EXACT)
    allowed = simulator._safe_speed(0)
    reach = 2.0 * (0.5**2 / 2.0 + 0.05)
    room = min(gap - 0.003, reach) - 0.025
    assert allowed == pytest.approx(math.sqrt(max(2.0 * room, 0.0)), abs=0.07)
    assert (allowed == 0.0) == stops


@pytest.mark.parametrize('gap', [0.5, 1.0, 9.0])
def test_before_another_vehicle_half_of_the_room_is_used(gap):
    starts = {'a': Pose2(2.0, 2.0, 0.0), 'b': Pose2(2.0 + 0.44 + gap, 2.0, 0.0)}
    simulator = GridSimulator(drawn_world(HALL), starts, EXACT)
    room = min(0.5 * (gap - 0.15), 2.0 * (0.125 + 0.05)) - 0.025
    assert simulator._safe_speed(0) == pytest.approx(math.sqrt(2.0 * room))
    behind = GridSimulator(drawn_world(HALL), {**starts, 'a': Pose2(2.0, 2.0, math.pi)}, EXACT)
    assert behind._safe_speed(0) > 0.7


def test_lookahead_is_twice_the_room_between_its_limits():
    def lookahead(y):
        world = drawn_world(HALL)
        return GridSimulator(world, {'a': Pose2(9.0, y, 0.0)}, EXACT)._lookahead(0)

    assert lookahead(2.0) == 0.35
    assert lookahead(0.5 + 0.22 + 0.1) == pytest.approx(0.2, abs=0.03)
    assert lookahead(0.5 + 0.23) == 0.12


def test_a_blocked_vehicle_backs_off_after_4_s_and_stalls_all_the_while():
    simulator = GridSimulator(drawn_world(HALL), {'a': Pose2(19.1, 2.0, 0.0)}, EXACT)
    simulator.set_plan('a', plan('a', (19.1, 2.0), (25.0, 2.0)))
    drive(simulator, 1.0)
    front = simulator.true_pose('a').x
    drive(simulator, 2.9)
    assert simulator.true_pose('a').x == front
    drive(simulator, 2.5)
    assert front - simulator.true_pose('a').x == pytest.approx(0.3, abs=0.05)
    assert simulator._drives[0].backing == pytest.approx(0.0, abs=0.02)
    drive(simulator, 3.0)
    assert simulator.true_pose('a').x == pytest.approx(front, abs=0.02)  # it tries again
    assert simulator.stalled_for('a') == pytest.approx(simulator.time)


@pytest.mark.parametrize('what', ['wall', 'vehicle'])
def test_backing_off_ends_where_something_is_behind(what):
    world = drawn_world(HALL)
    x = 0.5 + 0.22 + 0.04 if what == 'wall' else 3.0
    starts = {'a': Pose2(x, 2.0, 0.0)}
    if what == 'vehicle':
        starts['b'] = Pose2(3.0 - 0.44 - 0.12, 2.0, 0.0)
    simulator = GridSimulator(world, starts, EXACT)
    simulator._drives[0].backing = 0.3
    drive(simulator, 1.0)
    assert abs(simulator.true_pose('a').x - x) < 0.02
    assert simulator._drives[0].backing == 0.0
    assert simulator.collisions == []
    free = GridSimulator(world, {'a': Pose2(9.0, 2.0, 0.0)}, EXACT)
    free._drives[0].backing = 0.3
    free.step()
    assert free.true_pose('a').x == pytest.approx(9.0 - 0.015)
    assert free._drives[0].backing == pytest.approx(0.285)
    assert free.travelled('a') == pytest.approx(0.015)


def test_at_its_goal_a_vehicle_turns_to_the_heading_of_the_plan():
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.0)}, EXACT)
    goal = Plan(0.0, 'a', Pose2(2.1, 2.0, -2.0), np.array([[2.0, 2.0], [2.1, 2.0]]))
    simulator.set_plan('a', goal)
    turns = []
    while not simulator.is_idle('a') and simulator.time < 10.0:
        simulator.step()
        turns.append(simulator._drives[0].turn)
    assert min(turns) == pytest.approx(-1.0)
    assert max(turns) <= 0.0
    assert abs(simulator.true_pose('a').theta + 2.0) <= 0.25
    assert simulator.true_pose('a')[:2] == pytest.approx((2.0, 2.0))


def test_contacts_are_told_apart_counted_once_and_only_when_coming_closer():
    starts = {'a': Pose2(2.0, 2.0, 0.0), 'b': Pose2(2.5, 2.0, 0.0), 'c': Pose2(1.2, 2.2, 0.0)}
    simulator = GridSimulator(drawn_world(HALL), starts, EXACT)
    assert simulator._contact(0, (2.0, 2.0), (2.05, 2.0)) == ''
    assert simulator._contact(0, (2.0, 2.0), (2.1, 2.0)) == 'b'
    assert simulator._contact(0, (2.1, 2.0), (2.09, 2.0)) == ''  # away from it
    assert simulator._contact(0, (0.75, 2.0), (0.70, 2.0)) == 'wall'
    assert simulator._contact(0, (0.68, 2.0), (0.70, 2.0)) == ''
    simulator._drives[1].speed = -0.5
    simulator._steer = lambda _index: None
    for _ in range(5):
        simulator._drives[1].speed = -0.5
        simulator.step()
    assert [(hit.vehicle, hit.obstacle) for hit in simulator.collisions] == [('b', 'a')]
    assert simulator.true_pose('b').x == pytest.approx(2.45)
    assert simulator.collisions[0].stamp == pytest.approx(0.2)
    assert simulator._drives[1].speed == 0.0


def test_a_scan_is_never_shorter_than_its_minimum_and_has_the_stamp_of_its_time():
    config = GridSimulatorConfig(range_noise=0.5, beams=1)
    simulator = GridSimulator(
        drawn_world(['####', '#  #', '####']), {'a': Pose2(0.75, 0.75, 0.0)}, config
    )
    drive(simulator, 0.3)
    scans = [simulator.scan('a') for _ in range(300)]
    ranges = np.array([scan.ranges[0] for scan in scans])
    assert ranges.min() == pytest.approx(0.02)
    assert scans[0].stamp == pytest.approx(0.3)
    assert (scans[0].angle_increment, scans[0].range_min, scans[0].range_max) == (0.0, 0.02, 8.0)


def test_as_many_vehicles_as_there_are_bits():
    world = drawn_world(['#' * 70, *['#' + ' ' * 68 + '#'] * 2, '#' * 70])
    starts = {f'r{i}': Pose2(1.0 + i, 1.0, 0.0) for i in range(32)}
    with pytest.raises(SimulationError, match='32 vehicles, expected 1 to 31'):
        GridSimulator(world, starts)
    del starts['r31']
    simulator = GridSimulator(world, starts, EXACT)
    simulator.scan('r30')
    assert simulator.seen('r30').any()
    assert not simulator.seen('r29').any()


def test_an_idle_vehicle_does_not_stall_and_an_empty_plan_is_none():
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.0)}, EXACT)
    assert simulator.is_idle('a')
    drive(simulator, 3.0)
    assert simulator.stalled_for('a') == 0.0
    simulator.set_plan('a', Plan(0.0, 'a', Pose2(3.0, 2.0, 0.0), np.empty((0, 2))))
    assert simulator.is_idle('a')
    simulator.set_plan('a', plan('a', (2.0, 2.0), (3.0, 2.0)))
    assert simulator.stalled_for('a') == 0.0
    drive(simulator, 1.0)
    assert simulator.stalled_for('a') == pytest.approx(1.0)  # not yet 0.6 m away
    drive(simulator, 1.0)
    assert simulator.stalled_for('a') < 0.6


def test_specks_are_up_to_ten_cells_and_hold_nothing_occupied(tmp_path):
    def free_of(size, value):
        values = np.full((12, 20), 254)
        values[5, 3 : 3 + size] = 205
        values[5, 3] = value
        world = load_grid_world(write_map(tmp_path, values, f'map{size}{value}'))
        return int(np.count_nonzero(world.cells == 0))

    assert free_of(10, 205) == 240
    assert free_of(11, 205) == 240 - 11
    assert free_of(2, 0) == 240 - 2


def test_a_start_in_a_corner_of_the_world_is_inside():
    world = GridWorld(np.zeros((4, 6), np.int8), 0.5)
    for x, y in ((0.1, 0.1), (2.9, 1.9)):
        assert world.reachable([[x, y]], 0.3)[world.to_cell([[x, y]])[0][0]].any()
    for x, y in ((-0.1, 0.1), (0.1, -0.1), (3.1, 0.1), (0.1, 2.1)):
        with pytest.raises(SimulationError, match='outside the world'):
            world.reachable([[x, y]], 0.3)


def test_cells_and_points_by_resolution_and_origin():
    world = GridWorld(np.zeros((4, 6), np.int8), 0.5, (-1.0, 2.0))
    assert world.to_cell([[-1.0, 2.0], [-0.51, 2.49], [-0.5, 2.5], [1.9, 3.9]]).tolist() == [
        [0, 0], [0, 0], [1, 1], [3, 5],
    ]  # fmt: skip
    np.testing.assert_allclose(world.to_point([[0, 0], [3, 5]]), [[-0.75, 2.25], [1.75, 3.75]])
    for point, inside in (((-1.0, 2.0), True), ((2.0, 3.0), False), ((0.0, 4.0), False)):
        assert world.is_inside(point) == inside
    assert not world.is_inside((-1.01, 3.0))
    assert not world.is_inside((0.0, 1.99))


def test_clearance_is_from_the_centre_to_the_edge_of_the_obstacle():
    cells = np.zeros((7, 9), np.int8)
    cells[3, 4] = 2
    clearance = GridWorld(cells, 0.5).clearance
    assert clearance[3, 4] == 0.0
    assert clearance[3, 5] == pytest.approx(0.25)
    assert clearance[3, 6] == pytest.approx(0.75)
    assert clearance[2, 5] == pytest.approx(0.5 * (math.sqrt(2.0) - 0.5))
    assert clearance[3, 0] == pytest.approx(0.25)  # the edge of the world counts as an obstacle


def test_a_world_of_solids_keeps_its_origin_and_resolution():
    solids = World('w', (-1.0, -1.0, 2.0, 1.0), (Block(0.5, 0.0, 0.3, 0.3, 0.0, 1.0),))
    world = GridWorld.from_world(solids, 0.1)
    assert (world.shape, world.resolution, world.origin) == ((20, 30), 0.1, (-1.0, -1.0))
    assert np.count_nonzero(world.cells == 1) == 36
    assert world.cells[10, 15] == 1


@pytest.mark.parametrize('turn', [-1.0, 0.0, 1.0])
def test_the_safe_speed_counts_what_the_turn_leads_to(turn):
    starts = {'a': Pose2(9.0, 0.5 + 0.22 + 0.05, 0.0)}  # along a wall on the right
    simulator = GridSimulator(drawn_world(HALL), starts, EXACT)
    straight = simulator._safe_speed(0)
    simulator._drives[0].turn = turn
    assert (simulator._safe_speed(0) < 0.9 * straight) == (turn < 0.0)


def test_the_turn_to_the_goal_heading_is_proportional():
    simulator = GridSimulator(drawn_world(ROOM), {'a': Pose2(2.0, 2.0, 0.1)}, EXACT)
    goal = Plan(0.0, 'a', Pose2(2.1, 2.0, 0.4), np.array([[2.0, 2.0], [2.1, 2.0]]))
    simulator.set_plan('a', goal)
    simulator._drives[0].turn = 0.7
    simulator.step()
    assert simulator._drives[0].turn == pytest.approx(2.5 * 0.3)
