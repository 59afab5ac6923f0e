"""Kernels of the grid simulator against values by hand and against dense sampling."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from explore_slam.simulation.grid.kernels import (
    Cells,
    ClearanceField,
    Coverage,
    Pursuit,
    Sweep,
    cast_beams,
    distance_to_disc,
    distance_to_others,
    free_distance,
    pursue,
    sample_field,
    smallest_gap,
)
from explore_slam.simulation.worlds.grid_world import GLASS, SOLID

ORIGIN = np.array([-1.0, 2.0])
PURSUIT = Pursuit(lookahead=0.5, tolerance=0.2, max_speed=0.6, max_turn_rate=1.0, braking=1.0)


@pytest.mark.parametrize(
    ('center', 'expected'),
    [
        ((3.0, 0.0), 2.0),
        ((3.0, 0.6), 2.2),
        ((3.0, -0.6), 2.2),
        ((3.0, 1.0), math.inf),  # grazed only
        ((-3.0, 0.0), math.inf),  # behind
        ((0.5, 0.0), 0.0),  # from inside, its centre ahead
        ((-0.5, 0.0), math.inf),  # from inside, on the way out
    ],
)
def test_distance_to_a_disc_of_radius_one(center, expected):
    assert distance_to_disc(0.0, 0.0, 1.0, 0.0, *center, 1.0) == pytest.approx(expected)


def test_distance_to_a_disc_in_any_direction():
    c, s = math.cos(2.0), math.sin(2.0)
    x, y = 1.0 + 3.0 * c - 0.6 * s, -2.0 + 3.0 * s + 0.6 * c
    assert distance_to_disc(1.0, -2.0, c, s, x, y, 1.0) == pytest.approx(2.2)


def cast(values, pose, angles, max_range=10.0, bodies=(), seen=None, bit=1, reachable=None):
    cells = Cells(values, 0.5, ORIGIN)
    seen = np.zeros(values.shape, np.uint32) if seen is None else seen
    reachable = values == 0 if reachable is None else reachable
    ranges = np.zeros(len(angles))
    counts = cast_beams(
        cells,
        Sweep(np.tile(pose, (len(angles), 1)), np.array(angles), max_range),
        np.array(bodies, dtype=np.float64).reshape(-1, 3),
        Coverage(reachable, seen, np.uint32(bit)),
        ranges,
    )
    return ranges, counts, seen


def test_beams_along_the_axes_end_in_the_middle_of_solid_cells():
    values = np.zeros((5, 7), np.int8)
    values[2, 5] = values[2, 0] = values[4, 3] = values[0, 3] = SOLID
    # the centre of cell (2, 3) is (0.75, 3.25)
    pose, angles = (0.75, 3.25, 0.0), (0.0, math.pi / 2, math.pi, -math.pi / 2)
    ranges, counts, seen = cast(values, pose, angles)
    assert ranges == pytest.approx([1.0, 1.0, 1.5, 1.0])
    crossed = {(2, 1), (2, 2), (2, 3), (2, 4), (3, 3), (1, 3)}
    assert set(zip(*np.nonzero(seen), strict=True)) == crossed
    assert counts == (6, 6)
    turned, _, _ = cast(values, (*pose[:2], math.pi / 2), angles)
    assert turned == pytest.approx([1.0, 1.5, 1.0, 1.0])


def test_cells_count_once_per_vehicle_and_once_per_team():
    values = np.zeros((1, 6), np.int8)
    values[0, 5] = SOLID
    reachable = np.array([[True, True, False, True, True, False]])
    pose = (-0.9, 2.25, 0.0)
    _, counts, seen = cast(values, pose, (0.0,), reachable=reachable)
    assert counts == (4, 4)
    assert cast(values, pose, (0.0,), seen=seen, reachable=reachable)[1] == (0, 0)
    _, counts, seen = cast(values, (0.6, 2.25, 0.0), (0.0,), seen=seen, bit=2, reachable=reachable)
    assert counts == (2, 0)
    assert seen.tolist() == [[1, 1, 1, 3, 3, 0]]


def test_ranges_beyond_the_maximum_glass_and_the_edge_are_no_return():
    values = np.zeros((1, 8), np.int8)
    values[0, 6] = SOLID
    pose = (-0.75, 2.25, 0.0)
    assert cast(values, pose, (0.0,), max_range=3.0)[0] == pytest.approx([3.0])
    assert cast(values, pose, (0.0,), max_range=2.9)[0] == [np.inf]
    ranges, _, seen = cast(values, pose, (0.0,), max_range=1.0)
    assert ranges == [np.inf]
    assert seen.tolist() == [[1, 1, 1, 0, 0, 0, 0, 0]]  # cells entered within the range
    values[0, 3] = GLASS
    ranges, _, seen = cast(values, pose, (0.0, math.pi))
    assert ranges.tolist() == [np.inf, np.inf]
    assert seen.tolist() == [[1, 1, 1, 0, 0, 0, 0, 0]]


def test_vehicles_stop_beams_before_walls_and_hide_what_lies_behind():
    values = np.zeros((1, 8), np.int8)
    values[0, 7] = SOLID
    bodies = [(1.0, 2.25, 0.25), (2.0, 2.25, 0.5)]
    ranges, counts, _ = cast(values, (-0.75, 2.25, 0.0), (0.0,), bodies=bodies)
    assert ranges == pytest.approx([1.5])
    assert counts[0] == 4
    far = cast(values, (-0.75, 2.25, 0.0), (0.0,), bodies=[(6.0, 2.25, 0.1)])[0]
    assert far == pytest.approx([3.5])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**24 - 1), st.floats(-math.pi, math.pi))
def test_beams_agree_with_dense_sampling(bits, angle):
    values = np.array([bits >> k & 1 for k in range(24)], np.int8).reshape(4, 6)
    values[1, 2] = 0
    x, y = 0.27, 2.78  # in cell (1, 2)
    ranges, _, seen = cast(values, (x, y, 0.0), (angle,))
    at = np.arange(0.0, 5.0, 0.001)
    cols = np.floor((x + at * math.cos(angle) - ORIGIN[0]) / 0.5).astype(int)
    rows = np.floor((y + at * math.sin(angle) - ORIGIN[1]) / 0.5).astype(int)
    outside = (rows < 0) | (rows >= 4) | (cols < 0) | (cols >= 6)
    inside = np.where(outside, 2, values[np.clip(rows, 0, 3), np.clip(cols, 0, 5)])
    end = int(np.argmax(inside != 0))
    if inside[end] == 1:
        leaves = end + int(np.argmax((rows[end:] != rows[end]) | (cols[end:] != cols[end])))
        short = leaves - end < 5  # a chord of millimetres, which the samples may have missed
        assert short or ranges[0] == pytest.approx(0.5 * (at[end] + at[leaves]), abs=0.002)
    else:
        assert ranges[0] == np.inf or ranges[0] < 5.0
    for row, col in {(int(r), int(c)) for r, c in zip(rows[:end], cols[:end], strict=True)}:
        assert seen[row, col]


FIELD = ClearanceField(np.arange(12, dtype=np.float32).reshape(3, 4), 0.5, ORIGIN)


@pytest.mark.parametrize(
    ('x', 'y', 'expected'),
    [
        (-0.75, 2.25, 0.0),  # centre of cell (0, 0)
        (-0.25, 2.25, 1.0),
        (-0.75, 2.75, 4.0),
        (-0.5, 2.25, 0.5),
        (-0.5, 2.5, 2.5),
        (-0.65, 2.35, 0.2 + 0.8),
        (0.74, 3.24, 10.9),
        (0.76, 2.5, 0.0),  # beyond the last centres there is none
        (-0.76, 2.5, 0.0),
        (0.0, 3.26, 0.0),
        (0.0, 2.24, 0.0),
    ],
)
def test_clearance_is_bilinear_between_cell_centres(x, y, expected):
    assert sample_field(FIELD, x, y) == pytest.approx(expected, abs=1e-6)


def corridor():
    """Clearance 1 m up to x = 4, then falling to 0 at x = 5; cells of 0.1 m."""
    x = 0.1 * (np.arange(60) + 0.5)
    row = np.clip(5.0 - x, 0.0, 1.0).astype(np.float32)
    return ClearanceField(np.tile(row, (5, 1)), 0.1, np.zeros(2))


def test_free_distance_ends_where_the_clearance_falls_below_what_is_needed():
    field = corridor()
    assert free_distance(field, np.array([1.0, 0.25, 0.0]), 0.4, 9.0) == pytest.approx(
        3.6, abs=0.06
    )
    assert free_distance(field, np.array([1.0, 0.25, 0.0]), 0.4, 2.0) == 2.0
    assert (
        free_distance(field, np.array([4.9, 0.25, math.pi]), 0.4, 2.0) == 2.0
    )  # out of the tight
    assert free_distance(field, np.array([4.9, 0.25, 0.0]), 0.4, 2.0) == 0.0  # deeper into it
    assert free_distance(field, np.array([2.0, 0.25, math.pi / 2]), 0.4, 2.0) < 0.26  # the edge


def path(*points):
    return np.array(points, dtype=np.float64)


STRAIGHT = path((0, 0), (10, 0))


def test_pursuit_drives_straight_on_at_full_speed():
    speed, turn, segment, arrived = pursue(STRAIGHT, 0, np.array([1.0, 0.0, 0.0]), PURSUIT)
    assert (speed, turn, segment, arrived) == (0.6, 0.0, 0, False)


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_pursuit_turns_towards_the_lookahead_point(side):
    pose = np.array([1.0, 0.1 * side, 0.0])
    speed, turn, _, _ = pursue(STRAIGHT, 0, pose, PURSUIT)
    error = -math.atan2(0.1, 0.5) * side  # the point 0.5 m further along the path
    assert turn == pytest.approx(2.5 * error)
    assert speed == pytest.approx(0.6 * math.cos(error) ** 2)


def test_pursuit_turns_on_the_spot_beyond_45_degrees():
    for heading, turns in ((0.7, -1.0), (0.8, -1.0), (-0.8, 1.0), (0.3, -0.75)):
        speed, turn, _, _ = pursue(STRAIGHT, 0, np.array([1.0, 0.0, heading]), PURSUIT)
        assert turn == pytest.approx(turns)
        assert (speed == 0.0) == (abs(heading) > math.pi / 4)
    _, turn, _, _ = pursue(STRAIGHT, 0, np.array([1.0, 0.0, -math.pi + 0.1]), PURSUIT)
    assert turn == 1.0  # the short way round


def test_pursuit_brakes_for_the_end_and_arrives():
    near = np.array([9.7, 0.0, 0.0])
    speed, _, _, arrived = pursue(STRAIGHT, 0, near, PURSUIT._replace(tolerance=0.1))
    assert not arrived
    assert speed == pytest.approx(0.6)
    slow = PURSUIT._replace(tolerance=0.1, braking=0.2)
    speed, _, _, _ = pursue(STRAIGHT, 0, near, slow)
    assert speed == pytest.approx(math.sqrt(2.0 * 0.2 * 0.3))
    for x, done in ((9.79, False), (9.81, True), (10.1, True)):
        assert pursue(STRAIGHT, 0, np.array([x, 0.0, 0.0]), PURSUIT)[3] == done


def test_pursuit_heads_for_the_last_waypoint_when_the_lookahead_ends_beyond_it():
    corner = path((0, 0), (1.0, 0), (1.4, 0.3))
    pose = np.array([1.1, 0.0, 0.5])
    speed, turn, _, _ = pursue(corner, 1, pose, PURSUIT)
    error = math.atan2(0.3, 0.3) - 0.5
    assert turn == pytest.approx(2.5 * error)
    assert speed == pytest.approx(0.6 * math.cos(error) ** 2)


def test_pursuit_sums_what_remains_over_segments():
    corner = path((0, 0), (1.0, 0), (1.0, 0.3))
    slow = PURSUIT._replace(braking=0.1, tolerance=0.1, lookahead=0.3)
    speed, turn, segment, _ = pursue(corner, 0, np.array([0.5, 0.0, 0.0]), slow)
    assert (turn, segment) == (0.0, 0)
    assert speed == pytest.approx(math.sqrt(2.0 * 0.1 * 0.8))


def test_pursuit_looks_round_the_corner_along_the_path():
    corner = path((0, 0), (1.0, 0), (1.0, 3.0))
    speed, turn, segment, _ = pursue(corner, 0, np.array([0.8, 0.0, 0.0]), PURSUIT)
    assert segment == 0
    error = math.atan2(0.3, 0.2)  # 0.2 m to the corner, 0.3 m beyond it
    assert error > math.pi / 4
    assert (speed, turn) == (0.0, 1.0)
    speed, turn, _, _ = pursue(corner, 0, np.array([0.7, 0.0, 0.0]), PURSUIT)
    assert turn == pytest.approx(min(1.0, 2.5 * math.atan2(0.2, 0.3)))
    assert speed == pytest.approx(0.6 * math.cos(math.atan2(0.2, 0.3)) ** 2)


def test_pursuit_goes_on_to_the_next_segment_when_one_is_passed():
    corner = path((0, 0), (1.0, 0), (1.0, 3.0))
    for pose, expected in (((0.85, 0.0), 0), ((0.95, 0.0), 1), ((1.02, 0.1), 1), ((1.0, 2.0), 1)):
        assert pursue(corner, 0, np.array([*pose, 1.5]), PURSUIT)[2] == expected
    assert pursue(corner, 1, np.array([0.5, 0.0, 1.5]), PURSUIT)[2] == 1  # never back


def test_a_path_that_returns_to_its_start_is_driven_whole():
    loop = path((0, 0), (2, 0), (2, 2), (0, 0.1))
    speed, _, segment, arrived = pursue(loop, 0, np.array([0.0, 0.05, 0.0]), PURSUIT)
    assert (segment, arrived) == (0, False)
    assert speed > 0.0
    assert pursue(loop, 2, np.array([0.0, 0.15, 0.0]), PURSUIT)[3]


def test_repeated_waypoints_and_single_ones_do_no_harm():
    repeated = path((0, 0), (0, 0), (5, 0))
    speed, turn, _, _ = pursue(repeated, 0, np.array([0.0, 0.0, 0.0]), PURSUIT)
    assert (speed, turn) == (0.6, 0.0)
    assert pursue(path((1, 0)), 0, np.array([0.9, 0.0, 0.0]), PURSUIT)[3]
    speed, turn, _, arrived = pursue(path((1, 0)), 0, np.array([0.0, 0.0, 0.0]), PURSUIT)
    assert (speed, turn, arrived) == (0.6, 0.0, False)


POSES = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 1.0], [0.0, 4.0, 0.0]])
RADII = np.array([0.1, 0.2, 0.5])


def test_the_nearest_other_vehicle_is_not_the_vehicle_itself():
    assert smallest_gap(POSES, RADII, 0, 0.0, 0.0) == pytest.approx(3.0 - 0.3)
    assert smallest_gap(POSES, RADII, 1, 0.0, 1.0) == pytest.approx(1.0 - 0.3)
    assert smallest_gap(POSES, RADII, 1, 0.0, 2.1) == pytest.approx(1.9 - 0.7)  # the large one
    assert smallest_gap(POSES, RADII, 0, 2.8, 0.0) == pytest.approx(-0.1)
    assert smallest_gap(POSES[:1], RADII[:1], 0, 0.0, 0.0) == np.inf


def test_distance_to_others_straight_ahead():
    assert distance_to_others(POSES, RADII, 0, 0.2) == pytest.approx(3.0 - 0.5)
    turned = POSES.copy()
    turned[0, 2] = math.pi / 2
    assert distance_to_others(turned, RADII, 0, 0.2) == pytest.approx(4.0 - 0.8)
    turned[0, 2] = math.pi
    assert distance_to_others(turned, RADII, 0, 0.2) == np.inf
    assert distance_to_others(POSES[:1], RADII[:1], 0, 0.2) == np.inf
