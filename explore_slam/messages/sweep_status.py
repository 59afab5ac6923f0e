"""What the scans of lasers have shown of their sweeps, as a diagnostic_msgs/DiagnosticStatus.

The agent finds it out; path follower and driver need it for their obstacle stop. One value per
laser: key, the name of its topic below the vehicle's namespace; value, duration (s), direction and
stamp in the words of the settings, e.g. '0.1813 backward last'; '0 forward first': one moment.
"""

import math
from collections.abc import Mapping
from typing import Any

from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory
from explore_slam.messages.topics import TopicKind
from explore_slam.sweeps import LONGEST_SWEEP, Sweep

_OK = b'\x00'
_DIRECTIONS, _STAMPS = ('forward', 'backward'), ('first', 'last')
_ONLY = str(TopicKind.SCAN.value)  # name of the only laser of a vehicle
SWEEP_KEY = 'sweep '  # of sweeps in diagnostics, before the name of the laser


def named_sweeps(found: Mapping[str, Sweep]) -> dict[str, str]:
    """Return laser -> sweep in the words of the settings; the only laser is 'scan'."""
    return {laser or _ONLY: sweep_words(sweep) for laser, sweep in sorted(found.items())}


def sweep_words(sweep: Sweep) -> str:
    """Return a sweep in the words of the settings."""
    direction, stamp = _DIRECTIONS[sweep.backward], _STAMPS[sweep.last]
    return f'{sweep.duration:.6g} {direction} {stamp}'


def sweeps_message(factory: MessageFactory, vehicle: str, found: Mapping[str, Sweep]) -> Any:
    """Return a DiagnosticStatus of sweeps by laser ('' is the only one)."""
    return factory.make(
        'diagnostic_msgs/DiagnosticStatus',
        level=_OK,
        name=f'{vehicle}: sweeps of the lasers',
        message='found from the scans',
        hardware_id=vehicle,
        values=[
            factory.make('diagnostic_msgs/KeyValue', key=laser, value=words)
            for laser, words in named_sweeps(found).items()
        ],
    )


def sweeps_record(message: Any) -> dict[str, Sweep]:
    """Return the sweeps in a DiagnosticStatus by laser; DataError for what is none."""
    found = {}
    for pair in message.values:
        words = str(pair.value).split()
        try:
            duration, direction, stamp = float(words[0]), words[1], words[2]
        except (ValueError, IndexError):
            duration, direction, stamp = math.nan, '', ''
        fits = len(words) == 3 and 0.0 <= duration <= LONGEST_SWEEP
        if not fits or direction not in _DIRECTIONS or stamp not in _STAMPS:
            raise DataError(
                f'sweep of {pair.key} is {pair.value!r}, expected seconds up to '
                f'{LONGEST_SWEEP:g}, one of {list(_DIRECTIONS)} and one of {list(_STAMPS)}'
            )
        sweep = Sweep(duration, direction == 'backward', stamp == 'last')
        found['' if pair.key == _ONLY and len(message.values) == 1 else pair.key] = sweep
    return found
