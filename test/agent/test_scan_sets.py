"""Scans of several lasers: which are matched together, and what comes of it."""

import math

import numpy as np
import pytest

from explore_slam.agent import Agent, AgentConfig
from explore_slam.agent.scan_sets import ScanSets
from explore_slam.data import LaserScan, OdometryReading
from explore_slam.geometry import Pose2
from explore_slam.registration import PointCloud

CLOUD = PointCloud.empty()


def sets_of(arrivals):
    """Return the sets, as strings of lasers, of clouds of (laser, stamp)."""
    sets, stamps = ScanSets(), {}
    found = []
    for laser, stamp in arrivals:
        stamps[stamp] = laser
        for clouds in sets.add(laser, stamp, CLOUD):
            assert [item.stamp for item in clouds] == sorted(item.stamp for item in clouds)
            found.append(''.join(stamps[item.stamp] for item in clouds))
    return found


def times(laser, first, period, count):
    return [(laser, round(first + period * k, 3)) for k in range(count)]


def in_order(*lasers):
    return sorted((item for one in lasers for item in one), key=lambda item: item[1])


def test_every_cloud_of_a_single_laser_is_a_set():
    assert sets_of(times('a', 0.0, 0.1, 4)) == ['a'] * 4


@pytest.mark.parametrize('delay', [0.01, 0.03, 0.07, 0.09])
def test_lasers_of_one_rate_are_matched_with_the_nearest_scan_of_the_other(delay):
    found = sets_of(in_order(times('a', 0.0, 0.1, 20), times('b', delay, 0.1, 20)))
    pair = 'ab' if delay < 0.05 else 'ba'
    assert found[-10:] == [pair] * 10
    assert sum(map(len, found)) >= 38  # every cloud is used once, apart from what still waits


def test_a_slower_laser_is_waited_for_only_where_it_is_near():
    found = sets_of(in_order(times('a', 0.0, 0.1, 40), times('b', 0.02, 0.2, 20)))
    assert found[-8:] in (['ab', 'a'] * 4, ['a', 'ab'] * 4)


def test_a_laser_that_falls_silent_is_waited_for_no_longer():
    arrivals = in_order(times('a', 0.0, 0.1, 30), times('b', 0.01, 0.1, 5))
    assert sets_of(arrivals)[-15:] == ['a'] * 15


def test_what_waits_is_known_and_forgotten_when_the_clock_jumps():
    sets = ScanSets()
    assert sets.first == math.inf
    sets.add('a', 0.0, CLOUD)
    assert sets.add('b', 0.01, CLOUD) == []
    assert sets.first == 0.01
    sets.clear()
    assert sets.first == math.inf
    assert len(sets.add('a', 0.0, CLOUD)) == 1


def test_each_of_two_lasers_has_its_own_thinning_and_both_draw_the_map():
    agent = Agent(AgentConfig(), {'r': Pose2(0.0, 0.0, 0.0)})
    ahead = np.full(181, 3.0, np.float32)
    for k in range(20):
        stamp = 0.1 * k
        agent.add('r', OdometryReading(stamp, Pose2(0.0, 0.0, 0.0)))
        for name, mount in (('f', Pose2(0.2, 0.0, 0.0)), ('b', Pose2(-0.2, 0.0, math.pi))):
            scan = LaserScan(
                stamp, -math.pi / 2, math.pi / 180, ahead, 0.1, 8.0, mount, sensor=name
            )
            agent.add('r', scan)
    agent.add('r', OdometryReading(2.5, Pose2(0.0, 0.0, 0.0)))
    assert {item.scan.sensor for item in agent.laser_map.scans} == {'f', 'b'}
    assert len(agent.laser_map.scans) == 2  # the vehicle stands: one of each
    grid = agent.grid
    walls = np.array([[3.2, 0.0], [-3.2, 0.0], [0.2, 3.0], [-0.2, -3.0]])
    cells = np.floor((walls - grid.origin) / grid.resolution).astype(int)
    around = [grid.probability()[y - 1 : y + 2, x - 1 : x + 2].max() for x, y in cells]
    assert min(around) > 0.6


def test_a_scan_waits_for_an_earlier_one_of_another_laser_whose_sweep_is_not_complete():
    agent = Agent(AgentConfig(), {'r': Pose2(0.0, 0.0, 0.0)})
    ahead = np.full(181, 3.0, np.float32)

    def scan(stamp, sensor, increment):
        return LaserScan(
            stamp, -math.pi / 2, math.pi / 180, ahead, 0.1, 8.0,
            time_increment=increment, sensor=sensor,
        )  # fmt: skip

    for k in range(10):
        agent.add('r', OdometryReading(0.1 * k, Pose2(0.02 * k, 0.0, 0.0)))
        agent.add('r', scan(0.1 * k, 'slow', 0.5e-3))  # counts as measured 0.045 s later
        agent.add('r', scan(0.1 * k + 0.05, 'fast', 0.0))
    track = agent.track('r')
    matched = [stamp for stamp, _ in track.clouds]
    assert matched == sorted(matched)
    assert track.counts['matched_scans'] >= 7
    assert track.counts.get('unmatched_scans', 0) == 0
    assert track.last_match_attempt == pytest.approx(0.85)  # that of 0.945 s is not complete
