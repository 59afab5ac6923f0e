"""The frame that tags known in two maps agree on, whatever else some of them say."""

import math

import numpy as np
import pytest

from explore_slam.geometry import Pose2, wrap_angle
from explore_slam.slam.closures.tag_frames import TagPair, TagPlace, fit_frame

FRAME = Pose2(3.0, -2.0, 2.5)  # of the map here in the map there
PLACES = [(0.0, 0.0, 0.3), (4.0, 1.0, -2.0), (7.0, -3.0, 1.0), (2.0, 6.0, 3.0), (-3.0, 2.0, 0.0)]


def pair(tag, place, heading=math.pi, noise=(0.0, 0.0, 0.0), shift=(0.0, 0.0)):
    here = Pose2(*place)
    there = np.asarray(FRAME.compose(here)) + noise + [*shift, 0.0]
    return TagPair(tag, TagPlace(np.asarray(here), 0.03, heading), TagPlace(there, 0.03, heading))


def off(fit):
    error = FRAME.between(fit.frame)
    return math.hypot(error.x, error.y), abs(error.theta)


@pytest.mark.parametrize('heading', [0.05, math.pi])
def test_tags_agree_on_a_frame_with_and_without_headings(heading):
    random = np.random.default_rng(0)
    noise = [0.03, 0.03, min(heading, 0.05)] * random.normal(size=(5, 3))
    fit = fit_frame([pair(n, p, heading, noise[n]) for n, p in enumerate(PLACES)])
    assert [p.tag for p in fit.pairs] == [0, 1, 2, 3, 4]
    assert fit.contradicting == 0
    assert off(fit)[0] < 0.1
    assert off(fit)[1] < 0.02
    assert fit.heading_deviation < 0.02


def test_wrong_tags_are_outvoted():
    pairs = [pair(n, p, 0.05) for n, p in enumerate(PLACES)]
    pairs[1] = pair(1, PLACES[1], 0.05, shift=(4.0, 0.0))
    pairs[4] = pair(4, PLACES[4], 0.05, noise=(0.0, 0.0, 1.5))  # turned on its wall
    fit = fit_frame(pairs)
    assert [p.tag for p in fit.pairs] == [0, 2, 3]
    assert fit.contradicting == 2
    assert off(fit)[0] < 1e-6


def test_a_single_tag_determines_a_frame_by_its_heading_alone():
    assert fit_frame([pair(0, PLACES[0])]) is None
    fit = fit_frame([pair(0, PLACES[0], 0.04)])
    assert off(fit) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert fit.heading_deviation == pytest.approx(math.hypot(0.04, 0.04), rel=0.01)


def test_two_positions_too_near_each_other_show_no_heading():
    near = [pair(0, (0.0, 0.0, 0.0)), pair(1, (0.5, 0.0, 0.0))]
    assert fit_frame(near) is None
    assert fit_frame([]) is None


def test_a_mirrored_map_does_not_agree():
    mirrored = [
        TagPair(n, TagPlace(np.array(p), 0.03, math.pi),
                TagPlace(np.array([p[0], -p[1], wrap_angle(-p[2])]), 0.03, math.pi))
        for n, p in enumerate(PLACES)
    ]  # fmt: skip
    fit = fit_frame(mirrored)
    assert fit is None or len(fit.pairs) < 3
