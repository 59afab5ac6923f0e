"""Whether a gyroscope measures the turns of its vehicle: units, axes and sign.

Its rates about all three axes are compared with the turns that the wheels, or matched scans, show.
"""

import math
from typing import NamedTuple

import numpy as np

from explore_slam.agent.odometry import JUMP_TURN_RATE
from explore_slam.geometry import Array

# The wheels of poor odometry turn 0.4 to 2.5 times as far as in truth: outside of that, units or
# axes are wrong. `benchmark sensors` tries 0.7 and 1.4.
_LEAST_RATIO, _MOST_RATIO = 0.4, 2.5
_DEGREES = 180.0 / math.pi
_OTHER_WAY, _ABOUT_OTHER_AXIS = -0.2, 0.4  # ratios
_ACCEPTED_TURN = 0.15  # rad; with a tenth of it wrong by noise, the ratio is clear
_REFUSED_TURN = 0.6  # rad; wheels may slip for a part of it
_LEAST_TURN_RATE = 0.05  # rad/s; slower turns are not told from an unknown bias


class _Sums(NamedTuple):
    """Sums over motions by one reference.

    squares: of its turn rates; products: with the gyroscope's about x, y, z (3,), both rad²/s.
    turn: of its absolute turns (rad).
    """

    squares: float
    products: Array
    turn: float


class GyroCheck:
    """Compares the turns of a gyroscope with those of a reference until it is judged.

    accepted: it measures the turns. problem: why it does not, '' if nothing is wrong so far.
    """

    def __init__(self) -> None:
        self.accepted = False
        self.problem = ''
        self.ratio = math.nan
        self._sums: dict[str, _Sums] = {}

    @property
    def is_done(self) -> bool:
        """Whether it is judged."""
        return self.accepted or bool(self.problem)

    def check_rate(self, rates: tuple[float, float, float]) -> None:
        """Refuse a gyroscope whose rates no base can reach."""
        fastest = max(rates, key=abs)
        if abs(fastest) > JUMP_TURN_RATE and not self.problem:
            axis = 'xyz'[rates.index(fastest)]
            self._refuse(
                f'angular_velocity.{axis} is {fastest:.3g} rad/s, expected at most '
                f'{JUMP_TURN_RATE:g}: is it in degrees per second?'
            )

    def compare(self, reference: str, turn: float, turns: Array, duration: float) -> None:
        """Compare turns (3,) about x, y and z (rad) with that of a reference in a time (s)."""
        if self.is_done or abs(turn) < _LEAST_TURN_RATE * duration:
            return
        before = self._sums.get(reference, _Sums(0.0, np.zeros(3), 0.0))
        # weighted by the rate, so that the length of the motions does not matter
        sums = _Sums(
            before.squares + turn * turn / duration,
            before.products + turn * turns / duration,
            before.turn + abs(turn),
        )
        self._sums[reference] = sums
        ratios = sums.products / sums.squares
        self.ratio = ratio = float(ratios[2])
        if _LEAST_RATIO <= ratio <= _MOST_RATIO:
            self.accepted = sums.turn >= _ACCEPTED_TURN
        elif sums.turn >= _REFUSED_TURN:
            self._judge(reference, ratios)

    def _judge(self, reference: str, ratios: Array) -> None:
        x, y, z = ratios.tolist()
        if abs(z) > 0.5 * _DEGREES * _LEAST_RATIO:
            text = f'is {z:.1f} times the turn rate of the {reference}: is it in degrees per '
            self._refuse(f'angular_velocity.z {text}second? Expected rad/s')
        elif z < _OTHER_WAY:
            self._refuse(
                f'angular_velocity.z is {z:.2f} times the turn rate of the {reference}: it turns '
                'the other way; is the IMU upside down? Publish its mount on /tf_static, or set '
                'imu_mount'
            )
        elif max(abs(x), abs(y)) > _ABOUT_OTHER_AXIS > abs(z):
            axis, value = ('x', x) if abs(x) > abs(y) else ('y', y)
            self._refuse(
                f'it turns about its {axis} axis ({value:.2f} times the turn rate of the '
                f'{reference}), not about z ({z:.2f} times): publish its mount on /tf_static, or '
                'set imu_mount'
            )
        else:
            self._refuse(
                f'angular_velocity.z is {z:.2f} times the turn rate of the {reference}, expected '
                f'{_LEAST_RATIO:g} to {_MOST_RATIO:g}'
            )

    def _refuse(self, problem: str) -> None:
        self.accepted, self.problem = False, problem
