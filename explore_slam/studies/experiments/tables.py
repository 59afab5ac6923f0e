"""Report of an experiment: its tables and figures, beside the published values."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.errors import EvaluationError
from explore_slam.files import write_text
from explore_slam.results.run_folder import RunFolder
from explore_slam.results.tables import markdown_table

# Tables II (crossing paths, 28 steps) and III (separate paths, 16 steps): RMS of x, y (m) and
# heading (rad), steps with an estimate, steps, landmark updates; case a dedicated, b common.
PAPER_ACCURACY: dict[str, dict[tuple[str, str], tuple[float, float, float, int, int, int]]] = {
    'crossing': {
        ('dedicated', 'robot1'): (0.042, 0.040, 0.108, 16, 28, 106),
        ('dedicated', 'robot2'): (0.042, 0.037, 0.105, 17, 28, 71),
        ('common', 'robot1'): (0.045, 0.043, 0.066, 23, 28, 180),
        ('common', 'robot2'): (0.038, 0.041, 0.073, 25, 28, 215),
    },
    'separate': {
        ('dedicated', 'robot1'): (0.027, 0.032, 0.062, 13, 16, 92),
        ('dedicated', 'robot2'): (0.032, 0.029, 0.066, 13, 16, 82),
        ('common', 'robot1'): (0.026, 0.032, 0.069, 14, 16, 140),
        ('common', 'robot2'): (0.029, 0.028, 0.059, 15, 16, 143),
    },
}
PAPER_ACCURACY['late crossing'] = {}
PAPER_TABLE = {
    'crossing': 'Table II',
    'separate': 'Table III',
    'late crossing': 'Not in the paper',
}
# Table IV: squared descriptor distance -> percentage of all distances below.
PAPER_DISTANCES = {
    0.1: 0.0,
    0.3: 0.003,
    0.5: 0.065,
    0.7: 0.550,
    0.9: 3.061,
    1.1: 15.971,
    1.2: 34.002,
}
# Table V: E0 -> correct and total associations of two images
PAPER_ASSOCIATIONS = {0.4: (4, 4), 0.5: (13, 14), 0.6: (22, 25), 0.7: (31, 42)}
# Table VI: E0 -> steps (of 16) with an estimate, updates, seconds
PAPER_THRESHOLDS = {0.3: (3, 3, 299), 0.4: (6, 15, 319), 0.5: (8, 37, 334), 0.6: (9, 88, 369)}
# Table VII: case, vehicle -> steps (of 13) with an estimate, updates, minutes
PAPER_TEAM = {
    ('dedicated', 'robot1'): (5, 38, 4.10),
    ('dedicated', 'robot2'): (8, 47, 3.71),
    ('common', 'robot1'): (5, 54, 9.98),
    ('common', 'robot2'): (12, 831, 9.98),
}


@dataclass(frozen=True)
class Table:
    """A table of text; every row has one cell per column."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise EvaluationError(
                    f'table {self.title!r}: row {row} has {len(row)} cells, '
                    f'expected {len(self.header)}'
                )

    def markdown(self) -> str:
        """Return the table as Markdown with aligned columns."""
        return f'### {self.title}\n\n{markdown_table(self.header, self.rows, aligned=True)}'


@dataclass
class ExperimentReport:
    """Results of an experiment: tables, remarks, figures by file name, metrics."""

    title: str
    tables: list[Table] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)

    def markdown(self) -> str:
        """Return title, tables and remarks as Markdown."""
        parts = [f'## {self.title}', *(table.markdown() for table in self.tables)]
        if self.remarks:
            parts.append('\n'.join(f'- {remark}' for remark in self.remarks))
        return '\n\n'.join(parts) + '\n'

    def save(self, base: Path) -> Path:
        """Write report.md, metrics.json and the plots into a new run folder below base."""
        run = RunFolder.create(base)
        write_text(run.path / 'report.md', self.markdown())
        run.write_metrics(self.metrics)
        for name, figure in self.figures.items():
            figure.savefig(run.path / f'{name}.png', dpi=130)
        return run.path


def spread(values: Iterable[float], digits: int = 3) -> str:
    """Return 'mean ± standard deviation' of values but NaN; of a single value, only the mean."""
    array = np.array([value for value in values if not math.isnan(value)])
    if array.size == 0:
        return '–'
    mean = f'{array.mean():.{digits}f}'
    return mean if array.size == 1 else f'{mean} ± {array.std(ddof=1):.{digits}f}'


def share(part: float, whole: float, digits: int = 1) -> str:
    """Return 'part/whole', as the paper prints steps with an estimate."""
    return f'{part:.{digits}f}/{whole:g}'
