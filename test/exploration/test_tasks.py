"""Tasks and the plans that rights of way allow."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from explore_slam.exploration import VehicleSnapshot
from explore_slam.exploration.progress import Progress
from explore_slam.exploration.tasks import Task, make_plan, plan_for
from explore_slam.exploration.traffic import Grant, RightOfWay, Traveler
from explore_slam.geometry import Pose2

PATH = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
SCENE = SimpleNamespace(now=7.0, vehicles={'a': VehicleSnapshot(Pose2(0.0, 0.0, 0.3))})


def make_task():
    return Task((4.0, 3.0), PATH, (9.0, 3.0), Progress(0.0))


def traveler(path=PATH):
    return Traveler('a', path[0], path)


def plan(task, grant, retreat=None, path=PATH):
    return plan_for(SCENE, task, grant, traveler(path), retreat)


def test_a_vehicle_that_may_go_gets_its_whole_path_and_faces_the_unknown():
    task = make_task()
    first = plan(task, Grant())
    assert (first.stamp, first.vehicle) == (7.0, 'a')
    np.testing.assert_array_equal(first.waypoints, PATH)
    assert tuple(first.goal) == (4.0, 3.0, 0.0)
    assert plan(task, Grant()) is first


def test_a_stop_cuts_the_path_and_small_changes_of_it_do_not_matter():
    task = make_task()
    first = plan(task, Grant(RightOfWay.STOP, 5.0))
    assert first.waypoints[-1].tolist() == [4.0, 1.0]
    assert first.goal.theta == pytest.approx(math.pi / 2)
    assert plan(task, Grant(RightOfWay.STOP, 5.45)) is first
    later = plan(task, Grant(RightOfWay.STOP, 5.55))
    assert later is not first
    assert later.waypoints[-1].tolist() == pytest.approx([4.0, 1.55])
    gone = plan(task, Grant())
    assert gone.waypoints[-1].tolist() == [4.0, 3.0]
    assert plan(task, Grant(RightOfWay.STOP, 5.0)) is not gone


def test_a_path_to_a_stop_close_by_is_not_driven():
    task = make_task()
    assert plan(task, Grant(RightOfWay.STOP, 0.29)) is None
    assert (task.right, task.sent) == (RightOfWay.STOP, None)
    assert plan(task, Grant(RightOfWay.STOP, 0.31)) is not None


def test_a_retreat_replaces_the_plan_and_is_kept_while_it_leads_to_the_same_place():
    task = make_task()
    before = plan(task, Grant())
    way = np.array([[0.0, 0.0], [0.0, -2.0]])
    first = plan(task, Grant(RightOfWay.RETREAT, 0.0, 'b', way))
    np.testing.assert_array_equal(first.waypoints, way)
    assert first.goal.theta == pytest.approx(-math.pi / 2)
    near = Grant(RightOfWay.RETREAT, 0.0, 'b', way + [[0.0, 0.0], [0.4, 0.0]])
    far = Grant(RightOfWay.RETREAT, 0.0, 'b', way + [[0.0, 0.0], [0.6, 0.0]])
    assert plan(task, near, first) is first
    assert plan(task, far, first) is not first
    assert plan(task, Grant()) is not before
    assert plan(None, near, first) is first


def test_without_a_task_there_is_no_plan():
    assert plan(None, Grant()) is None
    assert plan(None, Grant(RightOfWay.STOP, 5.0)) is None


def test_the_goal_faces_along_the_path_or_where_the_vehicle_faces():
    along = make_plan(SCENE, 'a', PATH, None)
    assert along.goal.theta == pytest.approx(math.pi / 2)
    assert make_plan(SCENE, 'a', PATH[:1], None).goal.theta == 0.3
    assert make_plan(SCENE, 'a', PATH, (4.0, 3.0)).goal.theta == pytest.approx(math.pi / 2)
    assert make_plan(SCENE, 'a', PATH, (3.0, 2.0)).goal.theta == pytest.approx(-3 * math.pi / 4)


def test_a_task_leads_to_targets_within_half_a_metre():
    assert make_task().leads_to((4.3, 3.4))
    assert not make_task().leads_to((4.31, 3.41))


@pytest.mark.parametrize('right', list(RightOfWay))
def test_another_path_keeps_what_is_known_of_the_task(right):
    task = make_task()
    task.sent, task.right, task.switches = plan(task, Grant()), right, 3
    task.progress = Progress(2.0, 5.0, 1)
    again = task.along(PATH[:2], (4.1, 3.0), None)
    assert (again.target, again.look_at) == ((4.1, 3.0), None)
    assert (again.right, again.switches) == (right, 3)
    assert again.sent is (None if right is RightOfWay.GO else task.sent)
    assert again.progress == Progress(2.0, math.inf, 1)
    assert again.path is not task.path
