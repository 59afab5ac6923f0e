"""Whether the pose of a vehicle is reliable after a restart of the agent, a driver or a state.

Odometry counts from where a base was started. A vehicle whose odometry does not begin at zero has
driven since then, so that its start pose is in doubt; one whose odometry begins anew has moved by
an unknown amount in between. Neither may drive before its pose is confirmed.
"""

import logging
import math
from dataclasses import dataclass

import numpy as np

from explore_slam.geometry import IDENTITY, Pose2, wrap_angle
from explore_slam.slam import UpdateSummary

logger = logging.getLogger(__name__)

# A vehicle that is farther from the expected pose than this has been moved: more than odometry
# drifts on a drive home. Chosen by hand, as are the values below; test_placement shows what they
# decide.
_DISPLACED_DISTANCE = 0.5  # m
_DISPLACED_TURN = 0.35  # rad, 20 degrees
# (3, 3) m², rad²: a driver restarts in seconds, in which a person pushes or turns a vehicle
DISPLACED = np.diag([1.0, 1.0, 1.0])
# number and fraction of the landmarks of one frame whose association confirms a pose
_CONFIRMING, _CONFIRMING_FRACTION = 10, 0.5


@dataclass
class Placement:
    """What is known about where one vehicle stands.

    start_known: whether it has a start pose in the map.
    doubt: why its pose must be confirmed before it drives; '' if it is not in doubt.
    displaced: its odometry began anew after a gap, so that it may stand anywhere.
    given: its pose was given by a person or a saved state, not by its start.
    updated: whether landmarks have updated its pose since it was displaced.
    """

    vehicle: str
    start_known: bool
    doubt: str = ''
    displaced: bool = False
    given: bool = False
    updated: bool = False

    @property
    def is_reliable(self) -> bool:
        """Whether the vehicle may drive."""
        return not self.displaced and not self.doubt

    def check_first_reading(self, odometry: Pose2) -> None:
        """Compare the first odometry reading with zero, where the base is after its start.

        A vehicle of unknown start is not checked: its pose is to be found anyway.
        """
        if not self.start_known or self.given or self.doubt:
            return
        if _are_apart(odometry, IDENTITY):
            x, y, theta = odometry
            self._raise_doubt(
                f'odometry begins at ({x:.2f} m, {y:.2f} m, {theta:.2f} rad): the vehicle has '
                'driven since its base was started and may not be at its start pose'
            )

    def check_loaded_pose(self, before: Pose2 | None, loaded: Pose2) -> None:
        """Compare the pose in a loaded state with the last estimate; None: there was none."""
        if before is None:
            self._raise_doubt('its motion since the state was saved is unknown')
        elif _are_apart(before, loaded):
            distance = math.dist(before[:2], loaded[:2])
            self._raise_doubt(f'its pose differs from the loaded state by {distance:.2f} m')
        self.given = True  # odometry need not begin at zero there

    def _raise_doubt(self, reason: str) -> None:
        self.doubt = reason
        logger.warning(
            '%s: %s; exploration stays paused until it is resumed (explore/resume) or the vehicle '
            'is placed (initialpose)',
            self.vehicle,
            reason,
        )

    def confirm(self) -> None:
        """Record that the operator has confirmed the pose, by resuming the exploration."""
        self.doubt = ''

    def set_by_operator(self) -> None:
        """Record that the operator has given the pose."""
        self.doubt, self.displaced, self.given = '', False, True

    def displace(self) -> None:
        """Record that the vehicle may be anywhere: its odometry began anew after a gap."""
        self.displaced, self.updated = True, False
        logger.warning(
            '%s: it stays stopped until it is relocalized by landmarks or placed (initialpose)',
            self.vehicle,
        )

    def check_update(self, summary: UpdateSummary) -> None:
        """End the displacement of a vehicle whose landmarks show where it is.

        The first update may confirm that it has not moved; later ones associate with landmarks
        that were inserted at the doubtful pose, so that only a relocalization counts.
        """
        first, self.updated = not self.updated, True
        confirmed = (
            first
            and not summary.lost
            and summary.associated >= _CONFIRMING
            and summary.associated >= _CONFIRMING_FRACTION * summary.observed
        )
        if self.displaced and (summary.relocated or summary.joined or confirmed):
            self.displaced = False
            logger.info('%s: relocalized by its landmarks; it may drive again', self.vehicle)


def _are_apart(pose: Pose2, expected: Pose2) -> bool:
    """Return whether two poses differ by more than odometry drifts."""
    turn = abs(wrap_angle(pose.theta - expected.theta))
    return math.dist(pose[:2], expected[:2]) > _DISPLACED_DISTANCE or turn > _DISPLACED_TURN
