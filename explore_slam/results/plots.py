"""The figures of a report, each as the text of one SVG element.

Figures are drawn without pyplot: no display, backend or global state is involved.
"""

import io
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from explore_slam.errors import EvaluationError
from explore_slam.files import write_bytes
from explore_slam.geometry import Array
from explore_slam.mapping import OccupancyGrid
from explore_slam.results.consistency import EstimationErrors, estimation_errors
from explore_slam.results.run_data import Panel, RunData, Series, VehicleRun, error_series
from explore_slam.results.trajectory import Trajectory

# Okabe and Ito, Color Universal Design (2008): distinguishable with any colour vision.
PALETTE = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9', '#7a5195', '#404040')
INK, MUTED, GRID = '#1f2933', '#7b8794', '#e4e7eb'
UNKNOWN, FREE, OCCUPIED = '#dfe4ea', '#ffffff', '#323f4b'
# Points per curve that a figure of 10 inches still resolves; more only make the file larger.
MAX_POINTS = 1500
MAX_LANDMARKS = 4000
MAX_BINS = 500
STYLE: dict[str, Any] = {
    'svg.fonttype': 'none',
    'font.family': 'sans-serif',
    'font.size': 10,
    'text.color': INK,
    'axes.labelcolor': INK,
    'axes.edgecolor': '#9aa5b1',
    'axes.linewidth': 0.8,
    'axes.grid': True,
    'axes.axisbelow': True,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'grid.color': GRID,
    'grid.linewidth': 0.8,
    'xtick.color': '#52606d',
    'ytick.color': '#52606d',
    'legend.frameon': False,
    'legend.fontsize': 9,
}


def color_of(index: int) -> str:
    """Return the colour of the vehicle with this index."""
    return PALETTE[index % len(PALETTE)]


def map_figure(data: RunData) -> str | None:
    """Draw grid map, landmarks and trajectories; None where there are none of them."""
    figure = _draw_map(data)
    return None if figure is None else _svg(figure, 'map', bbox_inches='tight', pad_inches=0.05)


def save_map_picture(data: RunData, path: Path, width: int = 1000) -> None:
    """Write the map figure as a PNG file about `width` pixels wide.

    EvaluationError where the run holds nothing to draw or the file cannot be written.
    """
    figure = _draw_map(data)
    if figure is None:
        raise EvaluationError(f'{data.title}: no grid, landmarks or trajectories to draw')
    buffer = io.BytesIO()
    dpi = width / figure.get_size_inches()[0]
    figure.savefig(buffer, format='png', dpi=dpi, bbox_inches='tight', pad_inches=0.05)
    try:
        write_bytes(path, buffer.getvalue())
    except OSError as error:
        raise EvaluationError(f'{path} cannot be written: {error}') from error


def _draw_map(data: RunData) -> Figure | None:
    extent = _view(data)
    if extent is None:
        return None
    left, right, bottom, top = extent
    width = 10.0
    height = float(np.clip(width * (top - bottom) / max(right - left, 1e-6) + 0.9, 3.0, 10.0))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout='constrained')
        axes = figure.add_subplot()
        axes.set_aspect('equal')
        axes.grid(visible=data.grid is None)
        if data.grid is not None:
            _draw_grid(axes, data.grid)
        if data.landmarks is not None and len(data.landmarks.means):
            means = _thin(np.asarray(data.landmarks.means), MAX_LANDMARKS)
            size = 5.0 if len(means) > 100 else 28.0
            axes.scatter(
                means[:, 0],
                means[:, 1],
                s=size,
                color='#b7791f',
                alpha=0.55,
                linewidths=0,
                label='landmarks',
            )
        for index, run in enumerate(data.vehicles):
            _draw_vehicle(axes, run, color_of(index))
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel='x (m)', ylabel='y (m)')
        _legend(axes, min(6, 2 + 2 * len(data.vehicles)))
        return figure


def _draw_grid(axes: Axes, grid: OccupancyGrid) -> None:
    probability, known = np.asarray(grid.probability()), np.asarray(grid.known())
    shade = np.where(known, np.clip((probability - 0.25) / 0.5, 0.0, 1.0), 0.0)
    levels = np.where(known, 1.0 + np.rint(254.0 * shade), 0.0).astype(np.uint8)
    free, occupied = np.array(mpl.colors.to_rgb(FREE)), np.array(mpl.colors.to_rgb(OCCUPIED))
    ramp = free + np.linspace(0.0, 1.0, 255)[:, None] * (occupied - free)
    colors = ListedColormap(np.vstack([mpl.colors.to_rgb(UNKNOWN), ramp]))
    x, y = float(grid.origin[0]), float(grid.origin[1])
    rows, columns = levels.shape
    axes.imshow(
        levels,
        cmap=colors,
        vmin=0,
        vmax=255,
        origin='lower',
        interpolation='none',
        extent=(x, x + columns * grid.resolution, y, y + rows * grid.resolution),
    )


def _draw_vehicle(axes: Axes, run: VehicleRun, color: str) -> None:
    path = run.estimated if len(run.estimated) else run.online
    if len(run.odometry):
        _draw_path(axes, run.odometry, color=color, lw=0.9, ls=(0, (1, 2.5)), alpha=0.45)
    if len(path):
        _draw_path(axes, path, color=color, lw=2.2, label=run.name)
    if len(run.truth):
        _draw_path(axes, run.truth, color=INK, lw=0.8, ls=(0, (5, 3)), alpha=0.8)
    if not len(path):
        return
    axes.plot(*path.poses[0, :2], 'o', ms=7, mfc='white', mec=color, mew=1.8)
    x, y, theta = path.poses[-1]
    axes.plot(x, y, marker=(3, 0, math.degrees(theta) - 90.0), ms=11, mfc=color, mec='white')


def _draw_path(axes: Axes, path: Trajectory, **style: Any) -> None:
    axes.plot(*_thin(path.poses)[:, :2].T, **style)


def _view(data: RunData) -> tuple[float, float, float, float] | None:
    """Return left, right, bottom, top (m) of the map view; odometry alone may leave it."""
    parts = [
        path.poses[:, :2]
        for run in data.vehicles
        for path in (run.estimated, run.online, run.truth)
        if len(path)
    ]
    if data.grid is not None:
        rows, columns = np.nonzero(np.asarray(data.grid.known()))
        if rows.size:
            corners = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]])
            parts.append(np.asarray(data.grid.origin)[:2] + corners * data.grid.resolution)
    elif data.landmarks is not None and len(data.landmarks.means):
        # A few distant outliers among the landmarks must not shrink everything else.
        means = np.asarray(data.landmarks.means)[:, :2]
        parts.append(np.quantile(means, [0.01, 0.99], axis=0))
    if not parts:
        return None
    points = np.concatenate(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.03 * float((high - low).max()) + 0.3
    return (
        float(low[0] - margin),
        float(high[0] + margin),
        float(low[1] - margin),
        float(high[1] + margin),
    )


def error_figure(data: RunData) -> str | None:
    """Draw position and heading errors over time; None without ground truth."""
    begin = _begin(data)
    found: list[tuple[str, str, tuple[Series, Series], tuple[Series, Series]]] = []
    for index, run in enumerate(data.vehicles):
        path = run.online if len(run.online) else run.estimated
        errors, alone = error_series(path, run.truth), error_series(run.odometry, run.truth)
        if len(errors[0]):
            found.append((run.name, color_of(index), errors, alone))
    if not found:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.0), layout='constrained')
        upper, lower = figure.subplots(2, 1, sharex=True)
        for panel, (axes, scale) in enumerate(((upper, 1.0), (lower, 180.0 / math.pi))):
            highest = 0.0
            for name, color, errors, alone in found:
                values = scale * errors[panel].values
                highest = max(highest, float(np.quantile(values, 0.995)))
                if len(alone[panel]):
                    times, odometry = _binned(alone[panel], np.mean)
                    axes.plot(
                        times - begin, scale * odometry, color=color, lw=0.9, ls=':', alpha=0.6
                    )
                times, worst = _binned(errors[panel], np.max)
                axes.plot(times - begin, scale * worst, color=color, lw=1.4, label=name)
            axes.set_ylim(0.0, 1.25 * highest + 1e-3)
        upper.set_ylabel('position error (m)')
        lower.set_ylabel('heading error (°)')
        lower.set_xlabel('time (s)')
        _legend(upper, 6)
        return _svg(figure, 'errors')


def consistency_figure(data: RunData) -> str | None:
    """Draw errors of x, y and heading within ±2 σ as published; None without ground truth."""
    found = [
        (run.name, color_of(index), errors)
        for index, run in enumerate(data.vehicles)
        if len(errors := estimation_errors(run.estimates, run.truth)) > 1
    ]
    if not found:
        return None
    begin = _begin(data)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 1.0 + 1.5 * len(found) + 2.5), layout='constrained')
        grid = figure.subplots(len(found), 3, sharex=True, squeeze=False)
        for row, (name, color, errors) in zip(grid, found, strict=True):
            for axes, component in zip(row, range(3), strict=True):
                _draw_band(axes, errors, component, begin, color)
            row[0].set_ylabel(name)
        for axes, title in zip(grid[0], ('x (m)', 'y (m)', 'heading (°)'), strict=True):
            axes.set_title(f'error of {title}', fontsize=10)
        for axes in grid[-1]:
            axes.set_xlabel('time (s)')
        return _svg(figure, 'consistency')


def _draw_band(
    axes: Axes, errors: EstimationErrors, component: int, begin: float, color: str
) -> None:
    scale = 180.0 / math.pi if component == 2 else 1.0
    sigmas = Series(errors.stamps, scale * errors.sigmas[:, component])
    times, bands = _binned(sigmas, np.mean)
    _, low = _binned(Series(errors.stamps, scale * errors.errors[:, component]), np.min)
    _, high = _binned(Series(errors.stamps, scale * errors.errors[:, component]), np.max)
    times = times - begin
    axes.fill_between(times, -2.0 * bands, 2.0 * bands, color=color, alpha=0.18, linewidth=0)
    axes.fill_between(times, low, high, color=color, alpha=0.6, linewidth=0)
    axes.plot(times, 0.5 * (low + high), color=color, lw=0.9)
    limit = 1.2 * max(
        2.0 * float(np.quantile(bands, 0.98)), float(np.quantile(np.maximum(-low, high), 0.995))
    )
    axes.set_ylim(-limit - 1e-4, limit + 1e-4)


def coverage_figure(data: RunData) -> str | None:
    """Draw the explored area over time; None where it was not measured."""
    if len(data.coverage) < 2:
        return None
    values = data.coverage.values * (100.0 if data.coverage_unit == '%' else 1.0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 2.6), layout='constrained')
        axes = figure.add_subplot()
        times = data.coverage.stamps - _begin(data)
        axes.fill_between(times, values, step='post', color=PALETTE[0], alpha=0.12, linewidth=0)
        axes.step(times, values, where='post', color=PALETTE[0], lw=1.8)
        axes.annotate(
            f'{values[-1]:.1f} {data.coverage_unit}',
            (times[-1], values[-1]),
            xytext=(-4, -12),
            textcoords='offset points',
            ha='right',
            color=PALETTE[0],
            fontweight='bold',
        )
        top = 102.0 if data.coverage_unit == '%' else 1.06 * float(values.max()) + 1e-3
        axes.set(ylim=(0.0, top), xlabel='time (s)', ylabel=f'explored ({data.coverage_unit})')
        axes.set_xlim(left=min(0.0, float(times[0])))
        return _svg(figure, 'coverage')


def particles_figure(data: RunData) -> str | None:
    """Draw the effective sample size over time; None where there were no updates."""
    if len(data.effective_particles) < 2:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 2.6), layout='constrained')
        axes = figure.add_subplot()
        begin = _begin(data)
        times, low = _binned(data.effective_particles, np.min)
        _, high = _binned(data.effective_particles, np.max)
        _, middle = _binned(data.effective_particles, np.median)
        axes.fill_between(times - begin, low, high, color=PALETTE[2], alpha=0.18, linewidth=0)
        axes.plot(times - begin, middle, color=PALETTE[2], lw=1.4)
        top = float(max(data.particles, high.max()))
        if data.particles:
            axes.axhline(data.particles, color=MUTED, lw=0.9, ls='--')
            axes.annotate(
                f'{data.particles} particles',
                (0.0, data.particles),
                xytext=(4, 3),
                textcoords='offset points',
                color=MUTED,
                fontsize=9,
            )
        axes.set(ylim=(0.0, 1.15 * top), xlabel='time (s)', ylabel='effective particles')
        axes.set_xlim(left=0.0)
        return _svg(figure, 'particles')


def panel_figure(panel: Panel, name: str) -> str | None:
    """Draw an additional series over the time since its start; None where it is empty."""
    if not len(panel.series):
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 2.6), layout='constrained')
        axes = figure.add_subplot()
        times, values = _binned(panel.series, np.mean)
        axes.plot(times - times[0], values, color=PALETTE[0], lw=1.6, marker='o', ms=2.5)
        top = float(values.max())
        axes.set(ylim=(0.0, 1.15 * top + 1e-9), xlabel='time (s)', ylabel=panel.label)
        return _svg(figure, name)


def _begin(data: RunData) -> float:
    firsts = [
        float(path.stamps[0])
        for run in data.vehicles
        for path in (run.online, run.estimated, run.odometry)
        if len(path)
    ]
    firsts += [float(series.stamps[0]) for series in (data.coverage,) if len(series)]
    return min(firsts, default=0.0)


def _thin(points: Array, limit: int = MAX_POINTS) -> Array:
    """Return at most `limit` rows, evenly spaced, including the first and the last one."""
    if len(points) <= limit:
        return points
    chosen = np.unique(np.linspace(0, len(points) - 1, limit).astype(int))
    thinned: Array = points[chosen]
    return thinned


def _binned(series: Series, reduce: Any, bins: int = MAX_BINS) -> tuple[Array, Array]:
    """Reduce a long series over equal intervals of time, so that no peak is lost."""
    if len(series) <= bins:
        return series.stamps, series.values
    edges = np.linspace(series.stamps[0], series.stamps[-1], bins + 1)
    starts = np.unique(np.searchsorted(series.stamps, edges[:-1]))
    parts = np.split(np.arange(len(series)), starts[1:])
    times = np.array([series.stamps[part].mean() for part in parts])
    return times, np.array([reduce(series.values[part]) for part in parts])


def _legend(axes: Axes, columns: int) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc='lower left',
            bbox_to_anchor=(0.0, 1.0),
            ncols=columns,
            borderaxespad=0.2,
            markerscale=2.5,
        )


def _svg(figure: Figure, name: str, **options: Any) -> str:
    buffer = io.StringIO()
    # The salt keeps the ids of several figures on one page distinct and reproducible.
    with mpl.rc_context({'svg.hashsalt': name}):
        figure.savefig(buffer, format='svg', metadata={'Date': None}, **options)
    text = buffer.getvalue()
    text = text[text.index('<svg') :]
    text = re.sub(r' id="[A-Za-z0-9.]+_[0-9]+"', '', text)
    text = re.sub(r'<metadata>.*?</metadata>', '', text, flags=re.DOTALL)
    size = re.search(r'viewBox="[^"]*"', text)
    head = f'<svg {size.group(0) if size else ""} role="img" xmlns="http://www.w3.org/2000/svg"'
    body = text[text.index('>') :]
    return f'{head} xmlns:xlink="http://www.w3.org/1999/xlink"{body}'


class ReportFigure(NamedTuple):
    """A figure of the report; svg: text of the SVG element."""

    title: str
    caption: str
    svg: str


def figures(data: RunData) -> list[ReportFigure]:
    """Return every figure for which the run has data."""
    drawn = (
        (
            'Map and trajectories',
            'Solid: estimated path of each vehicle from circle to arrow. Dashed: true path. '
            'Dotted: odometry alone.',
            map_figure(data),
        ),
        (
            'Errors over time',
            'Error of the pose as estimated at each time, against ground truth; in long runs the '
            'largest error of each short interval. Dotted: odometry alone, which may leave the '
            'plot.',
            error_figure(data),
        ),
        (
            'Consistency',
            'Errors of the published pose (line) and twice its published standard deviation '
            '(band), which should contain 95 % of the errors.',
            consistency_figure(data),
        ),
        ('Coverage over time', 'Area that the team has explored.', coverage_figure(data)),
        (
            'Effective sample size',
            'Effective number of particles after each update: median, and range from minimum to '
            'maximum.',
            particles_figure(data),
        ),
    )
    more = (
        (panel.title, panel.caption, panel_figure(panel, f'panel{index}'))
        for index, panel in enumerate(data.panels)
    )
    return [
        ReportFigure(title, caption, svg)
        for title, caption, svg in (*drawn, *more)
        if svg is not None
    ]
