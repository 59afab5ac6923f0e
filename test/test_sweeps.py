"""Scans of spinning lidars as of one moment, and what is believed of when beams are measured."""

import logging
import math

import numpy as np
import pytest

from explore_slam.data import LaserScan, SweepTiming
from explore_slam.errors import ConfigError
from explore_slam.geometry import IDENTITY, Pose2, to_world
from explore_slam.settings import with_values
from explore_slam.simulation.worlds.walls import box, distances_along, distances_from
from explore_slam.sweeps import Sweep, SweepConfig, SweepJudge, deskewed

ROOM = np.concatenate([box(-4.0, -3.0, 8.0, 6.0), box(2.0, 1.0, 1.0, 1.0)])
BEAMS = 360
STEP = 2.0 * math.pi / BEAMS
MOUNT = Pose2(0.15, -0.05, 0.7)


def path(times):
    """Poses (T, 3) of a vehicle that turns by 0.9 rad/s while it drives 0.4 m/s, over +-pi."""
    heading = 3.0 + 0.9 * times
    x = 0.4 / 0.9 * (np.sin(heading) - math.sin(3.0))
    y = -0.4 / 0.9 * (np.cos(heading) - math.cos(3.0))
    return np.stack([x, y, heading], axis=1)


def scan_at(sweep, stamp=10.0, **changes):
    """A scan of the room without noise, its beams measured by the sweep."""
    angles = -math.pi + STEP * np.arange(BEAMS)
    poses = [Pose2.from_array(pose) for pose in path(stamp - 10.0 + sweep.times(BEAMS))]
    lasers = np.array([pose.compose(MOUNT) for pose in poses])
    ranges = distances_along(ROOM, lasers[:, :2], angles + lasers[:, 2])
    values = {'mount': MOUNT, **changes}
    return LaserScan(stamp, angles[0], STEP, ranges.astype(np.float32), 0.1, 9.0, **values)


def still(scan, sweep):
    """The scan as of one moment, by 50 poses per second, headings wrapped as odometry has them."""
    at = np.arange(9.0, 11.0, 0.02)
    poses = path(at - 10.0)
    poses[:, 2] = (poses[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return deskewed(scan, sweep, at, poses, MOUNT)


def off_walls(scan):
    """Distances (B,) m of the returns from the walls, placed by the true pose at the stamp."""
    laser = Pose2.from_array(path(np.array([scan.stamp - 10.0]))[0]).compose(MOUNT)
    directions = np.stack([np.cos(scan.angles), np.sin(scan.angles)], axis=1)
    return distances_from(ROOM, to_world(laser, directions * scan.ranges[:, None]))


@pytest.mark.parametrize('backward', [False, True])
@pytest.mark.parametrize('last', [False, True])
def test_returns_lie_on_the_walls_as_of_the_middle_of_the_sweep(backward, last):
    sweep = Sweep(0.18, backward, last)
    scan = scan_at(sweep)
    found = still(scan, sweep)
    assert found.stamp == pytest.approx(9.91 if last else 10.09)
    assert off_walls(found).max() < 0.002  # between odometry readings, poses are interpolated
    wrong = still(scan, Sweep(0.18, not backward, last))
    assert np.median(off_walls(wrong)) > 0.05


def test_a_scan_of_a_vehicle_that_stands_keeps_its_returns():
    scan = scan_at(Sweep(0.0))
    found = deskewed(scan, Sweep(0.2), np.array([9.0, 11.0]), np.ones((2, 3)), MOUNT)
    np.testing.assert_allclose(found.ranges, scan.ranges, rtol=1e-6)
    turn = np.angle(np.exp(1j * (found.angles - scan.angles)))
    np.testing.assert_allclose(turn, 0.0, atol=1e-6)
    assert found.mount == MOUNT


def test_beams_without_return_are_turned_and_limits_keep_their_meaning():
    ranges = np.array([np.inf, np.nan, -np.inf, 5.0, 8.5, 0.05, 1.0], np.float32)
    scan = LaserScan(0.0, -0.3, 0.1, ranges, 0.1, 8.0, IDENTITY)
    at, poses = np.array([0.0, 0.6]), np.array([[0.0, 0.0, 0.0], [-0.9, 0.0, 0.6]])
    found = deskewed(scan, Sweep(0.6), at, poses, IDENTITY)
    # the vehicle turns 0.1 rad from beam to beam, and is in the middle of the turn at beam 3
    np.testing.assert_allclose(found.angles[:3], [-0.6, -0.4, -0.2], atol=1e-6)
    assert found.ranges[0] == np.inf
    assert np.isnan(found.ranges[1])
    assert found.ranges[2] == -np.inf
    assert found.ranges[4] == np.inf  # beyond range_max: no return
    assert np.isnan(found.ranges[5])  # nearer than range_min: no measurement
    assert found.ranges[3] == pytest.approx(5.0)
    # beam 6 is measured 0.45 m from there against the x axis, at 0.3 + 0.3 rad to the left
    end = np.array([math.cos(0.6) - 0.45 * math.cos(0.3), math.sin(0.6) + 0.45 * math.sin(0.3)])
    assert found.ranges[6] == pytest.approx(np.hypot(*end))
    far = LaserScan(0.0, 0.0, 0.1, np.array([7.9, 7.9], np.float32), 0.1, 8.0, IDENTITY)
    ahead = deskewed(far, Sweep(0.6), at, np.array([[0.0] * 3, [0.9, 0.0, 0.0]]), IDENTITY)
    assert ahead.ranges[1] > 8.0
    assert ahead.range_max == ahead.ranges.max()  # it is still a return


def test_times_of_beams():
    assert Sweep(0.3).times(4) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert Sweep(0.3, backward=True).times(4) == pytest.approx([0.3, 0.2, 0.1, 0.0])
    assert Sweep(0.3, last=True).times(4) == pytest.approx([-0.3, -0.2, -0.1, 0.0])
    assert Sweep(0.3, last=True).middle == pytest.approx(-0.15)
    assert Sweep(0.3).times(1) == pytest.approx([0.0])


# -- what is believed -----------------------------------------------------------------------------

STATED = 0.18 / (BEAMS - 1)


def judged(scans, judge=None):
    judge = judge or SweepJudge('robot1')
    return [judge.sweep_of(scan) for scan in scans]


def scans_with(increment, rate=5.5, count=8, **changes):
    return [
        scan_at(Sweep(0.0), 10.0 + k / rate, time_increment=increment, **changes)
        for k in range(count)
    ]


def test_a_message_without_time_increment_is_of_one_moment():
    assert judged(scans_with(0.0)) == [None] * 8


def test_the_message_counts_and_its_first_beam_is_at_the_stamp():
    found = judged(scans_with(STATED))
    assert found == [Sweep(pytest.approx(0.18))] * 8


def test_settings_count_before_the_message():
    timing = SweepTiming(0.1, 'backward', 'last')
    assert judged(scans_with(STATED, timing=timing))[-1] == Sweep(0.1, True, True)
    assert judged(scans_with(STATED, timing=SweepTiming(0.0)))[-1] is None
    timing = SweepTiming(None, 'backward', 'auto')
    assert judged(scans_with(STATED, timing=timing))[-1] == Sweep(pytest.approx(0.18), True)


def test_what_the_scans_have_shown_counts_where_settings_do_not_tell():
    judge = SweepJudge('robot1')
    judge.found = Sweep(0.17, backward=True, last=True)
    assert judged(scans_with(0.0), judge)[-1] == Sweep(0.17, True, True)
    forward = SweepTiming(None, 'forward', 'first')
    assert judged(scans_with(0.0, timing=forward), judge)[-1] == Sweep(0.17)
    assert judged(scans_with(0.0, timing=SweepTiming(0.0)), judge)[-1] is None


@pytest.mark.parametrize(
    ('increment', 'words'),
    [
        (-STATED, 'time_increment of the scans is -0.0005014 s: expected 0 or more'),
        (math.nan, 'time_increment of the scans is nan s'),
        (0.01, 'is 0.01 s: that is 3.59 s for a scan, expected at most 0.273 s'),
        (0.8 / 359, 'that is 0.8 s for a scan, expected at most 0.273 s'),
    ],
)
def test_an_absurd_time_increment_is_named_once_and_not_used(increment, words, caplog):
    caplog.set_level(logging.WARNING)
    found = judged(scans_with(increment, scan_time=1.0 / 5.5))
    assert found == [None] * 8
    assert caplog.text.count('time_increment') == 1
    assert words in caplog.text
    assert 'robot1' in caplog.text


def test_the_time_between_scans_is_that_of_their_stamps(caplog):
    caplog.set_level(logging.WARNING)
    found = judged(scans_with(0.25 / 359, rate=10.0))
    assert found[-1] is None
    assert 'that is 0.25 s for a scan, expected at most 0.15 s' in caplog.text


@pytest.mark.parametrize(
    ('share', 'doubted'),
    [(0.06, True), (0.8, True), (0.88, False), (1.0, False), (1.12, False), (1.4, True)],
)
def test_a_duration_far_from_the_time_between_scans_is_put_to_the_test(share, doubted):
    judge, between = SweepJudge('robot1'), 359.0 / 360.0 / 5.5
    scans = scans_with(share * between / 359)
    judged(scans, judge)
    stated = pytest.approx(share * between)
    wanted = (pytest.approx(between), stated) if doubted else (stated, 0.0)
    assert judge.doubtful(scans[-1]) == wanted


def test_the_doubt_does_not_flicker_at_its_limit():
    judge, between = SweepJudge('robot1'), 359.0 / 360.0 / 5.5
    steps = ((0.86, False), (0.84, True), (0.86, True), (0.89, True), (0.91, False), (0.86, False))
    for number, (share, doubted) in enumerate(steps):
        judge._stamps.clear()
        scans = scans_with(share * between / 359)
        judged(scans, judge)
        assert (judge.doubtful(scans[-1]).stated > 0.0) is doubted, number


def test_settings_are_not_doubted():
    judge = SweepJudge('robot1')
    scans = scans_with(STATED, timing=SweepTiming(0.03))
    judged(scans, judge)
    assert judge.doubtful(scans[-1]) == (0.03, 0.0)


def test_settings():
    assert SweepConfig().record == SweepTiming()
    values = {'sweep_time': 0.1, 'sweep_direction': 'backward', 'sweep_stamp': 'last'}
    assert with_values(SweepConfig(), values).record == SweepTiming(0.1, 'backward', 'last')
    for name, value in (('sweep_time', 2.0), ('sweep_direction', 'left'), ('sweep_stamp', 1)):
        with pytest.raises(ConfigError, match=name):
            with_values(SweepConfig(), {name: value})
