"""Tables and figures of results as text: Markdown and JSON."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.files import write_text


def markdown_table(
    header: Sequence[str], rows: Iterable[Sequence[str]], *, aligned: bool = False
) -> str:
    """Return a Markdown table without a line break at its end.

    aligned: pad all cells of a column to one width, for tables that are also read as text.
    """
    lines = [tuple(header), *(tuple(row) for row in rows)]
    rule = '|' + '---|' * len(header)
    if aligned:
        widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
        lines = [
            tuple(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            for line in lines
        ]
        rule = _row(['-' * width for width in widths])
    first, *others = map(_row, lines)
    return '\n'.join([first, rule, *others])


def _row(cells: Iterable[str]) -> str:
    return '| ' + ' | '.join(cells) + ' |'


def json_value(value: Any) -> Any:
    """Return a value as JSON holds it: arrays as lists, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [json_value(item) for item in value]
    if isinstance(value, np.generic):
        return json_value(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, bool | int | str) or value is None:
        return value
    return str(value)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write figures as JSON; those that are not finite become null."""
    write_text(path, json.dumps(json_value(content), indent=2, allow_nan=False) + '\n')
