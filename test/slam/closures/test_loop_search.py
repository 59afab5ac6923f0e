"""Loops are found, within and between vehicles; wrong ones are rejected or retracted."""

import math

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of
from slam.closures.drives import Vehicle, along, drive

from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import scan_cloud
from explore_slam.slam.closures import ClosureConfig, LoopSearch

# an office floor of 14 m x 10 m around a core; nothing is like anything else
OUTER = polyline(
    (0.0, 0.0), (6.0, 0.0), (6.0, -1.5), (8.0, -1.5), (8.0, 0.0), (14.0, 0.0), (14.0, 4.0),
    (15.0, 4.0), (15.0, 6.5), (14.0, 6.5), (14.0, 10.0), (3.0, 10.0), (3.0, 11.0), (1.0, 11.0),
    (1.0, 10.0), (0.0, 10.0), (0.0, 0.0),
)  # fmt: skip
CORE = np.vstack([box(3.0, 3.0, 6.5, 7.0), box(8.0, 2.8, 11.0, 6.8), box(6.5, 4.0, 8.0, 5.0)])
OFFICE = np.vstack([OUTER, CORE])
FURNITURE = np.vstack([box(1.0, 4.0, 1.4, 5.0), box(5.0, 0.3, 5.8, 0.8), box(9.0, 8.9, 10.0, 9.6)])
MOVED = np.vstack([box(0.4, 6.0, 0.9, 6.7), box(9.3, 0.2, 10.2, 0.7), box(5.6, 9.2, 6.4, 9.7)])
LAP = [(1.8, 1.4), (12.4, 1.3), (12.6, 8.5), (1.7, 8.6), (1.8, 1.4)]


def lap_and_a_half():
    return along(*LAP, *LAP[1:3])


@pytest.mark.parametrize('calibrated', [False, True])
def test_a_loop_is_closed_and_the_drift_put_right(calibrated):
    path = lap_and_a_half()
    vehicle = Vehicle(path, way_scale=1.02, turn_scale=1.01, noise=0.01)
    run = drive(lambda *_: np.vstack([OFFICE, FURNITURE]), [vehicle], calibrated=calibrated)
    open_loop = drive(lambda *_: OFFICE, [vehicle], config=ClosureConfig(closure_score=1.0))
    distances, turns = run.errors()
    assert len(distances) >= 5
    assert distances.max() < 0.1
    assert turns.max() < 0.02

    def mean_error(graph):
        return np.mean([math.dist(a[:2], b[:2]) for a, b in zip(graph.path(), path, strict=True)])

    assert open_loop.search.closures == []
    assert mean_error(open_loop.graph) > 0.2
    assert mean_error(run.graph) < 0.6 * mean_error(open_loop.graph)
    far = [c.keyframe_b - c.keyframe_a for c in run.search.closures]
    assert min(far) > 10


def test_furniture_moved_between_two_visits_does_not_keep_a_loop_open():
    path = lap_and_a_half()

    def world(keyframe, _vehicle):
        return np.vstack([OFFICE, FURNITURE if keyframe < len(along(*LAP)) else MOVED])

    run = drive(world, [Vehicle(path, way_scale=1.02, noise=0.01)])
    distances, turns = run.errors()
    assert len(distances) >= 3
    assert distances.max() < 0.15
    assert turns.max() < 0.03


def test_loops_close_between_the_paths_of_two_vehicles():
    world = np.vstack([OFFICE, FURNITURE])
    first = along(*LAP[:3])
    second = along((12.4, 8.4), (12.4, 1.5), (2.0, 1.4))
    predicted = Pose2(12.7, 8.1, second[0].theta + 0.03)
    run = drive(lambda *_: world, [Vehicle(first), Vehicle(second, start=predicted)])
    between_vehicles = [
        c
        for c in run.search.closures
        if run.search.anchors.of_keyframe(c.keyframe_a).vehicle
        != run.search.anchors.of_keyframe(c.keyframe_b).vehicle
    ]
    assert len(between_vehicles) >= 3
    distances, turns = run.errors()
    assert distances.max() < 0.15
    assert turns.max() < 0.03


def test_vehicles_side_by_side_do_not_close_on_each_other():
    """Nothing is there but the other vehicle: its body must not make a loop."""
    first = along((0.0, 0.0), (12.0, 0.0))
    second = along((0.0, 1.0), (12.0, 1.0))

    def world(keyframe, vehicle):
        x = first[min(keyframe // 2, len(first) - 1)].x
        body = (
            box(x - 0.3, 0.7, x + 0.3, 1.3) if vehicle == 0 else box(x - 0.3, -0.3, x + 0.3, 0.3)
        )
        return np.vstack([body, polyline((90.0, 90.0), (91.0, 90.0))])

    run = drive(world, [Vehicle(first), Vehicle(second)], sight=2.0 * math.pi)
    assert run.search.closures == []


def test_vehicles_without_common_frame_are_not_compared():
    search, poses = LoopSearch(ClosureConfig()), []
    for k, pose in enumerate(along((1.8, 1.4), (6.8, 1.4))):
        for vehicle in (0, 1):
            cloud = scan_cloud(scan_of(OFFICE, pose))
            number = 2 * k + vehicle
            poses.append(tuple(pose))
            search.add_anchor(number, vehicle, cloud, 0.5 * k, 100.0 * vehicle + k)
            assert search.search(number, np.array(poses), tied=[vehicle]) == []
    accepted = search.search(19, np.array(poses), tied=[0, 1])
    assert len(accepted) == 1
    assert np.abs(np.array(accepted[0].query_pose(np.array(poses))) - poses[19]).max() < 0.05


def test_closures_that_stay_inconsistent_are_retracted():
    path = lap_and_a_half()
    run = drive(lambda *_: OFFICE, [Vehicle(path, way_scale=1.01)])
    search = run.search
    count = len(search.closures)
    assert count >= 3
    distances = np.full(count, 2.0)
    distances[1] = 1e4
    wrong = search.closures[1]
    assert search.recheck(distances) == []
    assert search.recheck(np.full(count, 2.0)) == []  # it was consistent in between
    assert search.recheck(distances) == []
    assert search.recheck(distances) == []
    assert search.recheck(distances) == [wrong]
    assert len(search.closures) == count - 1
    assert wrong not in search.closures
    with pytest.raises(SlamError, match='squared distances'):
        search.recheck(np.zeros(count))


def test_bad_input_is_named_and_changes_nothing():
    search = LoopSearch(ClosureConfig())
    cloud = scan_cloud(scan_of(OFFICE, Pose2(2.0, 1.5, 0.0)))
    search.add_anchor(0, 0, cloud, 1.0, 0.0)
    with pytest.raises(SlamError, match='keyframe 0 has an anchor already'):
        search.add_anchor(0, 0, cloud, 2.0, 0.0)
    with pytest.raises(SlamError, match='expected at least 1'):
        search.add_anchor(1, 0, cloud, 0.5, 0.0)
    with pytest.raises(SlamError, match='distance_driven is nan'):
        search.add_anchor(1, 0, cloud, math.nan, 0.0)
    with pytest.raises(SlamError, match='keyframe 7 has no anchor'):
        search.search(7, np.zeros((8, 3)))
    with pytest.raises(SlamError, match='finite values'):
        search.search(0, np.full((1, 3), np.nan))
    with pytest.raises(SlamError, match=r'shape \(3,\)'):
        search.search(0, np.zeros(3))
    search.add_anchor(1, 0, cloud, 2.0, 0.0)
    with pytest.raises(SlamError, match='expected 2'):
        search.search(1, np.zeros((1, 3)))
    assert len(search.anchors) == 2
    assert search.search(1, np.array([IDENTITY, (1.0, 0.0, 0.0)])) == []
