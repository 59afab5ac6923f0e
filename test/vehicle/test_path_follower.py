import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from explore_slam.data import LaserScan, OdometryReading, Plan, SweepTiming
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mounts import STOCK_LASER_X
from explore_slam.settings import with_values
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


# -- single commands, by hand ---------------------------------------------------------------------


def follower(waypoints, pose=IDENTITY, points=None, **settings):
    """Return a follower with plan, pose, odometry and scan of time 0; points: laser returns."""
    made = PathFollower(config_with(settings))
    made.set_plan(plan_along(waypoints), 0.0)
    locate(made, 0.0, pose)
    made.set_scan(scan_of(points), 0.0)
    return made


def config_with(settings):
    return with_values(PathFollowerConfig(), {'laser_x': 0.0, **settings})


def plan_along(waypoints, stamp=0.0):
    points = np.asarray(waypoints, dtype=float).reshape(-1, 2)
    goal = points[-1] if len(points) else (math.nan, math.nan)
    return Plan(stamp, 'robot1', Pose2(*goal, 0.0), points)


def locate(made, now, pose):
    made.set_odometry(OdometryReading(now, pose), now)
    made.set_pose(now, pose, now)


def scan_of(points):
    """Return a scan of one beam per point (x, y); the angles are chosen to fit."""
    if points is None:
        return LaserScan(0.0, 0.0, 0.1, np.full(1, np.inf, np.float32), 0.02, 8.0)
    [(x, y)] = points
    ranges = np.array([math.hypot(x, y)], np.float32)
    return LaserScan(0.0, math.atan2(y, x), 0.1, ranges, 0.02, 8.0)


def steady(made, now=0.0, speed=0.4):
    """Return the next command of a follower that drives at this speed (m/s)."""
    made._motion.linear = speed
    made._times.last_command = now - 10.0
    return made.command(now)


def test_speed_rises_with_the_acceleration_and_falls_twice_as_fast():
    made = follower([[0, 0], [20, 0]])
    assert made.command(0.0).linear == pytest.approx(0.5 / 20.0)  # one period of control
    assert made.command(0.1).linear == pytest.approx(0.025 + 0.05)
    fast = follower([[0, 0], [20, 0]], follow_speed=0.1)
    fast._motion.linear = 0.4
    fast._times.last_command = 0.0
    assert fast.command(0.1).linear == pytest.approx(0.4 - 2.0 * 0.05)


def test_a_gap_between_commands_counts_as_half_a_second():
    made = follower([[0, 0], [20, 0]], follow_acceleration=0.2)
    made._times.last_command = -5.0
    assert made.command(0.0).linear == pytest.approx(0.2 * 0.5)


@pytest.mark.parametrize(('speed', 'lookahead'), [(0.4, 0.32), (0.1, 0.22)])
def test_curvature_leads_through_the_lookahead_point(speed, lookahead):
    """An arc from the pose, tangent to its heading, through the point ahead on the path."""
    made = follower([[0, 0], [20, 0]], Pose2(1.0, -0.1, 0.0), follow_speed=speed)
    command = steady(made, speed=speed)
    curvature = 2.0 * 0.1 / (lookahead**2 + 0.1**2)
    expected = min(speed, 0.9 / curvature)
    assert command.linear == pytest.approx(expected)
    assert command.angular == pytest.approx(min(expected * curvature, 0.9, 2.5 * 0.5))


def test_turn_rate_and_its_acceleration_are_limited():
    made = follower([[0, 0], [20, 0]], Pose2(1.0, -0.15, 0.0), follow_turn_acceleration=1.0)
    made._times.last_command = -0.1
    made._motion.linear = 0.4
    assert made.command(0.0).angular == pytest.approx(0.1)
    made._times.last_command = -9.0
    made._motion.angular = 0.8
    assert made.command(0.0).angular <= 0.9


def test_turning_on_the_spot_has_a_hysteresis():
    """It begins beyond 0.9 rad and ends below 0.35 of that; the turn rate is twice the bearing."""
    made = follower([[0, 0], [20, 0]], Pose2(1.0, 0.0, -1.0))
    command = steady(made, speed=0.0)
    assert (command.linear, command.reason) == (0.0, 'turning to the plan')
    assert command.angular == pytest.approx(0.9)
    cases = ((-0.5, True), (-0.33, True), (-0.30, False), (-0.8, False))
    for now, (heading, turns) in zip((0.1, 0.2, 0.3, 0.4), cases, strict=True):
        locate(made, now, Pose2(1.0, 0.0, heading))
        command = made.command(now)
        assert (command.reason == 'turning to the plan') == turns
        if turns:
            assert command.angular == pytest.approx(min(2.0 * -heading, 0.9))


def test_braking_for_the_goal():
    made = follower([[0, 0], [2.0, 0]], Pose2(1.88 - 0.05, 0.0, 0.0))
    assert steady(made).linear == pytest.approx(min(0.4, math.sqrt(2 * 0.5 * 0.17)))
    slow = follower([[0, 0], [2.0, 0]], Pose2(1.83, 0.0, 0.0), follow_acceleration=0.05)
    assert steady(slow, speed=0.13).linear == pytest.approx(math.sqrt(2 * 0.05 * 0.17))
    assert slow.progress.remaining == pytest.approx(0.17)


def test_the_last_centimetres_are_crept():
    made = follower(
        [[0, 0], [2.0, 0]], Pose2(1.97, 0.0, 0.0), follow_acceleration=0.05, arrival_tolerance=0.02
    )
    locate(made, 0.0, Pose2(1.975, 0.0, 0.0))
    assert steady(made, speed=0.05).linear == pytest.approx(math.sqrt(2 * 0.05 * 0.025))
    tighter = follower(
        [[0, 0], [2.0, 0]], Pose2(1.985, 0.0, 0.0), follow_acceleration=0.05,
        arrival_tolerance=0.01,
    )  # fmt: skip
    assert steady(tighter, speed=0.05).linear == 0.05


def test_arrival_needs_the_end_of_the_path_not_only_its_place():
    loop = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0.05]]
    made = follower(loop, Pose2(0.0, 0.0, 0.0))
    assert made.command(0.0).state is FollowerState.DRIVING
    line = follower([[0, 0], [2, 0]], Pose2(1.9, 0.0, 0.0))
    assert line.command(0.0).state is FollowerState.ARRIVED
    locate(line, 0.1, Pose2(1.0, 0.0, 0.0))  # pushed away: a goal reached stays reached
    assert line.command(0.1).state is FollowerState.ARRIVED
    aside = follower([[0, 0], [2, 0]], Pose2(1.95, 0.13, 0.0))
    assert aside.command(0.0).state is not FollowerState.ARRIVED


@pytest.mark.parametrize('distance', [0.8, 1.0])
def test_the_speed_before_an_obstacle_allows_to_stop(distance):
    """Room = free - stop distance; 0.35 s of reaction, then 0.6 of the acceleration."""
    made = follower([[0, 0], [20, 0]], points=[(distance, 0.0)], follow_speed=1.5)
    speed = steady(made, speed=1.5 if distance > 2 else 0.5).linear
    room = distance - 0.25 - 0.2  # body radius, stop distance
    assert made.progress.free == pytest.approx(distance - 0.25, abs=1e-6)
    assert speed * 0.35 + speed**2 / (2 * 0.6 * 0.5) == pytest.approx(room, abs=1e-6)


def test_a_vehicle_stopped_by_an_obstacle_starts_again_with_5_cm_to_spare():
    made = follower([[0, 0], [20, 0]], points=[(0.44, 0.0)])
    stopped = made.command(0.0)
    assert (stopped.linear, stopped.state) == (0.0, FollowerState.WAITING)
    assert stopped.reason == 'obstacle 0.19 m ahead'
    for distance, drives in ((0.49, False), (0.51, True), (0.46, True)):
        made.set_scan(scan_of([(distance, 0.0)]), 0.0)
        assert (made.command(0.0).state is FollowerState.DRIVING) == drives


@pytest.mark.parametrize(('end', 'drives'), [(0.10, True), (0.13, True), (0.18, False)])
def test_a_plan_that_ends_beside_a_wall_is_driven_to_its_end(end, drives):
    made = follower([[-1, 0], [end, 0]], points=[(0.44, 0.0)], arrival_tolerance=0.01)
    command = steady(made, speed=0.02)  # 0.19 m are free
    assert (command.linear > 0.0) is drives
    assert (command.state is FollowerState.DRIVING) is drives


def test_a_plan_that_ends_behind_an_obstacle_stops_at_the_usual_distance(make_track):
    track = make_track([[0, 0], [3, 0]], obstacles=[(2.9, 0.0, 0.1)], latency=0.05).run(20)
    assert track.last.state is FollowerState.BLOCKED
    assert track.clearance() >= 0.15


def test_before_an_obstacle_that_leaves_hardly_any_room_it_creeps():
    made = follower([[0, 0], [20, 0]], points=[(0.4505, 0.0)])
    assert steady(made, speed=0.02).linear == pytest.approx(0.02)


def test_an_obstacle_blocks_after_its_timeout():
    made = follower([[0, 0], [20, 0]], points=[(0.4, 0.0)], stuck_timeout=120.0)
    for now, state in ((0.5, 'waiting'), (3.4, 'waiting'), (3.6, 'blocked')):
        locate(made, now, IDENTITY)
        made.set_scan(scan_of([(0.4, 0.0)]), now)
        assert made.command(now).state.value == state


def test_obstacles_count_on_the_arc_and_on_gentle_arcs_straight_ahead_too():
    aside = [(1.0, -0.4)]
    straight = follower([[0, 0], [20, 0]], points=aside)
    straight.command(0.0)
    assert straight.progress.free == math.inf
    ahead = follower([[0, 0], [20, 1.0]], points=[(2.0, -0.15)])  # gentle: 0.5 m beside the arc
    ahead.command(0.0)
    assert ahead.progress.free < 2.0


def test_the_scan_is_moved_by_the_odometry_since_then():
    made = follower([[0, 0], [20, 0]], points=[(2.0, 0.0)])
    locate(made, 0.1, Pose2(0.5, 0.0, 0.0))
    made.command(0.1)
    assert made.progress.free == pytest.approx(1.5 - 0.25, abs=1e-6)


@pytest.mark.parametrize(
    ('part', 'limit', 'word'),
    [('plan', 2.0, 'agent'), ('odometry', 0.5, 'odometry'), ('scan', 0.6, 'laser')],
)
def test_each_silence_stops_at_its_timeout(part, limit, word):
    made = follower([[0, 0], [20, 0]])
    for now, stops in ((limit - 0.01, False), (limit + 0.01, True)):
        if part != 'plan':
            made.set_plan(made.plan, now)
        if part != 'odometry':
            made.set_odometry(OdometryReading(now, IDENTITY), now)
        if part != 'scan':
            made.set_scan(scan_of(None), now)
        command = made.command(now)
        assert (command.reason == f'{word} silent for {now:.1f} s') == stops


def test_an_old_map_pose_and_a_silent_heartbeat_stop():
    made = follower([[0, 0], [20, 0]], pose_timeout=1.0)
    made.set_plan(made.plan, 1.05)
    made.set_odometry(OdometryReading(1.05, IDENTITY), 1.05)
    made.set_scan(scan_of(None), 1.05)
    assert made.command(1.05).reason == 'map pose silent for 1.1 s'
    made = follower([[0, 0], [20, 0]])
    assert made.command(0.0, 0.25).state is FollowerState.DRIVING
    assert made.command(0.0, 0.26).reason == "agent's heartbeat silent for 0.3 s"


def test_what_has_never_come_is_named_in_turn():
    made = PathFollower(config_with({}))
    assert made.command(0.0).reason == 'no plan yet'
    made.set_plan(plan_along([[0, 0], [20, 0]]), 0.0)
    assert made.command(0.0).reason == 'no odometry yet'
    made.set_odometry(OdometryReading(0.0, IDENTITY), 0.0)
    assert made.command(0.0).reason == 'no map pose yet'
    made.set_pose(0.0, IDENTITY, 0.0)
    assert made.command(0.0).reason == 'no laser yet'
    made.configure(config_with({'obstacle_stop': False}))
    assert made.command(0.0).state is FollowerState.DRIVING


def test_no_progress_is_reported_and_a_plan_to_the_same_goal_is_no_progress():
    made = follower([[0, 0], [20, 0]], stuck_timeout=2.0)
    made.command(0.0)
    for now, waypoints, blocked in (
        (1.9, [[0, 0], [20, 0]], False),
        (2.1, [[0, 0], [10, 0.0], [20, 0.04]], True),
        (2.2, [[0, 0], [15, 0]], False),
    ):
        made.set_plan(plan_along(waypoints), now)
        locate(made, now, IDENTITY)
        made.set_scan(scan_of(None), now)
        command = made.command(now)
        assert (command.state is FollowerState.BLOCKED) == blocked
        assert (command.reason == f'no progress for {now:.0f} s') == blocked


def test_5_cm_or_005_rad_are_progress():
    made = follower([[0, 0], [20, 0]], stuck_timeout=2.0, agent_timeout=60.0)
    made.command(0.0)
    for now, x, blocked in ((1.5, 0.04, False), (2.1, 0.04, True), (2.2, 0.06, False)):
        locate(made, now, Pose2(x, 0.0, 0.0))
        made.set_scan(scan_of(None), now)
        assert (made.command(now).state is FollowerState.BLOCKED) == blocked
    turning = follower([[0, 0], [20, 0]], Pose2(0.0, 0.0, 2.5), stuck_timeout=2.0)
    turning.command(0.0)
    for now, heading, blocked in ((1.5, 2.46, False), (2.1, 2.46, True), (2.2, 2.44, False)):
        locate(turning, now, Pose2(0.0, 0.0, heading))
        turning.set_plan(turning.plan, now)
        turning.set_scan(scan_of(None), now)
        assert (turning.command(now).state is FollowerState.BLOCKED) == blocked


def test_deviation_is_reported_beyond_its_limit_with_its_sign():
    for y, blocked in ((0.95, False), (-0.95, False), (1.05, True), (-1.05, True)):
        made = follower([[0, 0], [20, 0]], Pose2(2.0, y, 0.0))
        command = made.command(0.0)
        assert made.progress.cross_track == pytest.approx(y)
        assert made.progress.remaining == pytest.approx(18.0 + abs(y))
        assert (command.reason == f'{abs(y):.2f} m off the plan') == blocked


@pytest.mark.parametrize(
    ('first', 'again', 'x'),
    [
        ([[0, 0], [10, 5], [20, 0]], [[0, 0], [20, 0]], 0.0),
        ([[20, 0]], [[20, 0.03]], 19.5),
    ],
)
def test_another_path_to_the_same_goal_is_no_progress_either(first, again, x):
    made = follower(first, Pose2(x, 0.0, 0.0), stuck_timeout=2.0)
    made.command(0.0)
    for now, blocked in ((1.5, False), (2.1, True)):
        made.set_plan(plan_along(again), now)
        locate(made, now, Pose2(x, 0.0, 0.0))
        made.set_scan(scan_of(None), now)
        assert (made.command(now).state is FollowerState.BLOCKED) == blocked


@pytest.mark.parametrize('wheels', [20.0, 5.0])
@pytest.mark.parametrize(
    ('begin', 'timing', 'stated'),
    [(0.0, SweepTiming(), 0.4), (0.4, SweepTiming(0.4, 'backward', 'last'), 0.0)],
)
def test_obstacles_are_where_they_are_although_the_beams_are_measured_one_by_one(
    begin, timing, stated, wheels
):
    """A wall at 4 m is seen while the vehicle drives 0.5 m/s and turns a little."""
    follower = PathFollower()
    follower.set_plan(
        Plan(0.0, 'robot1', Pose2(6.0, 0.0, 0.0), np.array([[0.0, 0.0], [6.0, 0.0]]))
    )

    def pose(time):
        return Pose2(0.5 * time, 0.0, 0.3 * (time - 2.4))

    for stamp in np.arange(0.0, 2.3, 1.0 / wheels):
        follower.set_odometry(OdometryReading(float(stamp), pose(stamp)))
        follower.set_pose(float(stamp), pose(stamp))
    beams = 720
    angles = -math.pi + 2.0 * math.pi / beams * np.arange(beams)
    shares = np.arange(beams) / (beams - 1)
    at = [pose(2.0 + 0.4 * share) for share in (1.0 - shares if begin else shares)]
    x, heading = np.array(
        [(place.x + STOCK_LASER_X * math.cos(place.theta), place.theta) for place in at]
    ).T
    with np.errstate(divide='ignore'):
        ranges = (4.0 - x) / np.cos(angles + heading)
    ranges[(ranges < 0.0) | (ranges > 8.0)] = np.inf
    scan = LaserScan(
        2.0 + begin, angles[0], angles[1] - angles[0], ranges.astype(np.float32), 0.02, 8.0,
        time_increment=stated / (beams - 1), timing=timing,
    )  # fmt: skip
    follower.set_scan(scan)
    command = follower.command(2.4)
    assert command.state is FollowerState.DRIVING
    radius = follower.config.body.vehicle_radius
    assert follower.progress.free == pytest.approx(4.0 - 1.2 - radius, abs=0.012)
    follower.set_scan(replace(scan, timing=SweepTiming(0.0)))
    follower.command(2.4)
    assert follower.progress.free != pytest.approx(4.0 - 1.2 - radius, abs=0.05)
