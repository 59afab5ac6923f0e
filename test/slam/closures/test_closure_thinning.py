"""Closures of later visits go, those that tie what is new stay: a vehicle drives laps of 40 m."""

import math

import numpy as np
import pytest

from explore_slam.geometry import Pose2
from explore_slam.registration import PointCloud
from explore_slam.slam.closures import Anchor, Anchors, Closure, ClosureThinning

LAP = 40  # m and keyframes
UNEVALUATED = 15  # m and keyframes, the newest
EMPTY = PointCloud.empty()


def on_the_ring(k):
    angle = 2.0 * math.pi * k / LAP
    radius = LAP / (2.0 * math.pi)
    return radius * math.cos(angle), radius * math.sin(angle), angle


def closure(a, b):
    return Closure(a, b, Pose2(0.0, 0.0, 0.0), np.eye(3), 0.9, 0.9, 0.02)


class Laps:
    """Every keyframe after the first lap closes on the first, unless it is in a new room."""

    def __init__(self, count, room=(), blind=(), unevaluated=UNEVALUATED):
        self.poses = np.array([on_the_ring(k) for k in range(count)])
        self.poses[list(room), 0] += 100.0
        self.anchors, self.thinning = Anchors(), ClosureThinning()
        for k in range(count):
            self.anchors.add(Anchor(k, 0, float(k), float(k), EMPTY))
        closed = [k for k in range(LAP, count) if k not in room and k not in blind]
        self.closures = [closure(k % LAP, k) for k in closed]
        self.thinning.add(self.closures, self.anchors)
        self.evaluated = set(range(count - unevaluated))
        for k in closed:
            if k in self.evaluated:
                self.anchors.remove(k)

    def thin(self):
        """Drop what is redundant; return the keyframes with closures that are left."""
        gone = self.thinning.redundant(self.closures, self.poses, self.anchors, self.evaluated)
        self.thinning.forget(gone)
        self.closures = [c for c in self.closures if c not in gone]
        return [c.keyframe_b for c in self.closures]


def test_the_closures_of_the_first_visit_and_the_newest_are_left():
    count = 6 * LAP
    left = Laps(count).thin()
    frontier = count - UNEVALUATED
    # the end of the second lap is near its beginning: the second visit there
    assert left == [*range(LAP, 2 * LAP - 1), *range(frontier - 1, count)]


def test_the_number_of_closures_does_not_grow_with_the_laps():
    assert len(Laps(6 * LAP).thin()) == len(Laps(20 * LAP).thin())


def test_what_is_dropped_little_by_little_is_the_same():
    laps = Laps(6 * LAP)
    once = Laps(6 * LAP).thin()
    everything, laps.evaluated = laps.evaluated, set(range(3 * LAP))
    for k in range(3 * LAP, 6 * LAP - UNEVALUATED):
        laps.evaluated.add(k)
        laps.thin()
    assert laps.evaluated == everything
    assert laps.thin() == once
    assert laps.thin() == once


@pytest.mark.parametrize('late', [0, 9])
def test_a_new_room_stays_tied_in_however_often_its_entrance_was_passed(late):
    """late: keyframes after the room until the vehicle is found again."""
    room = range(5 * LAP + 10, 5 * LAP + 30)
    again = room.stop + late
    left = Laps(8 * LAP, room, range(room.stop, again)).thin()
    assert set(range(room.start - 2, room.start)) <= set(left)
    assert set(range(again, again + 2)) <= set(left)
    between = {k for k in left if 3 * LAP <= k < room.start - 2 or again + 2 <= k < 7 * LAP}
    assert between == set()


def test_a_loop_of_which_nothing_is_evaluated_yet_is_left_alone():
    laps = Laps(6 * LAP, unevaluated=5 * LAP)
    assert laps.thin() == list(range(LAP, 6 * LAP))


def test_visits_tied_to_keyframes_that_went_do_not_count():
    """Closures on a later lap, whose anchors went, do not replace those on the first."""
    laps = Laps(6 * LAP)
    ends = [(k % LAP if k >= 4 * LAP else k - LAP, k) for k in range(2 * LAP, 6 * LAP)]
    laps.anchors = Anchors()
    for k in range(6 * LAP):
        laps.anchors.add(Anchor(k, 0, float(k), float(k), EMPTY))
    laps.thinning, laps.closures = ClosureThinning(), [closure(*pair) for pair in ends]
    laps.thinning.add(laps.closures, laps.anchors)
    for k in range(LAP, 6 * LAP - UNEVALUATED):
        laps.anchors.remove(k)
    left = laps.thin()
    assert set(range(4 * LAP + 2, 5 * LAP - 2)) <= set(left)
    assert set(left).isdisjoint(range(5 * LAP + 2, 6 * LAP - UNEVALUATED - 2))


def test_the_state_is_restored():
    laps = Laps(6 * LAP)
    again = ClosureThinning.from_state(laps.thinning.state_dict())
    expected = laps.thinning.redundant(laps.closures, laps.poses, laps.anchors, laps.evaluated)
    found = again.redundant(laps.closures, laps.poses, laps.anchors, laps.evaluated)
    assert found == expected
    assert len(found) > 50
