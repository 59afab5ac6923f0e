"""Atomic writing, where a reader finds the old content or the new one, never a part; YAML files.

What is written lies in a scratch folder beside its destination, under its final name, until it is
complete; a rename then puts it in place. A process that is killed leaves at most a scratch folder
behind, `.NAME.*.part`.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from explore_slam.errors import ExploreSlamError


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a path for a file, folder or symbolic link; put it in place if the block succeeds.

    The yielded path has the name of the destination, so that writers which read a format off the
    suffix, or name files after their folder, see what they expect. A file or link replaces an
    existing one; a folder must be new (OSError otherwise). When the block raises, the destination
    stays as it was.
    """
    scratch = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', suffix='.part', dir=path.parent))
    try:
        partial = scratch / path.name
        yield partial
        if partial.is_symlink():
            partial.replace(path)
        elif partial.is_dir():
            partial.rename(path)
        else:
            _flush_to_disk(partial)
            partial.replace(path)
    except OSError as error:
        if error.errno is None or _names_another(error, scratch):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


#: What to say of a file that is none but stands for one in Git LFS.
LFS_POINTER = 'a Git LFS pointer in place of the data; run `git lfs pull` in its repository'


def _names_another(error: OSError, scratch: Path) -> bool:
    """Return whether an error names a file, and not one in the scratch folder."""
    return error.filename is not None and not Path(str(error.filename)).is_relative_to(scratch)


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a whole file atomically; OSError where that fails."""
    with atomic(path) as partial:
        partial.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 text file atomically; OSError where that fails."""
    with atomic(path) as partial:
        partial.write_text(text, encoding='utf-8')


def replace_link(link: Path, target: str | Path) -> None:
    """Redirect a symbolic link to a target, atomically; OSError if a folder is in its place."""
    with atomic(link) as partial:
        partial.symlink_to(target)


def is_lfs_pointer(head: bytes) -> bool:
    """Return whether a file with these first bytes stands for one that Git LFS has not fetched."""
    return head.startswith(b'version https://git-lfs.github.com/spec/')


def read_yaml(path: Path, error: type[ExploreSlamError]) -> Any:
    """Return the content of a YAML file; `error` if it cannot be read or is not YAML."""
    try:
        text = path.read_text(encoding='utf-8')
        if is_lfs_pointer(text[:64].encode()):
            raise error(f'{path} is {LFS_POINTER}')
        return yaml.safe_load(text)
    except FileNotFoundError as cause:
        raise error(f'{path}: no such file') from cause
    except (OSError, UnicodeDecodeError) as cause:
        raise error(f'{path} cannot be read: {cause}') from cause
    except yaml.YAMLError as cause:
        raise error(f'{path} is not YAML: {" ".join(str(cause).split())}') from cause


def read_mapping(path: Path, error: type[ExploreSlamError], expected: str) -> dict[str, Any]:
    """Return the mapping in a YAML file; `error` if there is none, naming what is expected."""
    content = read_yaml(path, error)
    if not isinstance(content, dict):
        raise error(f'{path} holds {type(content).__name__}, expected {expected}')
    return content


def _flush_to_disk(path: Path) -> None:
    """Wait until the content of a file is on the disk, so that a power cut cannot empty it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
