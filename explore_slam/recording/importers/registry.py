"""The registry of importers.

An importer is a function in a module of this package, declared with the decorator `importer`. It
is found by a scan of the package: adding one touches its own module and test, nothing else.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass

from explore_slam.errors import RecordingError
from explore_slam.settings import Section

PACKAGE = 'explore_slam.recording.importers'


type ImportFunction = Callable[..., dict[str, int]]


@dataclass(frozen=True)
class Importer:
    """A registered importer.

    function(folder, out, **options) writes the data set in a folder as a bag and returns the
    number of messages per topic. options declares the keyword arguments and their defaults.
    """

    name: str
    description: str
    function: ImportFunction
    options: Section


_registered: dict[str, Importer] = {}


def importer[F: ImportFunction](
    name: str, description: str, options: type[Section] = Section
) -> Callable[[F], F]:
    """Register a function under the name that the command line uses.

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
        _registered[name] = Importer(name, description, function, options())
        return function

    return register


def importers() -> dict[str, Importer]:
    """Return all importers by name, in alphabetical order."""
    for module in pkgutil.iter_modules(importlib.import_module(PACKAGE).__path__):
        importlib.import_module(f'{PACKAGE}.{module.name}')
    return dict(sorted(_registered.items()))
