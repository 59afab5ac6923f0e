"""Which files make up a recording, and what its metadata.yaml says about them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from explore_slam.errors import RecordingError
from explore_slam.files import read_yaml
from explore_slam.recording.storage.file_kinds import (
    COMPRESSED_SUFFIXES,
    SUFFIXES,
    check_not_lfs_pointer,
)

METADATA = 'metadata.yaml'
_ACTIVE = '.active'  # a bag of ROS 1 that was not closed
_NUMBERED = re.compile(r'.*_(\d+)')


@dataclass(frozen=True)
class BagFiles:
    """The files of a recording.

    counts: messages by topic that metadata.yaml states, None without it.
    missing: files that it names and that are not there.
    """

    files: tuple[Path, ...]
    counts: Mapping[str, int] | None = None
    missing: tuple[str, ...] = ()
    notes: list[str] = field(default_factory=list)


def bag_files(path: Path) -> BagFiles:
    """Return the files of a recording: of a folder, of the only one in it, or one file."""
    if not path.exists():
        raise RecordingError(f'{path} does not exist, expected a bag (a rosbag2 folder)')
    if path.name == METADATA and path.is_file():
        path = path.parent
    if path.is_file():
        return BagFiles((path,))
    files = _storage_files(path)
    metadata, notes = _metadata(path)
    if not files:
        return _only_inside(path, metadata)
    if metadata is None:
        _check_one_series(path, files)
        return BagFiles(files, None, (), notes)
    named = [Path(name).name for name in metadata.files]
    missing = [name for name in named if not any(_is_form_of(file.name, name) for file in files)]
    if len(missing) == len(named):  # the files were renamed
        _check_one_series(path, files)
        missing = []
    else:
        others = [f.name for f in files if not any(_is_form_of(f.name, n) for n in named)]
        if others:
            notes.append(f'{path}: {METADATA} does not name {", ".join(others)}: read as well')
    return BagFiles(files, metadata.counts, tuple(missing), notes)


def _storage_files(folder: Path) -> tuple[Path, ...]:
    """Return the files of recordings; of a file and its compressed form only the former."""
    found: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        plain = _plain_name(file.name)
        if file.is_file() and Path(plain).suffix in SUFFIXES and not file.name.startswith('.'):
            known = found.setdefault(plain, file)
            if file.name == plain:
                found[plain] = file
            elif known.name != plain:
                found[plain] = min(known, file)
    return tuple(sorted(found.values(), key=_by_number))


def _plain_name(name: str) -> str:
    """Return the name of a file before it was compressed or closed."""
    for suffix in (*COMPRESSED_SUFFIXES, _ACTIVE):
        name = name.removesuffix(suffix)
    return name


def _is_form_of(name: str, other: str) -> bool:
    return _plain_name(name) == _plain_name(other)


def _by_number(file: Path) -> tuple[int, str]:
    match = _NUMBERED.fullmatch(Path(_plain_name(file.name)).stem)
    return (int(match[1]) if match else -1), file.name


def _check_one_series(folder: Path, files: tuple[Path, ...]) -> None:
    """Raise RecordingError unless the files are the numbered parts of one recording."""
    numbers = [_by_number(file)[0] for file in files]
    forms = {re.sub(r'\d+', '0', _plain_name(file.name)) for file in files}
    if len(files) == 1 or (
        len(forms) == 1 and -1 not in numbers and len(set(numbers)) == len(files)
    ):
        return
    raise RecordingError(
        f'{folder} holds {len(files)} recordings and no {METADATA}: name one of '
        f'{", ".join(file.name for file in files)}'
    )


@dataclass(frozen=True)
class _Metadata:
    files: tuple[str, ...]
    counts: Mapping[str, int]


def _metadata(folder: Path) -> tuple[_Metadata | None, list[str]]:
    """Return what metadata.yaml says, or None and why not."""
    path = folder / METADATA
    try:
        if not path.exists():
            raise RecordingError(f'{folder}: {METADATA} is missing (the recording was not closed)')
        check_not_lfs_pointer(path)
        return _parsed(path, read_yaml(path, RecordingError)), []
    except RecordingError as error:
        return None, [f'{error}; reading its files without it']


def _parsed(path: Path, content: Any) -> _Metadata:
    try:
        info = content['rosbag2_bagfile_information']
        counts: dict[str, int] = {}
        for topic in info['topics_with_message_count'] or ():
            name = str(topic['topic_metadata']['name'])
            counts[name] = counts.get(name, 0) + int(topic['message_count'])
        return _Metadata(tuple(map(str, info['relative_file_paths'] or ())), counts)
    except (KeyError, TypeError, ValueError) as error:
        what = 'is empty' if content is None else 'is not that of a rosbag2 folder'
        raise RecordingError(f'{path} {what}') from error


def _only_inside(folder: Path, metadata: _Metadata | None) -> BagFiles:
    """Return the files of the only bag in a folder of bags."""
    if metadata is not None and metadata.files:
        names = ', '.join(metadata.files)
        raise RecordingError(f'{folder} is not a bag: {names}, named in {METADATA}, is missing')
    inside = sorted(
        inner for inner in folder.iterdir() if inner.is_dir() and _storage_files(inner)
    )
    if len(inside) == 1:
        found = bag_files(inside[0])
        found.notes.insert(0, f'{folder} holds one bag, {inside[0].name}: it is read')
        return found
    if inside:
        names = ', '.join(inner.name for inner in inside)
        raise RecordingError(f'{folder} holds {len(inside)} bags: name one of {names}')
    raise RecordingError(
        f'{folder} is not a bag: it holds no file {", ".join("*" + s for s in SUFFIXES)}'
    )
