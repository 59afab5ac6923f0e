"""The summary of a run that commands print at the end."""

import math
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from explore_slam.results.run_data import RunData


def print_summary(data: 'RunData') -> None:
    """Print the errors of each vehicle beside those of odometry alone, coverage and timing."""
    from explore_slam.exploration.records import unreached_text

    for note in data.notes:
        print(f'note: {note}', file=sys.stderr)
    vehicles = data.metrics.get('vehicles', {})
    if any(found.get('online') for found in vehicles.values()):
        print(
            f'{"":12s}{"position RMS (m)":>36s}{"heading RMS (deg)":>34s}\n'
            f'{"vehicle":12s}{"online":>12s}{"final":>12s}{"odometry":>12s}'
            f'{"online":>12s}{"final":>11s}{"odometry":>11s}'
        )
        for name, found in vehicles.items():
            print(_line(name, found))
        if len(vehicles) > 1:
            print(_mean_line(data.metrics))
    for name, found in data.metrics.get('observations', {}).items():
        print(name, ', '.join(f'{key} {value:.4g}' for key, value in found.items()))
    if 'coverage' in data.metrics:
        share = data.coverage_unit == '%'
        value = data.metrics['coverage'] * (100.0 if share else 1.0)
        print(f'{"explored" if share else "known area"} {value:.1f} {data.coverage_unit}')
    if data.metrics.get('unreached_frontiers'):
        left = unreached_text(data.metrics['unreached_frontiers'], data.metrics['unreached_m2'])
        print(f'{left} out of reach')
    if 'landmarks' in data.metrics:
        print(f'landmarks {data.metrics["landmarks"]}')
    timing = data.metrics.get('timing')
    if timing:
        print(
            f'{timing["recorded_seconds"]:.1f} s recorded, '
            f'replayed in {timing["wall_seconds"]:.1f} s'
        )


_KINDS = ('online', 'estimated', 'odometry')


def _line(name: str, found: dict[str, Any]) -> str:
    return f'{name:12s}' + ''.join(
        _cell(found.get(kind), metric, factor, digits, width)
        for metric, factor, digits, widths in (
            ('position_rms', 1.0, 3, (12, 12, 12)),
            ('heading_rms', 180.0 / math.pi, 2, (12, 11, 11)),
        )
        for kind, width in zip(_KINDS, widths, strict=True)
    )


def _cell(
    errors: dict[str, float] | None, metric: str, factor: float, digits: int, width: int
) -> str:
    if not errors:
        return f'{"-":>{width}s}'
    return f'{factor * errors[metric]:{width}.{digits}f}'


def _mean_line(metrics: dict[str, Any]) -> str:
    found: dict[str, dict[str, float]] = {}
    for kind in _KINDS:
        values = {
            name: metrics[f'mean_{kind}_{name}']
            for name in ('position_rms', 'heading_rms')
            if f'mean_{kind}_{name}' in metrics
        }
        if len(values) == 2:
            found[kind] = values
    return _line('mean', found)
