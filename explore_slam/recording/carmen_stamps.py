"""Stamps for CARMEN logs, whose times may be jittered, rounded, jump back or be unusable.

The order of the lines is kept. Stamps are as close to the written times as this order and a
plausible speed allow.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.geometry import Array, between

# Chosen by hand, for the logs of several recorders; test_carmen_stamps shows what they decide.
FASTEST = 2.5  # m/s; below the speed that the agent takes for a reset of the base
FASTEST_TURN = 4.0  # rad/s
LONGEST_NEEDED = 1.0  # s; a motion that takes longer at full speed is a jump of the odometry
SHORTEST_STEP = 1e-4  # s
NEIGHBOURS = 5  # lines whose median gives the time
NAMED_LINES = 5  # lines that notes name; the others are counted
OUTLIER = 5.0  # s from that median
CLOCK_JUMP = 2.0  # s back; less is jitter
USABLE_FRACTION = 0.5  # of the times must be usable
DISTINCT_FRACTION = 0.1  # of the times must differ from each other
# where the times cannot be used: a nominal speed
NOMINAL_SPEED, NOMINAL_TURN, NOMINAL_STEP = 0.5, 0.8, 0.05  # m/s, rad/s, s
FIRST_STAMP = 1.0  # s


class Timing(NamedTuple):
    """Stamps (N,) s, increasing; times (N,) s as written, NaN where unusable; notes."""

    stamps: Array
    times: Array
    notes: list[str]


def regular_stamps(written: Array, odometry: Array, lines: NDArray[np.int64]) -> Timing:
    """Return stamps for rows of odometry (N, 3) with written times (N,) at line numbers (N,)."""
    notes: list[str] = []
    times = np.where(np.isfinite(written) & (written >= 0.0), written, np.nan)
    motion = (
        np.abs(between(odometry[:-1], odometry[1:])) if len(odometry) > 1 else np.empty((0, 3))
    )
    distance, turn = np.hypot(motion[:, 0], motion[:, 1]), motion[:, 2]
    needed = np.clip(
        np.maximum(distance / FASTEST, turn / FASTEST_TURN), SHORTEST_STEP, LONGEST_NEEDED
    )
    if not _usable(times, float(needed.sum())):
        nominal = np.maximum(distance / NOMINAL_SPEED, turn / NOMINAL_TURN)
        steps = np.maximum(nominal, NOMINAL_STEP)
        notes.append('the times in the log cannot be used: stamps follow from a nominal speed')
        stamps = FIRST_STAMP + np.concatenate([[0.0], np.cumsum(steps)])
        return Timing(stamps, np.full(len(times), np.nan), notes)
    times = _without_outliers(times, lines, notes)
    continued = _without_jumps(times, lines, notes)
    known = np.isfinite(continued)
    earliest = np.concatenate([[0.0], np.cumsum(needed)])
    filled = np.interp(np.arange(len(continued)), np.flatnonzero(known), continued[known])
    stamps = isotonic(filled - earliest) + earliest
    stamps += max(0.0, -float(stamps[0]))
    late = np.count_nonzero(np.diff(continued[known]) < 0.0)
    if late:
        worst = float(np.abs(stamps - filled).max())
        notes.append(
            f'{late} times are earlier than those of the line before: stamps follow the order of '
            f'the lines and differ from the times by at most {worst:.2f} s'
        )
    return Timing(stamps, times, notes)


def _usable(times: Array, shortest: float) -> bool:
    """Return whether most times are numbers, differ, and leave time for the motion."""
    known = times[np.isfinite(times)]
    if len(known) < max(USABLE_FRACTION * len(times), 1.0):
        return False
    low, high = np.quantile(known, [0.05, 0.95])
    enough = high - low >= 0.5 * shortest or len(times) < NEIGHBOURS
    return bool(enough and len(np.unique(known)) >= DISTINCT_FRACTION * len(known))


def _without_outliers(times: Array, lines: NDArray[np.int64], notes: list[str]) -> Array:
    """Replace single times far from those of the lines around them by NaN."""
    half = NEIGHBOURS // 2
    if len(times) < NEIGHBOURS:
        return times
    padded = np.pad(times, half, mode='edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS)
    few = np.isfinite(windows).sum(axis=1) <= half
    middle = np.where(few, times, np.nanmedian(np.where(few[:, None], 0.0, windows), axis=1))
    far = np.isfinite(times) & (np.abs(times - middle) > OUTLIER)
    notes.extend(
        f'line {lines[index]}: time {times[index]:.6g} s is '
        f'{times[index] - middle[index]:+.6g} s off those around it: not used'
        for index in np.flatnonzero(far)[:NAMED_LINES].tolist()
    )
    if (more := int(far.sum()) - NAMED_LINES) > 0:
        notes.append(f'{more} more times far off those around them: not used')
    return np.where(far, np.nan, times)


def _without_jumps(times: Array, lines: NDArray[np.int64], notes: list[str]) -> Array:
    """Continue the time where it goes back for good."""
    continued, last, shift = times.copy(), -np.inf, 0.0
    for index in np.flatnonzero(np.isfinite(times)).tolist():
        value = float(times[index]) + shift
        if value < last - CLOCK_JUMP:
            notes.append(
                f'line {lines[index]}: time goes back by {last - value:.3f} s; '
                'the recording continues from the time before'
            )
            shift += last - value
            value = last
        continued[index] = value
        last = max(last, value)
    return continued


def isotonic(values: Array) -> Array:
    """Return the non-decreasing sequence nearest to the values in the sum of squares.

    Pool adjacent violators (Ayer et al., 1955).
    """
    means: list[float] = []
    counts: list[int] = []
    for value in values.tolist():
        mean, count = value, 1
        while means and means[-1] > mean:
            total = counts[-1] + count
            mean = (means.pop() * counts[-1] + mean * count) / total
            counts.pop()
            count = total
        means.append(mean)
        counts.append(count)
    return np.repeat(means, counts)
