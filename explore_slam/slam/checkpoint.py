"""The file format of saved states: named arrays in one .npz file, written atomically.

Each class that has a state returns it as named arrays, `state_dict`, and restores itself from
them; continuing from a saved state gives the same poses and map, bit by bit, as never having
stopped. This module only combines such states and keeps them in files.
"""

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.files import write_bytes

FORMAT = 5  # 5: weights of the points of clouds
State = dict[str, Any]


def text_array(value: object) -> Any:
    """Return a JSON value as an array of bytes, so that no file contains pickled objects."""
    return np.frombuffer(json.dumps(value).encode(), np.uint8)


def text_value(array: Any) -> Any:
    """Return the JSON value of such an array."""
    return json.loads(np.asarray(array, np.uint8).tobytes().decode())


def under(prefix: str, state: Mapping[str, Any]) -> State:
    """Return a state with 'prefix/' before each name."""
    return {f'{prefix}/{name}': value for name, value in state.items()}


def part(prefix: str, state: Mapping[str, Any]) -> State:
    """Return the state whose names begin with 'prefix/', without that prefix."""
    begin = f'{prefix}/'
    return {name[len(begin) :]: v for name, v in state.items() if name.startswith(begin)}


def write(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state to a file atomically; SlamError if that fails."""
    buffer = io.BytesIO()
    np.savez(buffer, format=np.array(FORMAT), **state)
    try:
        write_bytes(path, buffer.getbuffer())
    except OSError as error:
        raise SlamError(f'{path}: the state cannot be written: {error}') from error


def read(path: Path) -> State:
    """Read a file made by `write`; SlamError if it is damaged or of another format."""
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise SlamError(f'{path}: no saved state can be read: {error}') from error
    found = state.pop('format', None)
    if found is None or int(found) != FORMAT:
        raise SlamError(f'{path}: format of the saved state is {found}, expected {FORMAT}')
    return state


class Checkpointed:
    """Base of classes whose whole state can be saved to a file and loaded again."""

    def state_dict(self) -> State:
        """Return the whole state as named arrays; see `from_state`."""
        raise NotImplementedError

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Return an object that continues, bit by bit, where `state_dict` was called."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write the state to a file, atomically; SlamError if it cannot be written."""
        write(Path(path), self.state_dict())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the state from a file; SlamError if the file does not contain one."""
        return cls.from_state(read(Path(path)))
