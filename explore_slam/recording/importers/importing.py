"""Reading of tables and writing of bags for importers."""

import heapq
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from explore_slam.errors import RecordingError
from explore_slam.files import atomic, write_text
from explore_slam.geometry import Array
from explore_slam.recording.bag import BagWriter
from explore_slam.recording.events import Event, write_event
from explore_slam.recording.storage.file_kinds import check_not_lfs_pointer

SETTINGS_FILE = 'settings.yaml'


def read_table(path: Path, columns: int) -> Array:
    """Return the numbers of a text file (N, columns); '#' starts a comment.

    RecordingError if it cannot be read, has another number of columns, or holds no or non-finite
    numbers.
    """
    try:
        table = np.loadtxt(path, ndmin=2, dtype=np.float64)
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error}') from error
    except ValueError as error:
        raise RecordingError(f'{path} is not a table of numbers: {error}') from error
    if table.shape[1] != columns or not len(table):
        raise RecordingError(
            f'{path} holds {len(table)} rows of {table.shape[1]} numbers, '
            f'expected one row or more of {columns}'
        )
    if not np.isfinite(table).all():
        raise RecordingError(f'{path} holds a number that is not finite')
    return table


def require(folder: Path, names: Iterable[str], what: str) -> None:
    """Raise RecordingError unless the folder holds all the files of a data set."""
    names = list(names)
    if not folder.is_dir():
        raise RecordingError(f'{folder} is not a folder, expected {what}')
    missing = [name for name in names if not (folder / name).exists()]
    if missing:
        raise RecordingError(f'{folder} is not {what}: {", ".join(missing)} is missing')
    for name in names:
        check_not_lfs_pointer(folder / name)


def write_bag(
    path: Path, streams: Iterable[Iterable[Event]], settings: Mapping[str, Any]
) -> dict[str, int]:
    """Merge streams, each in time order, into a new bag; return the messages per topic.

    settings: written into the bag as settings.yaml; a replay uses them by default. The bag
    appears complete or not at all.
    """
    if path.exists():
        raise RecordingError(f'{path} exists already, expected a new name for the bag')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic(path) as partial:
            with BagWriter(partial, compress=True) as writer:
                for event in heapq.merge(*streams, key=lambda event: event.stamp):
                    write_event(writer, event)
                counts = writer.topic_counts()
            if not counts:
                raise RecordingError(f'nothing to write to {path}: the data set holds no records')
            if settings:
                write_settings(partial, settings)
    except OSError as error:
        raise RecordingError(f'{path} cannot be written: {error}') from error
    return counts


def write_settings(bag: Path, settings: Mapping[str, Any]) -> None:
    """Write settings for the replay of a bag into its folder, as a ROS parameter file."""
    content = {'/**': {'ros__parameters': dict(settings)}}
    text = '# Settings for this recording; a replay uses them by default.\n'
    text += yaml.safe_dump(content, sort_keys=False)
    write_text(bag / SETTINGS_FILE, text)
