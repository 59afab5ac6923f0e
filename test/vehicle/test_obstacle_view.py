"""What cameras see around a vehicle: remembered, forgotten, and respected by the path follower."""

import numpy as np
import pytest

from explore_slam.data import FollowerState, LaserScan, ObstacleView, OdometryReading, Plan
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.vehicle import PathFollower, PathFollowerConfig
from explore_slam.vehicle.dead_reckoning import DeadReckoning
from explore_slam.vehicle.obstacle_view import CameraView

TOP = 1 << 6
NO_RETURNS = np.empty((0, 2))


def view(stamp, x, occupied=TOP, free=0):
    """Return a view of cells across the way at a distance (cells), 0.5 m wide."""
    cells = np.array([(x, y) for y in range(-5, 5)], np.int16)
    return ObstacleView(
        stamp, cells, np.full(10, occupied, np.uint16), np.full(10, free, np.uint16)
    )


def standing(*stamps):
    reckoning = DeadReckoning()
    for stamp in stamps:
        reckoning.add_odometry(OdometryReading(stamp, IDENTITY))
    return reckoning


def test_obstacles_stay_where_they_are_as_the_vehicle_drives_on():
    reckoning = standing(0.0, 0.1)
    seen = CameraView(reckoning)
    seen.add(view(0.1, 30))
    reckoning.add_odometry(OdometryReading(1.1, Pose2(0.5, 0.0, 0.0)))
    assert seen.points(1.1, NO_RETURNS)[:, 0] == pytest.approx(1.525 - 0.5, abs=0.03)
    assert len(seen.points(1.1, NO_RETURNS)) == 10


def test_obstacles_are_forgotten_when_the_camera_looks_through_them_and_after_a_while():
    reckoning = standing(0.0, 0.1, 20.0)
    seen = CameraView(reckoning)
    seen.add(view(0.1, 30))
    seen.add(view(0.2, 20, occupied=0, free=TOP))
    assert len(seen.points(0.3, NO_RETURNS)) == 10  # free elsewhere
    seen.add(view(0.3, 30, occupied=0, free=TOP))
    assert len(seen.points(0.3, NO_RETURNS)) == 0
    seen.add(view(0.4, 30))
    seen.add(view(12.0, 90))
    assert len(seen.points(12.0, NO_RETURNS)) == 0


def test_views_of_several_cameras_add_up_whatever_their_order():
    seen = CameraView(standing(0.0, 0.1, 60.2))
    for _ in range(2):  # known ones change nothing
        seen.add(view(60.2, 30))
        seen.add(view(60.2, -30))
        seen.add(view(60.1, 20))
    assert len(seen.points(60.2, NO_RETURNS)) == 30
    seen.add(view(55.0, 10))  # old
    assert len(seen.points(60.2, NO_RETURNS)) == 30
    seen.add(view(0.1, 10))  # the clock has gone back
    assert len(seen.points(0.1, NO_RETURNS)) == 10


def test_walls_are_left_to_the_laser_and_far_obstacles_to_the_plan():
    seen = CameraView(standing(0.0, 0.1))
    seen.add(view(0.1, 30))
    wall = np.array([(1.5, 0.05 * k) for k in range(-8, 8)])
    assert len(seen.points(0.1, wall)) == 0
    assert len(seen.points(0.1, wall + (0.3, 0.0))) == 10
    far = CameraView(standing(0.0, 0.1))
    far.add(view(0.1, 50))
    assert len(far.points(0.1, NO_RETURNS)) == 0


def follower(has_laser=True, obstacle=None):
    """Return the distance that a follower drives of a plan of 2 m, and its last command."""
    made = PathFollower(PathFollowerConfig(), has_laser=has_laser)
    made.set_plan(Plan(0.0, 'a', Pose2(2.0, 0.0, 0.0), np.array([[0.0, 0.0], [2.0, 0.0]])))
    pose = IDENTITY
    for tick in range(300):
        now = 0.05 * tick
        made.set_odometry(OdometryReading(now, pose))
        made.set_pose(now, pose)
        if has_laser:
            made.set_scan(LaserScan(now, -1.0, 0.1, np.full(21, 9.0, np.float32), 0.1, 10.0))
        if obstacle is not None and tick == 1:
            made.set_obstacles(view(now, obstacle))
        command = made.command(now)
        turn = 0.05 * command.angular
        pose = pose.compose(Pose2(0.05 * command.linear, 0.0, turn))
    return pose.x, command


@pytest.mark.parametrize('has_laser', [True, False])
def test_a_vehicle_stops_before_what_its_camera_has_seen(has_laser):
    free, _ = follower(has_laser)
    assert free == pytest.approx(2.0, abs=0.2)
    # within its memory: the obstacle is at 1.0 m, the body has a radius of 0.25 m
    config = PathFollowerConfig()
    stopped, command = follower(has_laser, obstacle=20)
    assert stopped < 1.0 - config.body.vehicle_radius
    assert command.state in (FollowerState.WAITING, FollowerState.BLOCKED)
