"""Decode recordings of a real LMS-200: telegrams, checksum errors, scans, statistics of ranges.

python benchmarks/vehicle_recordings.py ../shared/data/lms200
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from explore_slam.vehicle.lms200_scan import parse_configuration, parse_scan, scan_ranges
from explore_slam.vehicle.lms200_telegrams import Reply, TelegramDecoder


def decode(data: bytes) -> tuple[int, int, np.ndarray]:
    """Return the numbers of telegrams and of failures, and the ranges (S, 361) m."""
    decoder = TelegramDecoder()
    telegrams, rows, bits = 0, [], 13
    for telegram in decoder.feed(data):
        telegrams += 1
        if telegram.command == Reply.CONFIGURATION:
            bits = parse_configuration(telegram.data).value_bits
        elif telegram.command == Reply.SCAN:
            rows.append(scan_ranges(parse_scan(telegram.data), bits))
    return telegrams, decoder.rejected + (decoder.pending > 0), np.array(rows)


def main() -> int:
    """Print a line for each recording; return 1 if one does not decode completely."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', maxsplit=1)[0])
    parser.add_argument('folder', type=Path)
    arguments = parser.parse_args()
    failed = 0
    print('recording            telegrams  CRC failures  scans  beams  valid    ranges (m)  noise')
    for path in sorted(arguments.folder.glob('*.bin')):
        telegrams, failures, ranges = decode(path.read_bytes())
        failed += failures
        valid = np.isfinite(ranges)
        changes = np.abs(np.diff(np.where(valid, ranges, np.nan), axis=0))
        print(
            f'{path.stem:21}{telegrams:9}{failures:14}{len(ranges):7}{ranges.shape[1]:7}'
            f'{100 * valid.mean():6.1f}% {ranges[valid].min():6.2f} - {ranges[valid].max():5.2f}'
            f'{1e3 * np.nanmedian(changes):5.0f} mm'
        )
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
