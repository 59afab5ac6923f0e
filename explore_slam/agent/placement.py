"""What is known about where vehicles stand after restarts of the agent, a driver or a state.

Odometry counts from where a base was started. A vehicle whose odometry begins elsewhere than at
zero has driven since then, so that its start pose is in doubt; one whose odometry begins anew has
moved by an unknown amount in between. Neither may drive before its pose is confirmed.
"""

import logging
import math

import numpy as np

from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2, wrap_angle
from explore_slam.slam import UpdateSummary

logger = logging.getLogger(__name__)

# Beyond these a vehicle is not at the expected pose: more than odometry drifts on a drive home.
# Chosen by hand, as are the values below; test_placement shows what they decide.
_DISPLACED_DISTANCE = 0.5  # m
_DISPLACED_TURN = 0.35  # rad, 20 degrees
# (3, 3) m², rad²: a driver restarts in seconds, in which a person pushes or turns a vehicle
DISPLACED = np.diag([1.0, 1.0, 1.0])
# number and fraction of the landmarks of one frame whose association confirms a pose
_CONFIRMING, _CONFIRMING_FRACTION = 10, 0.5


def away(pose: Pose2, expected: Pose2) -> bool:
    """Return whether a vehicle is too far from the expected pose to be there."""
    turn = abs(wrap_angle(pose.theta - expected.theta))
    return math.dist(pose[:2], expected[:2]) > _DISPLACED_DISTANCE or turn > _DISPLACED_TURN


def doubt(track: VehicleTrack, reason: str) -> None:
    """Note that the pose of a vehicle must be confirmed before it drives."""
    track.doubt = reason
    logger.warning(
        '%s: %s; exploration stays paused until it is resumed (explore/resume) or the vehicle is '
        'placed (initialpose)',
        track.name,
        reason,
    )


def check_first_reading(track: VehicleTrack, odometry: Pose2) -> None:
    """Compare the first odometry reading with zero, where the base is after its start.

    A vehicle of unknown start is not checked: its pose is to be found anyway.
    """
    if track.start is None:
        return
    if away(odometry, Pose2(0.0, 0.0, 0.0)) and not track.doubt and not track.placed:
        x, y, theta = odometry
        doubt(
            track,
            f'odometry begins at ({x:.2f} m, {y:.2f} m, {theta:.2f} rad): the vehicle has driven '
            'since its base was started and may not be at its start pose',
        )


def check_loaded_pose(track: VehicleTrack, before: Pose2 | None, loaded: Pose2) -> None:
    """Compare the pose in a loaded state with the estimate until then; None: there is none."""
    if before is None:
        doubt(track, 'its motion since the state was saved is unknown')
    elif away(before, loaded):
        distance = math.dist(before[:2], loaded[:2])
        doubt(track, f'its pose differs from the loaded state by {distance:.2f} m')
    track.placed = True  # odometry need not begin at zero there


def displace(track: VehicleTrack) -> None:
    """Note that a vehicle may be anywhere: its odometry began anew after a gap."""
    track.displaced, track.updated_since_displaced = True, False
    logger.warning(
        '%s: it stays stopped until it is relocalized by landmarks or placed (initialpose)',
        track.name,
    )


def is_usable(track: VehicleTrack, record: object) -> bool:
    """Return whether a measurement may be used: scans of a displaced vehicle spoil the map."""
    if track.displaced and isinstance(record, LaserScan):
        track.count('scans_while_displaced')
        return False
    return True


def check_update(track: VehicleTrack, summary: UpdateSummary) -> None:
    """End the displacement of a vehicle whose landmarks show where it is.

    The first update may confirm that it has not moved; later ones associate with landmarks that
    were inserted at the doubtful pose, so that only a relocalization counts.
    """
    first, track.updated_since_displaced = not track.updated_since_displaced, True
    confirmed = (
        first
        and not summary.lost
        and summary.associated >= _CONFIRMING
        and summary.associated >= _CONFIRMING_FRACTION * summary.observed
    )
    if track.displaced and (summary.relocated or summary.joined or confirmed):
        track.displaced = False
        logger.info('%s: relocalized by its landmarks; it may drive again', track.name)


def place(track: VehicleTrack) -> None:
    """Note that a person has placed a vehicle."""
    track.doubt, track.displaced, track.placed = '', False, True
