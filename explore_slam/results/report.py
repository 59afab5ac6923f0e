"""report.html: one self-contained page that shows a run: key figures, plots, metrics, settings."""

import math
from collections.abc import Iterable
from html import escape
from typing import Any

from explore_slam.results.plots import color_of, figures
from explore_slam.results.run_data import RunData
from explore_slam.settings import settings_of

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #f5f7fa; color: #1f2933;
  font: 15px/1.5 system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 28px 20px 48px; }
h1 { font-size: 24px; margin: 0 0 4px; font-weight: 650; }
h2 { font-size: 16px; margin: 0 0 2px; font-weight: 650; }
.sub, .caption { color: #616e7c; margin: 0 0 14px; }
.caption { font-size: 13px; }
section { background: #fff; border: 1px solid #e4e7eb; border-radius: 10px; padding: 18px 20px;
  margin-top: 18px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(128px, 1fr)); gap: 12px;
  margin-top: 18px; }
.tile { background: #fff; border: 1px solid #e4e7eb; border-radius: 10px; padding: 12px 16px; }
.tile b { display: block; white-space: nowrap; font-size: 23px; font-weight: 650;
  line-height: 1.25; }
.tile span { color: #616e7c; font-size: 13px; }
svg { width: 100%; height: auto; max-height: 880px; display: block; }
svg text { font-family: system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif
  !important; }
svg image { image-rendering: pixelated; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 6px 10px; border-bottom: 1px solid #e4e7eb;
  white-space: nowrap; }
th { color: #616e7c; font-weight: 500; font-size: 13px; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
tr.mean td { font-weight: 650; border-bottom: 0; }
.key { display: inline-block; width: 10px; height: 10px; border-radius: 3px; margin-right: 8px; }
details summary { cursor: pointer; font-weight: 650; }
details table { margin-top: 10px; font-size: 13px; }
details td { white-space: normal; text-align: left; }
ul { margin: 6px 0 0; padding-left: 20px; }
"""


def render_report(data: RunData) -> str:
    """Return the page as text."""
    parts = [
        '<!doctype html>',
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<title>{escape(data.title)}</title><style>{STYLE}</style></head><body><main>',
        f'<h1>{escape(data.title)}</h1>',
        f'<p class="sub">{escape(_subtitle(data))}</p>',
        _tiles(data),
        *(_figure(*figure) for figure in figures(data)),
        _vehicle_table(data),
        _notes(data),
        _other_metrics(data),
        _settings(data),
        '</main></body></html>',
    ]
    return '\n'.join(part for part in parts if part) + '\n'


def _subtitle(data: RunData) -> str:
    count = len(data.vehicles)
    parts = [f'{count} vehicle' + ('s' if count != 1 else '')]
    durations = [run.online.duration or run.odometry.duration for run in data.vehicles]
    if any(durations):
        parts.append(f'{max(durations):.0f} s of recorded time')
    known = (
        {info.name: value for info, value in settings_of(data.settings)} if data.settings else {}
    )
    for name, text in (('engine', 'engine {}'), ('maps', '{} map'), ('particles', '{} particles')):
        if name in known:
            parts.append(text.format(known[name]))
    return ' · '.join(parts)


def _tiles(data: RunData) -> str:
    metrics = data.metrics
    chosen: list[tuple[str, str]] = []
    for name, text in (
        ('mean_online_position_rms', 'position error, RMS'),
        ('mean_online_heading_rms', 'heading error, RMS'),
        ('mean_odometry_position_rms', 'position error of odometry alone'),
    ):
        if isinstance(metrics.get(name), float):
            degrees = 'heading' in name
            value = math.degrees(metrics[name]) if degrees else metrics[name]
            chosen.append((f'{value:.2f}°' if degrees else f'{value:.3f} m', text))
    if isinstance(metrics.get('coverage'), float):
        share = data.coverage_unit == '%'
        value = metrics['coverage'] * (100.0 if share else 1.0)
        chosen.append((f'{value:.{1 if share else 0}f}\u202f{data.coverage_unit}', 'explored'))
    for name in ('landmarks', 'collisions'):
        count = total(metrics.get(name))
        if count is not None:
            chosen.append((f'{count:,}', name))
    for found in metrics.get('observations', {}).values():
        chosen.append((f'{found["frames"]}', 'frames'))
        chosen.append((f'{found["observations_mean"]:.0f}', 'landmarks seen in a frame'))
        if 'distance_median' in found:
            chosen.append((f'{100.0 * found["matches_that_agree"]:.0f} %', 'of matches agree'))
            chosen.append((f'{found["distance_median"]:.3f} m', 'median distance of matches'))
    driven = sum(run.metrics()['distance'] for run in data.vehicles)
    chosen.append((f'{driven:.0f} m', 'driven by all'))
    tiles = (
        f'<div class="tile"><b>{escape(v)}</b><span>{escape(t)}</span></div>' for v, t in chosen
    )
    return f'<div class="tiles">{"".join(tiles)}</div>'


def total(value: Any) -> int | None:
    """Return a count, or the sum of counts per vehicle; None for anything else."""
    if isinstance(value, dict):
        counts = [total(item) for item in value.values()]
        return sum(item for item in counts if item is not None) if counts else None
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _figure(title: str, caption: str, svg: str) -> str:
    return (
        f'<section><h2>{escape(title)}</h2><p class="caption">{escape(caption)}</p>{svg}</section>'
    )


# heading of the column, trajectory, metric, factor, digits
COLUMNS = (
    ('position RMS\nonline (m)', 'online', 'position_rms', 1.0, 3),
    ('heading RMS\nonline (°)', 'online', 'heading_rms', 180.0 / math.pi, 2),
    ('position RMS\nfinal path (m)', 'estimated', 'position_rms', 1.0, 3),
    ('position RMS\naligned (m)', 'estimated', 'position_rms_aligned', 1.0, 3),
    ('drift per metre\n(m)', 'estimated', 'relative_translation_rms', 1.0, 3),
    ('odometry alone\nposition (m)', 'odometry', 'position_rms', 1.0, 3),
    ('odometry alone\nheading (°)', 'odometry', 'heading_rms', 180.0 / math.pi, 2),
)


def _vehicle_table(data: RunData) -> str:
    vehicles = data.metrics.get('vehicles', {})
    if not any(set(found) & {'online', 'estimated', 'odometry'} for found in vehicles.values()):
        return ''
    titles = ''.join(f'<th>{escape(c[0]).replace(chr(10), "<br>")}</th>' for c in COLUMNS)
    rows, table = [], []
    for index, (name, found) in enumerate(vehicles.items()):
        values = [_value(found, column) for column in COLUMNS]
        table.append(values)
        key = f'<span class="key" style="background:{color_of(index)}"></span>'
        rows.append(_row(f'{key}{escape(name)}', found.get('distance'), values))
    if len(table) > 1:
        means = [_mean(row[column] for row in table) for column in range(len(COLUMNS))]
        rows.append(_row('mean', None, means, 'mean'))
    caption = (
        'Against the truth, without alignment unless it says so. Online: the pose as it was '
        'estimated at each time. Final path: along the best particle at the end. Drift: relative '
        'pose error over 1 m pieces.'
    )
    return (
        f'<section><h2>Errors</h2><p class="caption">{caption}</p><div class="scroll"><table>'
        f'<tr><th>vehicle</th><th>driven<br>(m)</th>{titles}</tr>{"".join(rows)}</table></div>'
        '</section>'
    )


def _value(found: dict[str, Any], column: tuple[str, str, str, float, int]) -> float | None:
    errors = found.get(column[1])
    value = errors.get(column[2]) if errors else None
    return None if value is None else column[3] * float(value)


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _row(name: str, distance: float | None, values: list[float | None], kind: str = '') -> str:
    cells = [f'<td>{name}</td>', f'<td>{"" if distance is None else f"{distance:.1f}"}</td>']
    for value, column in zip(values, COLUMNS, strict=True):
        cells.append(f'<td>{"–" if value is None else f"{value:.{column[4]}f}"}</td>')
    return f'<tr class="{kind}">{"".join(cells)}</tr>'


def _notes(data: RunData) -> str:
    if not data.notes:
        return ''
    items = ''.join(f'<li>{escape(note)}</li>' for note in data.notes)
    return f'<section><h2>Notes</h2><ul>{items}</ul></section>'


def _other_metrics(data: RunData) -> str:
    rows = [
        (name, value)
        for name, value in _flat(data.metrics)
        if not name.startswith(('vehicles.', 'mean_'))
    ]
    if not rows:
        return ''
    body = ''.join(f'<tr><td>{escape(n)}</td><td>{escape(_text(v))}</td></tr>' for n, v in rows)
    return (
        '<section><details><summary>More figures</summary>'
        f'<table>{body}</table></details></section>'
    )


def _settings(data: RunData) -> str:
    if data.settings is None:
        return ''
    rows = []
    for info, value in settings_of(data.settings):
        changed = ' style="font-weight:650"' if value != info.default else ''
        rows.append(
            f'<tr{changed}><td>{escape(info.name)}</td><td>{escape(_text(value))} '
            f'{escape(info.unit)}</td><td>{escape(info.doc)}</td></tr>'
        )
    return (
        '<section><details><summary>Settings (bold: not the default)</summary><table>'
        f'{"".join(rows)}</table></details></section>'
    )


def _flat(values: dict[str, Any], prefix: str = '') -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in values.items():
        if isinstance(value, dict):
            found += _flat(value, f'{prefix}{name}.')
        else:
            found.append((f'{prefix}{name}', value))
    return found


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f'{value:.6g}'
    return '–' if value is None else str(value)
