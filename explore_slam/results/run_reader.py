"""Reading a run folder back: grid and trajectories, for pictures and comparisons."""

import json
from pathlib import Path
from typing import Any

from explore_slam.errors import EvaluationError
from explore_slam.mapping import load_map
from explore_slam.results.run_data import RunData, VehicleRun
from explore_slam.results.run_folder import KINDS
from explore_slam.results.trajectory import load_tum

_FIELDS = {'true': 'truth'}  # file name -> field of VehicleRun, where they differ


def read_metrics(folder: Path) -> dict[str, Any]:
    """Return the content of metrics.json; EvaluationError where it is missing or damaged."""
    path = folder / 'metrics.json'
    try:
        content = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise EvaluationError(f'{path} cannot be read: {error}') from error
    if not isinstance(content, dict):
        raise EvaluationError(f'{path} holds {type(content).__name__}, expected an object')
    return content


def read_run(folder: Path) -> RunData:
    """Return metrics, grid and trajectories of a run folder; landmarks stay out."""
    metrics = read_metrics(folder)
    kinds: dict[str, dict[str, Any]] = {}
    for kind in KINDS:
        suffix = f'_{kind}.tum'
        for path in sorted(folder.glob(f'*{suffix}')):
            name = path.name.removesuffix(suffix)
            kinds.setdefault(name, {})[_FIELDS.get(kind, kind)] = load_tum(path)
    vehicles = tuple(VehicleRun(name, **found) for name, found in sorted(kinds.items()))
    map_file = folder / 'map.yaml'
    grid = load_map(map_file) if map_file.exists() else None
    return RunData(folder.resolve().name, vehicles, metrics, grid)
