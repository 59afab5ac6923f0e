"""Keyframe choice by distance, turn and time."""

import math

import pytest

from explore_slam.errors import VisionError
from explore_slam.geometry import Pose2
from explore_slam.vision import KeyframeSelector, VisionConfig
from explore_slam.vision.sections import KeyframeConfig


@pytest.fixture
def selector():
    chosen = KeyframeSelector(
        KeyframeConfig(
            minimum_travel_distance=0.5, minimum_travel_heading=0.2, maximum_keyframe_gap=3.0
        )
    )
    assert chosen.select(10.0, Pose2(1.0, 2.0, 3.1))
    return chosen


@pytest.mark.parametrize(
    ('stamp', 'pose', 'wanted'),
    [
        (10.1, Pose2(1.0, 2.0, 3.1), False),
        (10.1, Pose2(1.49, 2.0, 3.1), False),
        (10.1, Pose2(1.0, 1.5, 3.1), True),
        (10.1, Pose2(1.0, 2.0, -3.1), False),  # 0.08 rad across the wrap
        (10.1, Pose2(1.0, 2.0, -2.9), True),
        (12.9, Pose2(1.0, 2.0, 3.1), False),
        (13.0, Pose2(1.0, 2.0, 3.1), True),
    ],
)
def test_choice(selector, stamp, pose, wanted):
    assert selector.select(stamp, pose) is wanted


def test_distance_counts_from_the_last_keyframe_not_the_last_frame(selector):
    chosen = [
        selector.select(10.0 + 0.01 * i, Pose2(1.0 + 0.1 * i, 2.0, 3.1)) for i in range(1, 13)
    ]
    assert [i for i, wanted in enumerate(chosen, start=1) if wanted] == [5, 10]


def test_small_moves_add_up(selector):
    assert not selector.select(10.1, Pose2(1.3, 2.0, 3.1))
    assert selector.select(10.2, Pose2(1.5, 2.0, 3.1))


def test_time_going_back_starts_anew(selector, caplog):
    assert selector.select(5.0, Pose2(1.0, 2.0, 3.1))
    assert 'time went back' in caplog.text
    assert not selector.select(5.1, Pose2(1.0, 2.0, 3.1))


def test_reset_makes_the_next_frame_a_keyframe(selector):
    selector.reset()
    assert selector.select(10.0, Pose2(1.0, 2.0, 3.1))


def test_values_that_are_not_finite_are_refused(selector):
    with pytest.raises(VisionError, match='nan'):
        selector.select(math.nan, Pose2(0.0, 0.0, 0.0))
    with pytest.raises(VisionError, match='inf'):
        selector.select(11.0, Pose2(math.inf, 0.0, 0.0))
    assert not selector.select(10.1, Pose2(1.0, 2.0, 3.1))


def test_takes_the_settings_of_the_room():
    assert KeyframeSelector(VisionConfig()).config == VisionConfig().keyframes
