"""A shortened `explore_slam demo --hardware`: agent, followers, drivers, ptys, simulator."""

import math

import pytest
from ros_domain import own_domain

from explore_slam.live.live_run import LiveRun, LiveRunOptions


@pytest.mark.timeout(240)
def test_the_demo_runs_through_the_serial_drivers(tmp_path, monkeypatch):
    pytest.importorskip('mujoco', reason='the simulator needs mujoco')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(own_domain(78)))
    options = LiveRunOptions(
        world='small',
        vehicles=1,
        hardware=True,
        laser_boot_time=4.0,  # lasers whose power follows the port, from cold
        settings={'particles': 200},
        wall_time_limit=150.0,
    )
    live = LiveRun(options, tmp_path)
    run = live.run()
    start, driven = live.starts['robot1'], 0.0
    for state in run:
        if 'robot1' in state.poses:
            _, pose = state.poses['robot1']
            driven = max(driven, math.hypot(pose.x - start.x, pose.y - start.y))
        if driven > 0.3 and state.coverage > 0.5:
            break
    run.close()  # ends all processes
    assert driven > 0.3
    assert state.coverage > 0.5
    assert state.position_error('robot1') < 0.3
    driver = (live.folder.path / 'logs' / 'robot1_driver.log').read_text()
    assert 'base: connected' in driver
    assert driver.index('boots now') < driver.index('laser: connected: LMS200')
    assert live.finish().metrics['collisions'] == {'robot1': 0}
