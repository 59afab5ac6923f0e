"""The report of a run: one self-contained HTML page with key metrics, plots, errors and settings.

This module selects and formats what the page shows; the page itself is a Jinja2 template with a
style sheet, in `templates/`.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from explore_slam.exploration import unreached_text
from explore_slam.results.plots import color_of, figures
from explore_slam.results.run_data import RunData
from explore_slam.settings import settings_of

DEGREES = 180.0 / math.pi
MISSING = '–'


class Tile(NamedTuple):
    """A key metric at the top of the page."""

    value: str
    label: str


class ErrorColumn(NamedTuple):
    """A column of the error table: heading, which metric of which trajectory, factor, digits."""

    title: str
    subtitle: str
    trajectory: str
    metric: str
    factor: float
    digits: int


class ErrorRow(NamedTuple):
    """A row of the error table; without colour it is the mean over the vehicles."""

    name: str
    color: str | None
    cells: tuple[str, ...]


class SettingRow(NamedTuple):
    """A row of the table of settings."""

    name: str
    value: str
    doc: str
    changed: bool


ERROR_COLUMNS = (
    ErrorColumn('position RMS', 'online (m)', 'online', 'position_rms', 1.0, 3),
    ErrorColumn('heading RMS', 'online (°)', 'online', 'heading_rms', DEGREES, 2),
    ErrorColumn('pose NEES', 'mean (ideal 3)', 'online', 'pose_nees_mean', 1.0, 1),
    ErrorColumn('inside 95 %', 'ellipse (%)', 'online', 'position_in_95', 100.0, 0),
    ErrorColumn('position RMS', 'final path (m)', 'estimated', 'position_rms', 1.0, 3),
    ErrorColumn('position RMS', 'aligned (m)', 'estimated', 'position_rms_aligned', 1.0, 3),
    ErrorColumn('drift per meter', '(m)', 'estimated', 'relative_translation_rms', 1.0, 3),
    ErrorColumn('odometry alone', 'position (m)', 'odometry', 'position_rms', 1.0, 3),
    ErrorColumn('odometry alone', 'heading (°)', 'odometry', 'heading_rms', DEGREES, 2),
)


def render_report(data: RunData) -> str:
    """Return the page as text; the same data give the same text."""
    environment = Environment(
        loader=PackageLoader('explore_slam.results', 'templates'),
        autoescape=lambda name: name is not None and name.endswith('.html.jinja'),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template('report.html.jinja').render(
        title=data.title,
        subtitle=_subtitle(data),
        tiles=_tiles(data),
        figures=figures(data),
        error_columns=ERROR_COLUMNS,
        error_rows=_error_rows(data.metrics.get('vehicles', {})),
        calibration_rows=_calibration_rows(data.metrics.get('odometry_calibration', {})),
        notes=data.notes,
        metrics=_other_metrics(data.metrics),
        settings=_setting_rows(data),
    )


def _subtitle(data: RunData) -> str:
    count = len(data.vehicles)
    parts = [f'{count} vehicle' + ('s' if count != 1 else '')]
    durations = [run.online.duration or run.odometry.duration for run in data.vehicles]
    if any(durations):
        parts.append(f'{max(durations):.0f} s recorded')
    known = (
        {info.name: value for info, value in settings_of(data.settings)} if data.settings else {}
    )
    for name, text in (('engine', 'engine {}'), ('maps', '{} map'), ('particles', '{} particles')):
        if name in known:
            parts.append(text.format(known[name]))
    return ' · '.join(parts)


def _tiles(data: RunData) -> list[Tile]:
    metrics = data.metrics
    tiles: list[Tile] = []
    for name, label in (
        ('mean_online_position_rms', 'position error, RMS'),
        ('mean_online_heading_rms', 'heading error, RMS'),
        ('mean_odometry_position_rms', 'position error of odometry alone'),
    ):
        value = metrics.get(name)
        if isinstance(value, float):
            text = f'{DEGREES * value:.2f}°' if 'heading' in name else f'{value:.3f} m'
            tiles.append(Tile(text, label))
    if isinstance(metrics.get('coverage'), float):
        relative = data.coverage_unit == '%'
        value = metrics['coverage'] * (100.0 if relative else 1.0)
        text = f'{value:.{1 if relative else 0}f}\u202f{data.coverage_unit}'
        tiles.append(Tile(text, 'explored'))
    if metrics.get('unreached_frontiers'):
        left = unreached_text(metrics['unreached_frontiers'], metrics['unreached_m2'])
        tiles.append(Tile(left, 'out of reach'))
    for name in ('landmarks', 'collisions'):
        count = total(metrics.get(name))
        if count is not None:
            tiles.append(Tile(f'{count:,}', name))
    for found in metrics.get('observations', {}).values():
        tiles.append(Tile(f'{found["frames"]}', 'frames'))
        tiles.append(Tile(f'{found["observations_mean"]:.0f}', 'observations per frame'))
        if 'distance_median' in found:
            tiles.append(Tile(f'{100.0 * found["matches_that_agree"]:.0f} %', 'of matches agree'))
            tiles.append(Tile(f'{found["distance_median"]:.3f} m', 'median distance of matches'))
    distance = sum(run.metrics()['distance'] for run in data.vehicles)
    tiles.append(Tile(f'{distance:.0f} m', 'distance of all vehicles'))
    return tiles


def total(value: Any) -> int | None:
    """Return a count, or the sum of counts per vehicle; None for anything else."""
    if isinstance(value, dict):
        counts = [total(item) for item in value.values()]
        return sum(item for item in counts if item is not None) if counts else None
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _error_rows(vehicles: dict[str, Any]) -> list[ErrorRow]:
    if not any(set(found) & {'online', 'estimated', 'odometry'} for found in vehicles.values()):
        return []
    rows, table = [], []
    for index, (name, found) in enumerate(vehicles.items()):
        values = [_error(found, column) for column in ERROR_COLUMNS]
        table.append(values)
        distance = found.get('distance')
        text = '' if distance is None else f'{distance:.1f}'
        rows.append(ErrorRow(name, color_of(index), (text, *_cells(values))))
    if len(table) > 1:
        means = [_mean(column) for column in zip(*table, strict=True)]
        rows.append(ErrorRow('mean', None, ('', *_cells(means))))
    return rows


def _error(found: dict[str, Any], column: ErrorColumn) -> float | None:
    errors = found.get(column.trajectory)
    value = errors.get(column.metric) if errors else None
    return None if value is None else column.factor * float(value)


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _cells(values: Iterable[float | None]) -> list[str]:
    return [
        MISSING if value is None else f'{value:.{column.digits}f}'
        for value, column in zip(values, ERROR_COLUMNS, strict=True)
    ]


def _calibration_rows(vehicles: dict[str, dict[str, float]]) -> list[tuple[str, ...]]:
    """Return name, scales of turns and distances, and heading drift (° per m), with deviations."""
    return [
        (
            name,
            f'{found["turn_scale"]:.3f} ± {found["turn_scale_deviation"]:.3f}',
            f'{found["distance_scale"]:.3f} ± {found["distance_scale_deviation"]:.3f}',
            f'{DEGREES * found["heading_drift_rad_per_m"]:.2f} ± '
            f'{DEGREES * found["heading_drift_deviation_rad_per_m"]:.2f}',
        )
        for name, found in vehicles.items()
        if found
    ]


def _other_metrics(metrics: dict[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of the metrics that are neither in the tiles nor in the table."""
    return [
        (name, _text(value))
        for name, value in _flatten(metrics)
        if not name.startswith(('vehicles.', 'mean_', 'odometry_calibration.'))
    ]


def _flatten(values: dict[str, Any], prefix: str = '') -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in values.items():
        if isinstance(value, dict):
            found += _flatten(value, f'{prefix}{name}.')
        else:
            found.append((f'{prefix}{name}', value))
    return found


def _setting_rows(data: RunData) -> list[SettingRow]:
    if data.settings is None:
        return []
    return [
        SettingRow(
            info.name, f'{_text(value)} {info.unit}'.strip(), info.doc, value != info.default
        )
        for info, value in settings_of(data.settings)
    ]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f'{value:.6g}'
    return MISSING if value is None else str(value)
