"""Start poses as the user writes them: `robot1=2.5,-1,90deg`."""

import math
import re
from collections.abc import Iterable

from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2

_EXPECTED = 'expected VEHICLE=X,Y,THETA (m, m, rad, or degrees as in 90deg)'
_DEGREES = re.compile(r'(.+?)\s*(deg|degrees|°)')
_RADIANS = re.compile(r'(.+?)\s*rad')


def start_pose(text: str, *, unknown: bool = False) -> tuple[str, Pose2 | None]:
    """Return the vehicle and its start pose in the map.

    unknown: whether `VEHICLE=unknown` is possible, which gives None. ConfigError for anything
    else, and for an angle without a unit beyond a full turn: it is one in degrees.
    """
    expected = _EXPECTED + (' or VEHICLE=unknown' if unknown else '')
    name, _, values = text.partition('=')
    if unknown and name and values == 'unknown':
        return name, None
    words = [word.strip() for word in values.split(',')]
    try:
        x, y = (float(word) for word in words[:-1])
        theta = _angle(words[-1], text)
    except ValueError:
        raise ConfigError(f'--start is {text!r}, {expected}') from None
    pose = Pose2(x, y, theta)
    if not name or not pose.is_finite():
        raise ConfigError(f'--start is {text!r}, {expected}')
    return name, pose


def start_poses(texts: Iterable[str], *, unknown: bool = False) -> dict[str, Pose2 | None]:
    """Return vehicle -> start pose; ConfigError if one is given twice."""
    found: dict[str, Pose2 | None] = {}
    for text in texts:
        name, pose = start_pose(text, unknown=unknown)
        if name in found:
            raise ConfigError(f'--start is given twice for {name}')
        found[name] = pose
    return found


def _angle(word: str, text: str) -> float:
    if match := _DEGREES.fullmatch(word):
        return math.radians(float(match[1]))
    if match := _RADIANS.fullmatch(word):
        return float(match[1])
    value = float(word)
    if math.isfinite(value) and abs(value) > math.tau:
        raise ConfigError(
            f'--start is {text!r}: the angle is {value:g} rad, more than a full turn; '
            f'write {value:g}deg for degrees, {value:g}rad for radians'
        )
    return value
