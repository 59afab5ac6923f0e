"""The registry of importers.

An importer is a function in a module of this package, declared with the decorator `importer`. It
is found by a scan of the package: adding one touches its own module and test, nothing else.
"""

import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from explore_slam.errors import RecordingError
from explore_slam.settings import Section, values_of

PACKAGE = 'explore_slam.recording.importers'


type ImportFunction = Callable[..., dict[str, int]]


@dataclass(frozen=True)
class Importer:
    """A registered importer.

    function(source, out, **options) writes a data set as a bag and returns the number of messages
    per topic.

    source: what a source is, for the help of the command line.
    several: the function takes a list of sources, otherwise one.
    options: declares the keyword arguments and their defaults.
    """

    name: str
    description: str
    function: ImportFunction
    source: str
    several: bool
    options: Section

    def run(self, sources: Sequence[Path], out: Path, options: Section) -> dict[str, int]:
        """Import sources with options; RecordingError if it takes one source and gets more."""
        if not self.several and len(sources) != 1:
            raise RecordingError(f'{self.name} takes one {self.source}, {len(sources)} were given')
        given = list(sources) if self.several else sources[0]
        return self.function(given, out, **values_of(options))


_registered: dict[str, Importer] = {}


def importer[F: ImportFunction](
    name: str,
    description: str,
    *,
    source: str = 'folder of the data set',
    several: bool = False,
    options: type[Section] = Section,
) -> Callable[[F], F]:
    """Register a function under the name that the command line uses; see Importer.

    options: a section with a setting for each keyword argument; the command-line options derive
    from it.
    """

    def register(function: F) -> F:
        known = _registered.get(name)
        if known is not None and known.function.__module__ != function.__module__:
            raise RecordingError(
                f'importer {name!r} of {function.__module__} is already registered by '
                f'{known.function.__module__}'
            )
        _registered[name] = Importer(name, description, function, source, several, options())
        return function

    return register


def importers() -> dict[str, Importer]:
    """Return all importers by name, in alphabetical order."""
    for module in pkgutil.iter_modules(importlib.import_module(PACKAGE).__path__):
        importlib.import_module(f'{PACKAGE}.{module.name}')
    return dict(sorted(_registered.items()))
