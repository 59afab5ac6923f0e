"""Tables as Markdown, figures as JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from explore_slam.results.tables import json_value, markdown_table


def test_a_table_has_one_line_per_row_and_one_cell_per_column():
    assert markdown_table(['a', 'bb'], [('1', ''), ('22', '3')]) == (
        '| a | bb |\n|---|---|\n| 1 |  |\n| 22 | 3 |'
    )
    assert markdown_table(['a'], []) == '| a |\n|---|'


def test_an_aligned_table_pads_its_cells():
    assert markdown_table(['a', 'bb'], [('1', ''), ('22', '3')], aligned=True) == (
        '| a  | bb |\n| -- | -- |\n| 1  |    |\n| 22 | 3  |'
    )
    with pytest.raises(ValueError, match='zip'):
        markdown_table(['a', 'b'], [('1', '2', '3')], aligned=True)


def test_json_has_null_for_what_is_not_finite_and_lists_for_arrays():
    value = {
        'error': np.float64(np.nan),
        'poses': np.array([[1.0, np.inf], [0.5, 2.0]]),
        3: (True, None, np.int64(7)),
        'world': Path('office.yaml'),
    }
    plain = json_value(value)
    assert plain == {
        'error': None,
        'poses': [[1.0, None], [0.5, 2.0]],
        '3': [True, None, 7],
        'world': 'office.yaml',
    }
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
