"""Stamps of CARMEN logs: in the order of the lines, near the times, whatever these are like."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from explore_slam.recording.carmen_stamps import FASTEST, isotonic, regular_stamps

COUNT = 200
LINES = np.arange(1, COUNT + 1)
ODOMETRY = np.column_stack([0.05 * np.arange(COUNT), np.zeros(COUNT), np.zeros(COUNT)])
TIMES = 50.0 + 0.2 * np.arange(COUNT)


def speeds(stamps):
    return np.diff(ODOMETRY[:, 0]) / np.diff(stamps)


def test_good_times_stay():
    timing = regular_stamps(TIMES, ODOMETRY, LINES)
    np.testing.assert_allclose(timing.stamps, TIMES, atol=1e-9)
    np.testing.assert_array_equal(timing.times, TIMES)
    assert timing.notes == []


def test_jitter_follows_the_order_of_the_lines():
    jittered = TIMES.copy()
    jittered[50:150:10] += 0.9
    timing = regular_stamps(jittered, ODOMETRY, LINES)
    assert (np.diff(timing.stamps) > 0.0).all()
    assert speeds(timing.stamps).max() <= FASTEST * 1.0001
    assert np.abs(timing.stamps - TIMES).max() < 0.9
    np.testing.assert_array_equal(timing.times, jittered)
    assert len(timing.notes) == 1
    assert timing.notes[0].startswith('10 times are earlier than those of the line before')


def test_a_single_wrong_time_is_named():
    wrong = TIMES.copy()
    wrong[77] = 4.3e-86
    wrong[120] = 1e12
    timing = regular_stamps(wrong, ODOMETRY, LINES)
    assert np.abs(timing.stamps - TIMES).max() < 0.2
    assert np.isnan(timing.times[[77, 120]]).all()
    assert [note.split(':')[0] for note in timing.notes] == ['line 78', 'line 121']


def test_a_clock_that_goes_back_is_named_and_continued():
    back = np.concatenate([TIMES[:100], TIMES[100:] - 60.0])
    timing = regular_stamps(back, ODOMETRY, LINES)
    assert (np.diff(timing.stamps) > 0.0).all()
    assert timing.stamps[-1] == pytest.approx(TIMES[-1], abs=0.5)
    assert len(timing.notes) == 1
    assert timing.notes[0].startswith('line 101: time goes back by 59.800 s')


@pytest.mark.parametrize(
    'times',
    [np.full(COUNT, 1.01893e9), np.zeros(COUNT), np.full(COUNT, -1.0), np.full(COUNT, np.nan)],
)
def test_useless_times_give_way_to_a_nominal_speed(times):
    timing = regular_stamps(times, ODOMETRY, LINES)
    assert (np.diff(timing.stamps) > 0.0).all()
    assert speeds(timing.stamps).max() == pytest.approx(0.5)
    assert np.isnan(timing.times).all()
    assert 'cannot be used' in timing.notes[0]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_isotonic_regression(values):
    fitted = isotonic(np.array(values))
    assert (np.diff(fitted) >= -1e-9).all()
    assert fitted.sum() == pytest.approx(sum(values), abs=1e-6)
    # no shift of a block towards its values improves the fit: residuals of each block sum to 0
    for level in np.unique(fitted):
        block = fitted == level
        assert np.array(values)[block].sum() == pytest.approx(fitted[block].sum(), abs=1e-6)


def test_isotonic_regression_of_a_known_sequence():
    np.testing.assert_allclose(
        isotonic(np.array([1.0, 3.0, 2.0, 4.0, 3.5, 3.3])), [1.0, 2.5, 2.5, 3.6, 3.6, 3.6]
    )
