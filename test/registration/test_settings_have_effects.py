"""Every setting of scan matching changes the matches; a new one without a test fails here."""

import numpy as np
import pytest
from registration.ray_caster import box, polyline, scan_of

from explore_slam.geometry import IDENTITY, Pose2
from explore_slam.registration import ScanMatch, ScanMatcher, ScanMatchingConfig
from explore_slam.settings import settings_of, with_values

ROOM = np.vstack([box(-4.0, -3.0, 4.0, 3.0), polyline((1.0, -3.0), (1.0, -1.0), (2.0, -1.0))])
WHEELS = np.diag([0.05, 0.05, 0.05]) ** 2
# Of the agent, which decides whether and when to match: test/agent/test_settings_have_effects.py.
OF_THE_AGENT = {'scan_matching', 'scan_wait_timeout'}


def drive(config):
    """Match the scans of a drive through a room, turns on the spot included."""
    matcher, random, outcomes = ScanMatcher(config), np.random.default_rng(3), []
    for k in range(16):
        true = Pose2(0.06 * min(k, 10), 0.0, 0.09 * max(k - 8, 0))
        scan = scan_of(ROOM, true, 0.02, random)
        outcomes.append(tuple(matcher.match(scan, IDENTITY, true, WHEELS).pose))
    return outcomes


def scan_of_a_changed_room(config):
    """Return whether a scan is matched of which half the returns lie on known walls."""
    matcher = ScanMatcher(config)
    matcher.match(scan_of(ROOM, IDENTITY), IDENTITY, IDENTITY, WHEELS)
    screen = polyline((-0.5, -1.0), (1.0, -1.5), (2.0, 0.2))
    changed = scan_of(np.vstack([ROOM, screen]), IDENTITY)
    return isinstance(matcher.match(changed, IDENTITY, IDENTITY, WHEELS), ScanMatch)


EFFECTS = {
    'matching_range': (3.5, drive),
    'matching_window': (1, drive),
    'matching_window_distance': (0.5, drive),
    'matching_window_heading': (0.05, drive),
    'matching_overlap': (1.0, scan_of_a_changed_room),
}


@pytest.fixture(scope='module')
def usual():
    """Matches with the usual settings, which effects are compared with."""
    return {experiment: experiment(ScanMatchingConfig()) for _, experiment in EFFECTS.values()}


@pytest.mark.parametrize('name', EFFECTS)
def test_every_setting_changes_the_matches(name, usual):
    value, experiment = EFFECTS[name]
    assert experiment(with_values(ScanMatchingConfig(), {name: value})) != usual[experiment]


def test_the_same_settings_give_the_same(usual):
    assert drive(ScanMatchingConfig()) == usual[drive]


def test_no_setting_is_left_out():
    assert {info.name for info, _ in settings_of(ScanMatchingConfig())} == {
        *EFFECTS,
        *OF_THE_AGENT,
    }
