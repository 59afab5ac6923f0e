"""Size, colours and axes that all plots of studies share."""

from typing import Any

from matplotlib.figure import Figure

COLORS = {
    'truth': '#222222',
    'odometry': '#999999',
    'fastslam2': '#1f6fb4',
    'paper': '#d9782d',
    'iSAM2': '#3a9a5b',
    'robot1': '#1f6fb4',
    'robot2': '#c0392b',
}


def new_figure(columns: int = 1, rows: int = 1, width: float = 5.4, height: float = 3.8) -> Any:
    """Return a figure without display, and its axes (rows, columns)."""
    figure = Figure(figsize=(width * columns, height * rows), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.spines[['top', 'right']].set_visible(False)
        axis.grid(True, color='#dddddd', linewidth=0.6)
        axis.set_axisbelow(True)
    return figure, axes
