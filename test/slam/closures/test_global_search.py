"""A vehicle of unknown start is found in the map, and not where rooms are equal."""

import math

import numpy as np
import pytest
from registration.ray_caster import scan_of
from slam.closures.drives import along, corridor_of_rooms
from slam.closures.test_loop_search import FURNITURE, LAP, OFFICE

from explore_slam.errors import SlamError
from explore_slam.geometry import Pose2
from explore_slam.registration import scan_cloud
from explore_slam.slam.closures import Anchors, ClosureConfig, GlobalSearch, join_transform
from explore_slam.slam.closures.anchors import Anchor

UNKNOWN = Pose2(-7.0, 4.0, 2.2)  # of the unlocalized vehicle's frame in the map


def joined(walls, first, second, random=None):
    """Let vehicle 1 drive along second in a frame of its own; return closures, distance driven."""
    random = random or np.random.default_rng(1)
    anchors, poses = Anchors(), []
    search = GlobalSearch(ClosureConfig(), anchors)
    for k, pose in enumerate(first):
        cloud = scan_cloud(scan_of(walls, pose, 0.01, random), farthest=20.0)
        anchors.add(Anchor(k, 0, 0.5 * k, float(k), cloud))
        poses.append(tuple(pose))
    distance_driven, steps = 0.0, 0
    for k, pose in enumerate(second):
        if k == len(second) // 4:  # candidates survive a checkpoint
            search = GlobalSearch.from_state(search.state_dict(), search.config, anchors)
        number = len(first) + k
        cloud = scan_cloud(scan_of(walls, pose, 0.01, random), farthest=20.0)
        distance_driven += math.dist(pose[:2], second[max(k - 1, 0)][:2])
        anchors.add(Anchor(number, 1, distance_driven, 1000.0 + k, cloud))
        poses.append(tuple(UNKNOWN.inverse().compose(pose)))
        if k % 3 == 0:
            for closures in search.search(number, np.array(poses), [0]):
                steps += 1
                if closures:
                    return closures, distance_driven, np.array(poses), steps
    return [], distance_driven, np.array(poses), steps


def test_an_unlocalized_vehicle_is_joined_to_the_map():
    walls = np.vstack([OFFICE, FURNITURE])
    first = along(*LAP)
    second = along(LAP[3], LAP[2], LAP[1], LAP[0], LAP[3])
    closures, distance_driven, poses, steps = joined(walls, first, second)
    assert len(closures) >= 4
    assert distance_driven < 30.0
    assert steps > 12  # it can be interrupted
    off = np.array(UNKNOWN.between(join_transform(closures, poses)))
    assert math.hypot(off[0], off[1]) < 0.15
    assert abs(off[2]) < 0.02


@pytest.mark.parametrize('period', [3.0, 4.0, 6.0])
def test_equal_rooms_do_not_join(period):
    """The unlocalized vehicle sees nothing but the middle of a corridor of equal rooms."""
    rooms = round(36.0 / period)
    walls = corridor_of_rooms(0.0, 0.0, period, rooms)
    first = along((1.0, 0.0), (35.0, 0.0))
    second = along((10.0, 0.0), (26.0, 0.0))
    closures, _, _, steps = joined(walls, first, second)
    assert steps > 20
    assert closures == []


def test_an_unlocalized_vehicle_elsewhere_is_not_joined():
    other = corridor_of_rooms(0.0, 0.0, 5.0, 7)
    random = np.random.default_rng(2)
    first = along(*LAP)
    walls = np.vstack([OFFICE, other + np.array([100.0, 0.0, 100.0, 0.0])])
    second = [Pose2(pose.x + 100.0, pose.y, pose.theta) for pose in along((1.0, 0.0), (30.0, 0.0))]
    closures, _, _, _ = joined(walls, first, second, random)
    assert closures == []


def test_candidates_of_a_removed_anchor_are_forgotten():
    walls = np.vstack([OFFICE, FURNITURE])
    first, second = along(*LAP), along(LAP[3], LAP[2], LAP[1])
    anchors, poses = Anchors(), [tuple(pose) for pose in first]
    random = np.random.default_rng(1)
    search = GlobalSearch(ClosureConfig(), anchors)
    for k, pose in enumerate(first):
        cloud = scan_cloud(scan_of(walls, pose, 0.01, random), farthest=20.0)
        anchors.add(Anchor(k, 0, 0.5 * k, float(k), cloud))
    for k, pose in enumerate(second):
        number = len(poses)
        cloud = scan_cloud(scan_of(walls, pose, 0.01, random), farthest=20.0)
        anchors.add(Anchor(number, 1, 0.5 * k, 1000.0 + k, cloud))
        poses.append(tuple(UNKNOWN.inverse().compose(pose)))
        if k >= 12 and k % 3 == 0:
            steps = search.search(number, np.array(poses), [0])
            next(steps)
            # what comes during the search is not part of it
            distance_driven = 0.5 * (len(first) + k)
            anchors.add(
                Anchor(number + 1, 0, distance_driven, 1000.0 + k, anchors.of_keyframe(k).cloud)
            )
            poses.append(tuple(first[k]))
            list(steps)
    assert len(search.pending) >= 2
    ends = {keyframe for c in search.pending for keyframe in (c.a.keyframe, c.b.keyframe)}
    search.remove_anchor(max(ends))
    left = {keyframe for c in search.pending for keyframe in (c.a.keyframe, c.b.keyframe)}
    assert max(ends) not in left
    assert search.pending


def test_bad_input_is_named():
    anchors = Anchors()
    search = GlobalSearch(ClosureConfig(), anchors)
    with pytest.raises(SlamError, match='keyframe 3 has no anchor'):
        next(search.search(3, np.zeros((4, 3)), [0]))
    anchors.add(Anchor(0, 0, 0.0, 0.0, scan_cloud(scan_of(OFFICE, Pose2(2.0, 1.5, 0.0)))))
    with pytest.raises(SlamError, match='vehicle 0 is already in the map'):
        next(search.search(0, np.zeros((1, 3)), [0]))
    with pytest.raises(SlamError, match='poses end at keyframe'):
        next(search.search(0, np.zeros((0, 3)), [1]))
    with pytest.raises(SlamError, match='no closures'):
        join_transform([], np.zeros((1, 3)))
