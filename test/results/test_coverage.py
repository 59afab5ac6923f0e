"""Metrics of exploration."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.errors import EvaluationError
from explore_slam.results.coverage import CoverageCurve, GoalCounter, Spread


def curve(*samples):
    made = CoverageCurve()
    for stamp, team, *own in samples:
        made.add(stamp, team, own)
    return made


def test_time_to_a_share_lies_on_the_line_between_samples():
    made = curve((0, 0.1, 0.1), (10, 0.5, 0.5), (20, 1.0, 1.0))
    assert made.time_to(0.1) == 0.0
    assert made.time_to(0.5) == 10.0
    assert made.time_to(0.75) == pytest.approx(15.0)
    assert made.time_to(1.0) == 20.0


def test_a_share_never_seen_has_an_infinite_time():
    assert curve((0, 0.1, 0.1), (10, 0.98, 0.9)).time_to(0.99) == math.inf
    assert CoverageCurve().time_to(0.5) == math.inf


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20), st.floats(0.01, 1.0))
def test_time_to_is_where_the_curve_first_holds_the_share(values, share):
    shares = np.maximum.accumulate(values)
    made = curve(*((float(i), float(value), float(value)) for i, value in enumerate(shares)))
    reached = made.time_to(share)
    if math.isinf(reached):
        assert shares[-1] < share
    else:
        assert made.at([reached])[0] >= share - 1e-9
        assert reached == 0.0 or made.at([max(0.0, reached - 1.0)])[0] <= share


def test_overlap_is_what_was_seen_twice():
    assert curve((0, 1.0, 0.5, 0.5)).overlap() == pytest.approx(0.0)
    assert curve((0, 1.0, 1.0, 0.25)).overlap() == pytest.approx(0.25)
    assert curve((0, 1.0, 1.0)).overlap() == pytest.approx(0.0)
    assert math.isnan(CoverageCurve().overlap())


@pytest.mark.parametrize(
    'sample', [(0.0, 0.5, (0.5,)), (2.0, 0.3, (0.3,)), (2.0, 1.5, (0.5,)), (2.0, 0.6, (0.5, 0.1))]
)
def test_samples_that_cannot_be_are_refused(sample):
    made = curve((0, 0.1, 0.1), (1, 0.5, 0.5))
    with pytest.raises(EvaluationError, match='coverage'):
        made.add(*sample)
    assert made.stamps == [0, 1]


def test_after_the_end_the_last_share_holds():
    made = curve((0, 0.0, 0.0), (10, 1.0, 1.0))
    np.testing.assert_allclose(made.at([5.0, 10.0, 99.0]), [0.5, 1.0, 1.0])
    with pytest.raises(EvaluationError, match='no samples'):
        CoverageCurve().at([1.0])


def test_spread_of_runs():
    spread = Spread.of([1.0, 2.0, 3.0])
    assert (spread.mean, spread.low, spread.high, spread.count) == (2.0, 1.0, 3.0, 3)
    assert spread.deviation == pytest.approx(1.0)
    assert spread.text(1) == '2.0 ± 1.0'
    assert Spread.of([4.0]).deviation == 0.0


def test_one_run_that_failed_is_not_averaged_away():
    spread = Spread.of([1.0, math.inf])
    assert spread.mean == math.inf
    assert spread.text() == 'not reached'
    with pytest.raises(EvaluationError, match='no values'):
        Spread.of([])


def test_goals_that_are_reached_are_not_counted_as_changed():
    counter = GoalCounter()
    counter.update((5.0, 0.0), (0.0, 0.0))
    counter.update((5.2, 0.0), (1.0, 0.0))  # the same goal, a little moved
    counter.update((9.0, 0.0), (4.9, 0.0))  # was there
    assert (counter.given, counter.changed) == (2, 0)
    counter.update((0.0, 9.0), (5.0, 0.0))  # was not there
    assert (counter.given, counter.changed) == (3, 1)
    counter.clear()
    counter.update((3.0, 3.0), (5.0, 0.0))
    assert (counter.given, counter.changed) == (4, 1)
    counter.update(None, (5.0, 0.0))
    assert (counter.given, counter.changed) == (4, 1)
