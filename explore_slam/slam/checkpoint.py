"""The whole state of a belief as named arrays, and files of it that are written atomically.

Continuing from a saved state gives the same poses and map, bit by bit, as never having stopped.
"""

import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.slam.descriptors.index import DescriptorTable, KdTreeIndex
from explore_slam.slam.descriptors.kd_forest import KdForestIndex
from explore_slam.slam.landmarks.landmark_map import LandmarkMap
from explore_slam.slam.storage.ancestry import Genealogy, Layout, Level
from explore_slam.slam.storage.row_store import RowStore

FORMAT = 2  # 2: groups of vehicles
State = dict[str, Any]


def text_array(value: object) -> Any:
    """Return a JSON value as an array of bytes, so that no file holds pickled objects."""
    return np.frombuffer(json.dumps(value).encode(), np.uint8)


def text_value(array: Any) -> Any:
    """Return the JSON value of such an array."""
    return json.loads(np.asarray(array, np.uint8).tobytes().decode())


def under(prefix: str, state: Mapping[str, Any]) -> State:
    """Return the state with prefix/ before each name."""
    return {f'{prefix}/{name}': value for name, value in state.items()}


def part(prefix: str, state: Mapping[str, Any]) -> State:
    """Return what lies under prefix/."""
    begin = f'{prefix}/'
    return {name[len(begin) :]: v for name, v in state.items() if name.startswith(begin)}


def genealogy_state(genealogy: Genealogy, stores: list[RowStore]) -> State:
    """Return levels, and the layouts of the stores that hang on them."""
    levels = genealogy.levels
    index = np.array([level.index for level in levels], np.int32)
    table, slots = [], []
    for g, level in enumerate(levels):
        for layout in level.layouts:
            length = -1 if layout.slots is None else len(layout.slots)
            owner = next(i for i, store in enumerate(stores) if store is layout.owner)
            table.append([g, owner, layout.number, layout.size_class, layout.live, length])
            if layout.slots is not None:
                slots.append(layout.slots)
    return {
        'counts': np.array([level.count for level in levels], np.int64),
        'index': index.reshape(-1, genealogy.particles),
        'layouts': np.array(table, np.int64).reshape(-1, 6),
        'slots': np.concatenate([np.empty(0, np.int32), *slots]),
    }


def restore_genealogy(genealogy: Genealogy, stores: list[RowStore], state: State) -> None:
    """Put levels and layouts back; the stores are restored before."""
    genealogy.levels = [
        Level(int(count), index.astype(np.int32))
        for count, index in zip(state['counts'], state['index'], strict=True)
    ]
    at = 0
    for g, owner, number, size_class, live, length in state['layouts'].tolist():
        store = stores[owner]
        layout = Layout(genealogy, genealogy.levels[g], store, number)
        layout.size_class, layout.live = size_class, live
        if length >= 0:
            layout.slots = state['slots'][at : at + length].astype(np.int32)
            at += length
        layout.items = [np.flatnonzero(store.layout_of == number)]
        genealogy.levels[g].layouts.append(layout)
        store.layouts[number] = layout


def store_state(store: RowStore) -> State:
    """Return the rows of a store."""
    state: State = {
        'layout_of': store.layout_of,
        'slot_of': store.slot_of,
        'next_number': np.array(store.next_number),
    }
    for number, slab in enumerate(store.slabs):
        state[f'data{number}'] = slab.data[: slab.used]
        state[f'free{number}'] = np.array(slab.free, np.int64)
    return state


def restore_store(store: RowStore, state: State) -> None:
    """Put the rows of a store back."""
    store.layout_of, store.slot_of = state['layout_of'].copy(), state['slot_of'].copy()
    store.next_number = int(state['next_number'])
    store.layouts = {}
    for number, slab in enumerate(store.slabs):
        slab.data = state[f'data{number}'].copy()
        slab.used = len(slab.data)
        slab.free = state[f'free{number}'].tolist()


_FOREST = ('nodes', 'values', 'buckets', 'used', 'state')
_MAP = ('ids', 'counts', 'owners', 'evidence', 'reference')


def map_state(landmarks: LandmarkMap) -> State:
    """Return the landmark map, its descriptor index included."""
    index: object = landmarks.index
    assert isinstance(index, DescriptorTable)
    state: State = {name: getattr(landmarks, name) for name in _MAP}
    state['free'] = np.array(landmarks.free, np.int64)
    state['size'] = np.array([landmarks.size, landmarks.next_id], np.int64)
    state['table'], state['alive'] = index.table, index.alive
    if isinstance(index, KdForestIndex):
        state |= {f'forest_{name}': getattr(index, name) for name in _FOREST}
    if isinstance(index, KdTreeIndex):
        state['bulk'], state['tail'] = index.bulk, np.array(list(index.tail), np.int64)
    return state | under('rows', store_state(landmarks.rows))


def restore_map(landmarks: LandmarkMap, state: State) -> None:
    """Put the landmark map back."""
    for name in _MAP:
        setattr(landmarks, name, state[name].copy())
    landmarks.free = state['free'].tolist()
    landmarks.size, landmarks.next_id = state['size'].tolist()
    index: object = landmarks.index
    assert isinstance(index, DescriptorTable)
    index.table, index.alive = state['table'].copy(), state['alive'].copy()
    if isinstance(index, KdForestIndex):
        for name in _FOREST:
            setattr(index, name, state[f'forest_{name}'].copy())
        index.round_table(np.arange(len(index.table)))
    if isinstance(index, KdTreeIndex):
        index.restore(state['bulk'], state['tail'])
    restore_store(landmarks.rows, part('rows', state))


def write(path: Path, state: Mapping[str, Any]) -> None:
    """Write a state to a file: the file is whole, old or new, at any time."""
    buffer = io.BytesIO()
    np.savez(buffer, format=np.array(FORMAT), **state)
    temporary = path.with_name(path.name + '.part')
    try:
        with temporary.open('wb') as file:
            file.write(buffer.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise SlamError(f'{path}: the belief cannot be written: {error}') from error


def read(path: Path) -> State:
    """Read a file written by `write`."""
    try:
        with np.load(path, allow_pickle=False) as file:
            state = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise SlamError(f'{path}: no belief can be read: {error}') from error
    found = state.pop('format', None)
    if found is None or int(found) != FORMAT:
        raise SlamError(f'{path}: format of the belief is {found}, expected {FORMAT}')
    return state


class Checkpointed:
    """What has a whole state as named arrays can be kept in a file."""

    def state_dict(self) -> State:
        """Return the whole state as named arrays; see `from_state`."""
        raise NotImplementedError

    @classmethod
    def from_state(cls, state: State) -> Self:
        """Make an object that goes on, bit by bit, where `state_dict` was called."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write the state to a file, atomically; SlamError where it cannot be written."""
        write(Path(path), self.state_dict())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the state from a file; SlamError where the file holds none."""
        return cls.from_state(read(Path(path)))
