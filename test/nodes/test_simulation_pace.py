"""Pace of simulated time: fixed rates, and holding back for agent and followers."""

import pytest

from explore_slam.nodes.simulation_pace import Pace, PaceConfig
from explore_slam.settings import with_values


def pace(**values):
    return Pace(with_values(PaceConfig(), values), ['a', 'b'], wall=100.0)


def test_a_fixed_rate_is_kept_whatever_poses_say():
    it = pace(real_time_factor=2.0)
    it.report_pose('a', 0.0, 100.0)
    assert it.delay(1.0, 100.0) == pytest.approx(0.5)
    assert it.delay(1.0, 100.5) == 0.0
    assert it.delay(1.02, 100.5) == pytest.approx(0.01)


def test_a_machine_too_slow_for_the_rate_does_not_catch_up_in_a_rush():
    it = pace(real_time_factor=1.0)
    assert it.delay(1.0, 105.0) == 0.0
    assert it.delay(2.0, 105.0) == pytest.approx(1.0)


def test_without_poses_time_runs_as_it_does_outside():
    it = pace()
    assert it.delay(0.5, 100.0) == pytest.approx(0.5)
    assert it.holder == 'no poses'


def test_time_waits_for_the_pose_of_the_slowest_vehicle():
    it = pace(pose_lead=1.0)
    it.report_pose('a', 5.0, 100.0)
    it.report_pose('b', 4.0, 100.0)
    assert it.delay(4.9, 100.0) == 0.0
    assert it.delay(5.0, 100.0) > 0.0
    assert it.holder == 'b/pose'
    it.report_pose('b', 4.5, 100.1)
    assert it.delay(5.0, 100.1) == 0.0
    # a vehicle that never had a pose does not count
    alone = pace(pose_lead=1.0)
    alone.report_pose('a', 5.0, 100.0)
    assert alone.delay(5.9, 100.0) == 0.0


def test_time_slows_before_it_is_held():
    """An agent that publishes by simulated time and has caught up gets the time to do so."""
    it = pace(pose_lead=1.0, pose_wait_timeout=5.0)
    it.report_pose('a', 5.0, 100.0)
    assert it.delay(5.98, 100.0) == 0.0
    assert it.delay(6.0, 100.0) == pytest.approx(0.02)
    assert it.delay(6.0, 100.02) == pytest.approx(0.0, abs=1e-9)
    sim, wall = 6.0, 100.02
    while wall < 103.0:
        if it.delay(sim, wall) < 1e-9:
            sim += 0.02
        wall += 0.01
    assert sim == pytest.approx(6.26, abs=0.021)


def test_an_agent_that_died_does_not_freeze_time():
    it = pace(pose_lead=1.0, pose_wait_timeout=5.0)
    it.report_pose('a', 5.0, 100.0)
    assert it.delay(5.9, 100.0) == 0.0
    assert it.delay(6.3, 104.0) == pytest.approx(1.0)
    assert it.delay(6.3, 105.5) == pytest.approx(0.0, abs=1e-9)
    assert it.holder == 'no poses'
    assert it.delay(6.8, 105.5) == pytest.approx(0.5)
    it.report_pose('a', 6.4, 106.0)  # it is back
    assert it.delay(6.8, 106.0) == 0.0
    # the same stamp again and again is no progress
    for step in range(12):
        it.report_pose('a', 6.4, 106.0 + step)
    assert it.delay(7.5, 112.0) >= 0.0
    assert it.holder == 'no poses'


def test_an_agent_that_was_reset_holds_time_again():
    it = pace(pose_lead=1.0)
    it.report_pose('a', 50.0, 100.0)
    it.report_pose('a', 0.5, 101.0)
    assert it.delay(51.0, 101.0) > 0.0


def test_time_waits_for_the_next_command_of_a_vehicle_that_drives():
    it = pace(command_lead=0.15, command_wait_timeout=0.25, pose_lead=60.0)
    it.report_pose('a', 9.0, 100.0)
    it.report_command('a', True, sim=10.0, wall=100.0)
    assert it.delay(10.1, 100.0) == 0.0
    assert it.delay(10.15, 100.0) == pytest.approx(0.25)
    assert it.holder == 'a/cmd_vel'
    assert it.delay(10.15, 100.3) == 0.0  # the timeout is over
    it.report_command('a', False, sim=10.15, wall=100.4)  # it stands: nothing to wait for
    assert it.delay(11.0, 100.4) == 0.0
