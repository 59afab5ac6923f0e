"""Kinds of Pioneer robots by the subclass that they report: units of counts, size, laser, sonar.

Source of all numbers: the robot parameter files of ARIA (MobileRobots), `<subclass>.p`:
DistConvFactor, VelConvFactor, RangeConvFactor, DiffConvFactor, NumFrontBumpers, NumRearBumpers,
FrontBumpers, LaserX, LaserY, SonarUnit. AngleConvFactor is 0.00153 in all of them, rounded from
2π/4096. Firmware that converts counts itself (ARCOS: names with -sh) has a distance factor of 1.
"""

import logging
import math
import re
from typing import NamedTuple

from explore_slam.errors import VehicleError
from explore_slam.geometry import Pose2

_log = logging.getLogger(__name__)
_ANGLE = math.tau / 4096  # rad per count


class ScaleFactors(NamedTuple):
    """Units of the robot's counts.

    distance: mm. angle: rad. velocity: mm/s. range: mm.
    difference: turn rate (rad/s) per half the difference of the wheel speeds (mm/s).
    """

    distance: float
    angle: float
    velocity: float
    range: float
    difference: float

    @property
    def wheel_base(self) -> float:
        """Effective distance (m) between left and right wheels."""
        return 0.002 / self.difference


class RobotModel(NamedTuple):
    """A kind of robot.

    bumpers: segments of the front and of the rear ring, which is an accessory of most robots;
    further bits of a status packet are not those of bumpers.
    laser: x, y (m) of the laser in the vehicle frame as delivered; None: delivered without.
    sonar: poses of the transducers by index.
    """

    factors: ScaleFactors
    bumpers: tuple[int, int]
    laser: tuple[float, float] | None
    sonar: tuple[Pose2, ...]


def _poses(*transducers: tuple[int, int, int]) -> tuple[Pose2, ...]:
    """Return poses of transducers given as x, y (mm) and bearing (°)."""
    return tuple(Pose2(0.001 * x, 0.001 * y, math.radians(b)) for x, y, b in transducers)


def _ring(*half: tuple[int, int, int]) -> tuple[Pose2, ...]:
    """Return a ring: one half of it, and the mirror image of that in reversed order."""
    mirrored = [(x, -y, -bearing) for x, y, bearing in reversed(half)]
    return _poses(*half, *mirrored)


_FRONT_DX = _ring((69, 136, 90), (114, 119, 50), (148, 78, 30), (166, 27, 10))
_REAR_DX = _ring((-157, -136, -90), (-203, -119, -130), (-237, -78, -150), (-255, -27, -170))
_FRONT_AT = _ring((147, 136, 90), (193, 119, 50), (227, 79, 30), (245, 27, 10))
_REAR_AT = _ring((-144, -136, -90), (-189, -119, -130), (-223, -79, -150), (-241, -27, -170))
# second deck of the PeopleBots
_UPPER_FRONT = _ring((-20, 136, 90), (24, 119, 50), (58, 78, 30), (77, 27, 10))
_UPPER_REAR = _ring((-191, -136, -90), (-237, -119, -130), (-271, -78, -150), (-290, -27, -170))
_DX, _AT = _FRONT_DX + _REAR_DX, _FRONT_AT + _REAR_AT
_PEOPLE = _DX + _UPPER_FRONT + _UPPER_REAR
_PERFORMANCE = _FRONT_DX + _UPPER_FRONT + _REAR_DX + _UPPER_REAR
_OLD_PEOPLE = _FRONT_DX + _UPPER_FRONT + _REAR_DX
_AMIGO = _ring((76, 100, 90), (125, 75, 41), (150, 30, 15)) + _poses(
    (-140, -58, -145), (-140, 58, 145)
)
_AMIGO_SH = _poses(
    (70, 100, 90), (125, 75, 41), (144, 30, 15), (144, -30, -15), (120, -75, -41),
    (70, -100, -90), (-146, -58, -145), (-146, 58, 145),
)  # fmt: skip


def _model(
    distance: float,
    difference: float,
    laser: tuple[int, int] | None,
    sonar: tuple[Pose2, ...],
    *,
    range_factor: float = 1.0,
    velocity: float = 1.0,
    bumpers: tuple[int, int] = (5, 5),
) -> RobotModel:
    """Return a model; laser: x, y (mm)."""
    factors = ScaleFactors(distance, _ANGLE, velocity, range_factor, difference)
    mount = None if laser is None else (0.001 * laser[0], 0.001 * laser[1])
    return RobotModel(factors, bumpers, mount, sonar)


_P2_RANGE = 0.268  # mm per count of sonar of the first P2OS boards
MODELS = {
    'p3dx': _model(0.485, 0.0056, (18, 0), _DX),
    'p3dx-sh': _model(1.0, 0.0056, (21, 0), _DX),
    'p3dx-sh-lms1xx': _model(1.0, 0.0056, (55, 0), _DX),
    'p3dx-sh-lms500': _model(1.0, 0.0056, (21, 0), _DX),
    'p3at': _model(0.465, 0.0034, (160, 0), _AT),
    'p3at-sh': _model(1.0, 0.0034, (125, 0), _AT),
    'p3at-sh-lms1xx': _model(1.0, 0.0034, (197, 0), _AT),
    'p3at-sh-lms500': _model(1.0, 0.0034, (125, 0), _AT),
    'p3atiw-sh': _model(1.0, 0.0034, (125, 0), _AT),
    'p2dx': _model(0.84, 0.0056, (17, 8), _DX, range_factor=_P2_RANGE),
    'p2ce': _model(0.826, 0.0057, None, _DX, range_factor=_P2_RANGE),
    'p2de': _model(0.969, 0.0056, (17, 8), _DX, range_factor=_P2_RANGE),
    'p2df': _model(0.485, 0.006, (17, 8), _DX, range_factor=_P2_RANGE),
    'p2d8': _model(0.485, 0.0056, (18, 0), _DX),
    'p2d8+': _model(0.485, 0.0056, (18, 0), _DX),
    'p2at': _model(1.32, 0.0034, (160, 7), _AT, range_factor=_P2_RANGE),
    'p2it': _model(1.136, 0.0032, (160, 7), _AT, range_factor=_P2_RANGE),
    'p2at8': _model(1.32, 0.0034, (160, 7), _AT),
    'p2at8+': _model(0.465, 0.0034, (160, 7), _AT),
    'p2pb': _model(0.424, 0.0056, (17, 8), _OLD_PEOPLE, range_factor=_P2_RANGE),
    'p2pp': _model(0.485, 0.006, (16, 1), _OLD_PEOPLE, range_factor=_P2_RANGE),
    'perfpb': _model(0.485, 0.006, (21, 0), _PERFORMANCE),
    'perfpb+': _model(0.485, 0.006, (21, 0), _PERFORMANCE),
    'peoplebot-sh': _model(1.0, 0.006, (21, 0), _PEOPLE),
    'peoplebot-sh-lms1xx': _model(1.0, 0.006, (55, 0), _PEOPLE),
    'peoplebot-sh-lms500': _model(1.0, 0.006, (21, 0), _PEOPLE),
    'patrolbot-sh': _model(1.0, 0.0056, (37, 0), (), bumpers=(6, 6)),
    'researchpb': _model(1.0, 0.0056, (37, 0), (), bumpers=(6, 6)),
    'powerbot': _model(0.5813, 0.00373, (251, 0), (), bumpers=(7, 5)),
    'powerbot-sh': _model(1.0, 0.00373, (251, 0), (), bumpers=(7, 5)),
    'amigo': _model(0.5083, 0.011, None, _AMIGO, velocity=0.6154),
    'amigo-sh': _model(1.0, 0.011, None, _AMIGO_SH),
    'amigo-sh-tim3xx': _model(1.0, 0.011, (110, 0), _AMIGO_SH),
    'amigo-sh-tim5xx': _model(1.0, 0.011, (110, 0), _AMIGO_SH),
}
_DEFAULT = 'p3dx'  # whose other numbers an unknown robot gets
_ALL_BUMPERS = (7, 7)  # bits of a status packet, all of which may be segments of an unknown robot


def _plain(subclass: str) -> str:
    """Return a subclass without case, dashes and `bot`: AmigoBot-SH and amigo-sh are the same."""
    return re.sub(r'[^a-z0-9+]|bot', '', subclass.lower())


_BY_PLAIN_NAME = {_plain(name): name for name in MODELS}


def known_model(subclass: str) -> RobotModel | None:
    """Return the model of a subclass, however its name is written; None for an unknown one."""
    name = _BY_PLAIN_NAME.get(_plain(subclass))
    return None if name is None else MODELS[name]


def robot_model(subclass: str, distance: float = 0.0) -> RobotModel:
    """Return the model of a subclass, with a distance factor (mm per count) if it is > 0.

    An unknown subclass is a warning: it gets the numbers of the kind that its name begins with
    (p3at-sh-x: p3at-sh), of a p3dx otherwise; robots whose name has -sh report millimetres.
    Raises VehicleError for an unknown one whose distance factor neither its name nor the
    setting gives.
    """
    model = known_model(subclass)
    if model is None:
        model = _substitute(subclass, distance)
    if distance > 0.0:
        model = model._replace(factors=model.factors._replace(distance=distance))
    return model


def _substitute(subclass: str, distance: float) -> RobotModel:
    """Return the model for an unknown subclass, with a warning that says what was assumed."""
    name, plain = subclass.strip().lower(), _plain(subclass)
    similar = [known for known in _BY_PLAIN_NAME if plain.startswith(known)]
    alike = _BY_PLAIN_NAME[max(similar, key=len)] if similar else _DEFAULT
    in_millimetres = '-sh' in name
    # p2at8x may be another board than p2at8, with other units; p2at8-x is a p2at8 with something
    if not in_millimetres and not name.startswith(f'{alike}-') and distance <= 0.0:
        raise VehicleError(
            f"the robot has the unknown subclass '{subclass}', expected one of "
            f'{", ".join(MODELS)}: set distance_factor to its DistConvFactor (mm per count)'
        )
    model = MODELS[alike]._replace(bumpers=_ALL_BUMPERS)
    if in_millimetres:
        model = model._replace(factors=model.factors._replace(distance=1.0))
    _log.warning(
        "the robot has the unknown subclass '%s': taken as %s with %.3f mm per count; drive it "
        'straight for some metres, and set distance_factor if odom says another distance',
        subclass, alike, distance if distance > 0.0 else model.factors.distance,
    )  # fmt: skip
    return model
