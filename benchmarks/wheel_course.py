"""Deviation of the course of wheel odometry from that of a log's corrected poses.

    python benchmarks/wheel_course.py LOG [LOG ...]

A log is a CARMEN file with corrected poses. Between scans that lie at least 0.2 m apart, the
direction of the motion in the frame of the vehicle is compared: by odometry and by the corrected
poses. The root mean square of the difference (rad), outliers beyond 0.5 rad left out, chose
`_COURSE_DEVIATION` of explore_slam/agent/scan_odometry.py.
"""

import argparse
from pathlib import Path

import numpy as np

from explore_slam.geometry import Array, between, wrap_angles
from explore_slam.recording.carmen_log import read_carmen

MINIMUM_MOTION = 0.2  # m between two scans, so that the noise of the poses does not count
OUTLIER = 0.5  # rad


def course_errors(path: Path) -> Array:
    """Return the differences (n,) rad of the courses of all motions of a log."""
    log = read_carmen(path)
    if log.reference is None:
        raise SystemExit(f'{path} has no corrected poses')
    reference, odometry = np.asarray(log.reference), log.odometry[log.rows]
    errors, last = [], 0
    for n in range(1, len(reference)):
        true = between(reference[last], reference[n])
        if np.hypot(true[0], true[1]) < MINIMUM_MOTION:
            continue
        measured = between(odometry[last], odometry[n])
        errors.append(np.arctan2(measured[1], measured[0]) - np.arctan2(true[1], true[0]))
        last = n
    return wrap_angles(np.array(errors))


def main() -> None:
    """Print a line per log."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('logs', nargs='+', type=Path, help='CARMEN files with corrected poses')
    for path in parser.parse_args().logs:
        errors = np.abs(course_errors(path))
        inside = errors[errors < OUTLIER]
        print(
            f'{path.stem}: {len(errors)} motions, rms {np.sqrt((inside**2).mean()):.3f} rad, '
            f'68 % below {np.quantile(errors, 0.68):.3f}, 95 % below '
            f'{np.quantile(errors, 0.95):.3f}'
        )


if __name__ == '__main__':
    main()
