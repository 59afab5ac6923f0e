import itertools
import math

import numpy as np
import pytest

from explore_slam.data import Plan
from explore_slam.geometry import Pose2
from explore_slam.vehicle import FollowerState, PathFollower, PathFollowerConfig

X = np.arange(0.0, 12.01, 0.05)
SLALOM = np.column_stack([X, 0.5 * np.sin(2 * np.pi * X / 4.0)])
LINE = [[0, 0], [6, 0]]


def arrived(track):
    return track.last is not None and track.last.state is FollowerState.ARRIVED


def cross_track(track, path):
    points = np.array(track.history)[:, None, 1:3]
    return np.min(np.linalg.norm(points - np.asarray(path)[None], axis=2), axis=1)


@pytest.mark.parametrize('latency', [0.05, 0.2])
def test_slalom_at_40_cm_per_second_stays_within_5_cm(make_track, latency):
    track = make_track(SLALOM, start=Pose2(0, 0, math.atan(math.pi / 4)), latency=latency)
    track.run(60, arrived)
    assert arrived(track)
    history = np.array(track.history)
    assert np.median(history[:, 4]) == pytest.approx(0.4, abs=0.01)
    assert np.sqrt(np.mean(cross_track(track, SLALOM) ** 2)) <= 0.03
    assert np.hypot(*(history[-1, 1:3] - SLALOM[-1])) < 0.15


def test_right_angles_and_a_plan_that_starts_behind_are_followed(make_track):
    corners = np.array([[0, 0], [2, 0], [2, 1.5], [0.5, 1.5]])
    track = make_track(corners, start=Pose2(0, 0, math.pi))
    track.run(3)
    moved = np.array(track.history)[:, 1:3]
    assert np.abs(moved).max() < 0.02  # turned on the spot first
    track.run(60, arrived)
    assert arrived(track)
    dense = np.vstack([np.linspace(a, b, 100) for a, b in itertools.pairwise(corners)])
    assert cross_track(track, dense).max() < 0.2


def test_a_path_that_crosses_itself_is_driven_whole(make_track):
    t = np.linspace(0, 2 * np.pi, 200)
    eight = np.column_stack([2 * np.sin(t), 1.5 * np.sin(2 * t)])
    track = make_track(eight, start=Pose2(0, 0, math.atan2(3, 2))).run(90, arrived)
    history = np.array(track.history)
    assert arrived(track)
    assert history[:, 1].max() > 1.8
    assert history[:, 1].min() < -1.8
    assert np.sqrt(np.mean(cross_track(track, eight) ** 2)) < 0.05


@pytest.mark.parametrize('latency', [0.05, 0.25])
@pytest.mark.parametrize('offset', [-0.2, 0.0, 0.15])
def test_stops_15_cm_before_an_obstacle_and_reports_blocked(make_track, latency, offset):
    track = make_track(LINE, obstacles=[(3.0, offset, 0.1)], latency=latency).run(20)
    assert track.last.state is FollowerState.BLOCKED
    assert 'obstacle' in track.last.reason
    assert 0.15 <= track.clearance() < 0.35
    track.obstacles.clear()
    track.run(20, arrived)
    assert arrived(track)


def test_stops_for_an_obstacle_that_appears_at_the_last_moment(make_track):
    track = make_track(LINE).run(60, lambda t: t.pose.x > 2.0)
    track.obstacles.append((2.0 + 0.25 + 0.2 + 0.35 + 0.1, 0.0, 0.1))  # 55 cm before the body
    track.run(5)
    assert track.velocity == [0.0, 0.0]
    assert track.clearance() >= 0.15


def test_passes_through_a_door_without_stopping(make_track):
    jambs = [(3.0, side * (0.4 + 0.05), 0.05) for side in (-1, 1)]  # 0.8 m wide
    track = make_track(LINE, obstacles=jambs).run(40, arrived)
    assert arrived(track)
    assert track.time < 20


@pytest.mark.parametrize(('part', 'timeout'), [('odometry', 0.5), ('laser', 0.6), ('agent', 2.0)])
def test_silence_stops_and_the_return_of_data_goes_on(make_track, part, timeout):
    track = make_track([[0, 0], [20, 0]]).run(4)
    assert track.velocity[0] == pytest.approx(0.4, abs=0.01)
    track.silent.add(part)
    track.run(timeout + 1.0 + 0.25)  # the longest period, latencies
    assert track.last.linear == 0.0
    assert track.last.state is FollowerState.WAITING
    assert part in track.last.reason
    track.silent.clear()
    track.run(3)
    assert track.last.state is FollowerState.DRIVING


def test_says_what_it_waits_for(make_track):
    track = make_track(LINE)
    assert track.follower.command(0.0).reason == 'no odometry yet'
    assert PathFollower().command(0.0).reason == 'no plan yet'


def test_an_empty_plan_stops(make_track):
    track = make_track(LINE).run(3)
    empty = Plan(track.time, 'robot1', Pose2(math.nan, math.nan, 0.0), np.empty((0, 2)))
    track.follower.set_plan(empty)
    track.run(1)
    assert track.velocity[0] == 0.0
    assert (track.last.state, track.last.reason) == (FollowerState.WAITING, 'no plan')


def test_too_far_from_the_plan_is_blocked(make_track):
    track = make_track(LINE, start=Pose2(1.0, 1.5, 0.0)).run(1)
    assert track.last.state is FollowerState.BLOCKED
    assert 'off the plan' in track.last.reason


def test_wheels_that_turn_without_getting_on_are_blocked(make_track):
    track = make_track(LINE, PathFollowerConfig(stuck_timeout=2.0)).run(3)
    for _ in range(400):
        track.velocity = [0.0, 0.0]  # held
        track.step()
    assert track.last.state is FollowerState.BLOCKED
    assert 'no progress' in track.last.reason


def test_time_that_jumps_back_is_survived(make_track):
    track = make_track([[0, 0], [20, 0]]).run(5)
    command = track.follower.command(1.0)
    assert command.linear == 0.0
    assert command.state is FollowerState.WAITING


def test_a_corrected_pose_is_taken_over(make_track):
    track = make_track([[0, 0], [20, 0]]).run(5)
    shifted = track.pose.compose(Pose2(0.0, 0.3, 0.0))
    track.silent.add('agent')
    track.follower.set_pose(track.time - 0.5, shifted, track.time)
    assert track.follower.map_pose(track.time).y == pytest.approx(0.3, abs=0.02)
    track.run(1.5)
    assert track.last.angular < 0.0 or track.pose.y < -0.02  # steers back to the plan
