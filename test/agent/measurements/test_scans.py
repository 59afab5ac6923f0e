"""Scans: which ones enter the map, with which pose, keyframe and bodies."""

import math

import numpy as np
import pytest

from explore_slam.agent import AgentConfig
from explore_slam.agent.measurements import scans
from explore_slam.agent.team import Team
from explore_slam.data import LaserScan, OdometryReading, VehicleBody
from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.mapping import MAP_FRAME
from explore_slam.settings import with_values

STARTS = {'robot1': Pose2(0.0, 0.0, 0.0), 'robot2': Pose2(3.0, 0.0, math.pi)}


def make_team(**values):
    config = with_values(AgentConfig(), {'particles': 10, **values})
    return Team(config, STARTS, 1)


def drive(team, name, *places, start=0.0, step=0.1):
    """Odometry readings at these poses, step (s) apart; the first one makes a keyframe."""
    track = team.track(name)
    for number, place in enumerate(places):
        track.odometry.add(OdometryReading(start + step * number, Pose2(*place)))
        if track.keyframe is None:
            team.add_keyframe(track, start)
    return track


def scan(stamp):
    return LaserScan(stamp, -1.0, 0.1, np.full(21, 2.0, np.float32), 0.0, 8.0)


def mapped(team, name, *stamps):
    """Process scans; return the stamps of those that entered the map."""
    for stamp in stamps:
        scans.process(team, team.track(name), scan(stamp))
    return [item.scan.stamp for item in team.laser_map.scans if item.vehicle == name]


def test_without_odometry_a_scan_is_late():
    team = make_team()
    assert mapped(team, 'robot1', 1.0) == []
    assert team.track('robot1').counts == {'late_observations': 1}


def test_scans_enter_the_map_by_travel_since_the_last_one():
    team = make_team(map_scan_distance=0.1, map_scan_heading=0.2)
    drive(team, 'robot1', *((0.04 * i, 0.0, 0.0) for i in range(10)))
    stamps = [0.1 * i for i in range(10)]
    assert mapped(team, 'robot1', *stamps) == pytest.approx([0.0, 0.3, 0.6, 0.9])


def test_scans_enter_the_map_by_change_of_heading():
    team = make_team(map_scan_distance=0.1, map_scan_heading=0.2)
    drive(team, 'robot1', *((0.0, 0.0, -0.08 * i) for i in range(7)))
    assert mapped(team, 'robot1', *(0.1 * i for i in range(7))) == pytest.approx([0.0, 0.3, 0.6])


def test_scans_enter_the_map_by_time_where_the_vehicle_stands():
    team = make_team(map_scan_period=1.0)
    drive(team, 'robot1', *(IDENTITY for _ in range(31)))
    stamps = [0.25 * i for i in range(12)]
    assert mapped(team, 'robot1', *stamps) == pytest.approx([0.0, 1.0, 2.0])


def test_a_scan_has_the_pose_of_the_laser_in_its_keyframe():
    team = make_team(laser_x=0.2, laser_y=-0.1, laser_yaw=0.5)
    track = drive(team, 'robot1', (1.0, 0.0, 0.0), (1.0, 0.1, 0.1))
    mapped(team, 'robot1', 0.1)
    (item,) = team.laser_map.scans
    assert item.keyframe == track.keyframe.number == 0
    expected = Pose2(0.0, 0.1, 0.1).compose(Pose2(0.2, -0.1, 0.5))
    np.testing.assert_allclose(item.laser_in_keyframe, expected, atol=1e-12)


def test_the_other_vehicles_are_discs_where_they_were_at_the_stamp():
    team = make_team(body_margin=0.1, planning_radius=0.4)
    drive(team, 'robot1', IDENTITY, IDENTITY)
    mapped(team, 'robot1', 0.0)
    (body,) = team.laser_map.scans[0].bodies
    assert body == (MAP_FRAME, STARTS['robot2'], 0.5)
    drive(team, 'robot2', (7.0, 7.0, 0.0), (7.4, 7.0, 0.0), start=0.0, step=4.0)
    drive(team, 'robot1', IDENTITY, IDENTITY, start=3.0)
    mapped(team, 'robot1', 3.0)
    (body,) = team.laser_map.scans[1].bodies
    assert body.keyframe == team.track('robot2').keyframe.number
    np.testing.assert_allclose(body.offset, (0.3, 0.0, 0.0), atol=1e-12)
    assert body.radius == 0.5


def test_the_disc_of_another_vehicle_is_as_large_as_its_body():
    config = with_values(AgentConfig(), {'body_margin': 0.1, 'planning_radius': 0.4})
    team = Team(config, STARTS, 1, {'robot2': VehicleBody(0.45)})
    drive(team, 'robot1', IDENTITY, IDENTITY)
    mapped(team, 'robot1', 0.0)
    (body,) = team.laser_map.scans[0].bodies
    assert body.radius == pytest.approx(0.4 + 0.2 + 0.1)


def keyframes_without_vision(last_seen, moved, **values):
    team = make_team(maximum_keyframe_gap=2.0, minimum_travel_distance=0.5, **values)
    track = drive(team, 'robot1', IDENTITY, Pose2(*moved), step=3.0)
    track.last_seen = last_seen
    mapped(team, 'robot1', 3.0)
    return len(team.events) - 1, team


def test_without_frames_scans_make_keyframes_by_travel():
    count, team = keyframes_without_vision(-np.inf, (0.6, 0.0, 0.0))
    assert count == 1
    assert team.events[-1].stamp == 3.0
    assert team.events[-1].update is None
    np.testing.assert_allclose(team.events[-1].pose, (0.6, 0.0, 0.0), atol=0.01)
    assert team.laser_map.scans[0].keyframe == 1
    assert keyframes_without_vision(-np.inf, (0.4, 0.0, 0.0))[0] == 0
    assert keyframes_without_vision(-np.inf, (0.0, 0.0, 0.2))[0] == 1
    assert keyframes_without_vision(-np.inf, (0.0, 0.0, 0.1))[0] == 0


@pytest.mark.parametrize(('last_seen', 'count'), [(0.9, 1), (1.0, 1), (1.1, 0), (3.0, 0)])
def test_with_frames_the_frames_make_the_keyframes(last_seen, count):
    assert keyframes_without_vision(last_seen, (0.6, 0.0, 0.0))[0] == count


def test_scans_are_queued_for_matching_if_that_is_on():
    for matching in (True, False):
        team = make_team(scan_matching=matching)
        track = team.track('robot1')
        scans.enqueue_scan(team, track, scan(1.0))
        assert len(track.unmatched) == int(matching)
        assert len(track.waiting) == 1
