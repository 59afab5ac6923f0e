"""Laser odometry of one vehicle: each scan is registered with the last scans kept.

A correlation over the window that the uncertainty of the odometry asks for finds the basin; a
point-to-line alignment with the odometry as prior refines the pose (Olson 2009; Censi 2008).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from explore_slam.data import LaserScan
from explore_slam.errors import RegistrationError
from explore_slam.geometry import IDENTITY, Array, Pose2, moved_enough
from explore_slam.registration.alignment import (
    Alignment,
    Prior,
    keeping_prior,
    open_direction,
    without_direction,
)
from explore_slam.registration.cloud import PointCloud, scan_cloud
from explore_slam.registration.config import ScanMatchingConfig
from explore_slam.registration.correlation import SearchWindow
from explore_slam.registration.local_map import LocalMap

# Where no other source is given, values were chosen on the Intel, ACES and Belgioioso logs;
# `benchmarks/laser_graph_slam.py` shows what a change does.
_MINIMUM_DEVIATIONS = np.array([1e-4, 1e-4, 1e-4])  # m, m, rad, of any motion
_MINIMUM_POINTS = 15  # returns; five times the unknowns
# Variance of the step of the window's frame when a scan is kept, as a fraction of what is common
# to several scans in the variance of the scan's own error. Where a fraction f of the errors in a
# match is independent, that is 1 - f: along even walls (f near 1) the errors of one scan are not
# those of the next, and the scans kept average them; uneven walls mislead several scans alike.
# Chosen with `benchmarks/scan_matching_noise.py --window-drift`, a little on the safe side: over
# 100 scans the squared Mahalanobis distances (expected: 3) are 2.8 with 0.5 and 2.0 with 0.7 on
# Intel (f 0.3 in the mean; against the final path of a replay), 1.6 and 1.2 on ACES (f 0.5), 2.1
# and 1.9 in the simulated office (f 0.8; mean of ten runs, 3.0 and 2.7 in the worst). A fraction
# of 0.35 whatever f gave 3.1, 1.4 and 1.2.
WINDOW_DRIFT = 0.7
# rad; half a step moves a return at 6 m by 0.08 m, which the alignment corrects.
_ANGLE_STEP = math.radians(1.5)
_SIGMAS = 3.0  # the window covers the odometry's error
_MINIMUM_WINDOW = (0.1, 0.03)  # m, rad
_MAXIMUM_WINDOW = (0.6, 0.5)  # m, rad
_MINIMUM_SCORE = 0.1  # mean likelihood of the returns
_VAGUE = np.eye(3)  # information of 1 m and 1 rad, where a scan says nothing
_ROUNDING = 1e-9  # asymmetry of a product of matrices, to its largest entry, that is tolerated
# The score falls by this at two standard deviations of the odometry from the prediction.
_PENALTY = 0.025
_REACH = 0.4  # m, of the alignment at first
_LAST_REACH = 0.15  # m, of one that begins at an alignment
# Far from the odometry's pose, a match needs this overlap and must be unique: no pose that is off
# by _MODES_APART (m, rad) may score nearly as well.
_WIDE_OVERLAP = 0.6
_REDUCED_OVERLAP = 0.7  # of matching_overlap: enough near the odometry's pose if nothing else fits
_MODES_APART = (0.5, math.radians(10.0))
_OTHER_MODE = 0.92  # fraction of the best score at which another mode makes a match ambiguous
# Mahalanobis distance from the odometry above which a match is searched in the widest window too
_UNLIKELY = 5.0
_REFUSALS_UNTIL_RESTART = 3  # scans in succession


@dataclass(frozen=True)
class ScanMatch:
    """Where a scan was taken: vehicle pose in the odometry frame.

    The error of the pose has two parts, covariances (3, 3) in the vehicle frame at the pose.
    white: of this match alone, not shared with the matches before and after. drift: growth of
    the error since the last match, a random walk: what the scan left open of the odometry's
    error, and window. window: the part of drift that is the motion of the window's frame; zero
    if no scan was kept since the last match, but for the error of the first scan.
    information (3, 3): of the scan's geometry alone; overlap: fraction of the returns on known
    surfaces; rms (m) of their distances.
    """

    pose: Pose2
    white: Array
    drift: Array
    window: Array
    information: Array
    overlap: float
    rms: float

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of the pose given an exact map: white error and drift together."""
        return self.white + self.drift


class _FirstScan:
    """The scan that a map began with, whose own error is that of all poses in the map.

    It was placed, not matched. As poses come from matches with it rather than from odometry, they
    take over its error: of the vehicle's way from there, that is a part of the drift.
    """

    def __init__(self) -> None:
        self._covariance: Array | None = None  # of its error, as that of the first scan matched
        self._from_odometry = np.eye(3)  # what is left of the pose at the start
        self._entered = np.zeros((3, 3))  # covariance of what the pose has taken over

    def step(self, found: Alignment, odometry: Array) -> Array:
        """Return the growth (3, 3) of the error of poses with a match, zero after a few of them.

        odometry (3, 3): covariance of the motion since the last match.
        """
        information = found.information
        if self._covariance is None:
            self._covariance = np.linalg.inv(information + _VAGUE)
        certainty = np.linalg.inv(odometry)
        self._from_odometry = (
            np.linalg.inv(information + certainty) @ certainty @ self._from_odometry
        )
        share = np.eye(3) - self._from_odometry
        entered = share @ self._covariance @ share.T
        values, vectors = np.linalg.eigh(entered - self._entered)
        self._entered = entered
        growth: Array = (vectors * values.clip(0.0)) @ vectors.T
        return growth


class Refusal(Enum):
    """Why a scan has no match."""

    FIRST = 'there are no scans to match with yet'
    FEW_RETURNS = 'the scan has too few returns'
    LITTLE_OVERLAP = 'too few returns lie on known surfaces'
    AMBIGUOUS = 'the match is far from the odometry and not the only one'


@dataclass(frozen=True)
class RefusedScan:
    """A scan without a match, and the pose by the odometry."""

    reason: Refusal
    pose: Pose2


class ScanMatcher:
    """The last scans kept of one vehicle, in its odometry frame, and the search in them.

    open_ended: the priors are so weak that what noise seems to measure along a corridor would
    outweigh them: in such a direction the prior alone counts.
    """

    def __init__(self, config: ScanMatchingConfig, *, open_ended: bool = False) -> None:
        self.config = config
        self._open_ended = open_ended
        self._kept: deque[PointCloud] = deque(maxlen=config.matching_window)  # placed
        self._last_kept = IDENTITY
        self._window_moved = False  # since the last match
        self._first = _FirstScan()
        self._refused: tuple[PointCloud, Pose2] | None = None
        self._refusals = 0
        self._map: LocalMap | None = None
        self.restarts = 0  # how often the map began anew at a pose by the odometry

    @property
    def started(self) -> bool:
        """Whether there are scans to match with."""
        return bool(self._kept)

    def reset(self) -> None:
        """Forget all scans: the vehicle has been lifted, or time has jumped."""
        self._kept.clear()
        self._refused, self._refusals, self._map = None, 0, None

    def match(
        self,
        scan: LaserScan,
        laser: Pose2,
        prior: Pose2,
        covariance: Array,
        *,
        bodies: Sequence[tuple[float, float, float]] = (),
    ) -> ScanMatch | RefusedScan:
        """Return the pose of the vehicle at a scan, or why there is none.

        laser: its pose on the vehicle; prior: pose by the odometry, with covariance (3, 3) of
        the motion since the last match in the vehicle frame. bodies: discs (x, y, radius) in the
        vehicle frame that hide other vehicles.
        """
        cloud = scan_cloud(scan, laser, self.config.matching_range)
        return self.match_cloud(cloud.masked(bodies), prior, covariance)

    def match_cloud(
        self, cloud: PointCloud, prior: Pose2, covariance: Array
    ) -> ScanMatch | RefusedScan:
        """Return the pose of the vehicle at a cloud of its frame; see match."""
        _check_prior(prior, covariance)
        if len(cloud) < _MINIMUM_POINTS:
            return RefusedScan(Refusal.FEW_RETURNS, prior)
        if not self._kept:
            self._first = _FirstScan()
            self._keep(cloud, prior)
            return RefusedScan(Refusal.FIRST, prior)
        found = self._match(self._local_map(), cloud, prior, covariance, self._first)
        if isinstance(found, RefusedScan) and self._refused is not None:
            # The vehicle may have entered a place that only the refused scan has seen.
            alone = LocalMap.of([self._refused[0]], [self._refused[1]])
            first = _FirstScan()
            again = self._match(alone, cloud, prior, covariance, first)
            if isinstance(again, ScanMatch):
                self._restart(*self._refused)
                self._first, found = first, again
        if isinstance(found, RefusedScan):
            self._refuse(cloud, prior)
            return found
        self._refused, self._refusals, self._window_moved = None, 0, False
        if self._moved_on(found.pose):
            self._keep(cloud, found.pose)
        return found

    def align(self, cloud: PointCloud, prior: Pose2, covariance: Array) -> Alignment | None:
        """Align a cloud from a prior, without a search; nothing is kept. None where it fails."""
        if not self._kept or len(cloud) < _MINIMUM_POINTS:
            return None
        information = np.linalg.inv(covariance + np.diag(_MINIMUM_DEVIATIONS**2))
        local_map, weak = self._local_map(), Prior(prior, information)
        found = local_map.align(cloud, prior, _REACH, weak)
        return None if found is None else self._opened(local_map, cloud, found, weak)

    def probe(self, cloud: PointCloud, pose: Pose2) -> Alignment | None:
        """Return where a cloud fits best, in the widest window around a pose; nothing is kept.

        None where there is no place that overlaps enough, or more than one.
        """
        if not self._kept or len(cloud) < _MINIMUM_POINTS:
            return None
        local_map, window = self._local_map(), SearchWindow(pose, *_MAXIMUM_WINDOW)
        slipped = np.diag([*_MAXIMUM_WINDOW[:1] * 2, _MAXIMUM_WINDOW[1]]) ** 2
        found = self._register(local_map, cloud, pose, slipped, window)
        if found is None or found.overlap < _WIDE_OVERLAP:
            return None
        return None if _is_ambiguous(local_map, cloud, window, found.pose) else found

    def _refuse(self, cloud: PointCloud, prior: Pose2) -> None:
        """Hold a refused scan beside the map: its pose is the odometry's, not a match."""
        self._refused = (cloud, prior)
        self._refusals += 1
        if self._refusals >= _REFUSALS_UNTIL_RESTART:
            self._restart(cloud, prior)

    def _restart(self, cloud: PointCloud, pose: Pose2) -> None:
        """Begin the map anew with one scan: the scans before it are out of sight."""
        self.reset()
        self.restarts += 1
        self._first = _FirstScan()
        self._keep(cloud, pose)

    def _keep(self, cloud: PointCloud, pose: Pose2) -> None:
        self._kept.append(cloud.moved(pose))
        self._last_kept, self._map, self._window_moved = pose, None, True

    def _moved_on(self, pose: Pose2) -> bool:
        moved = self._last_kept.between(pose)
        config = self.config
        return moved_enough(moved, config.matching_window_distance, config.matching_window_heading)

    def _local_map(self) -> LocalMap:
        if self._map is None:
            self._map = LocalMap(list(self._kept))
        return self._map

    def _match(
        self,
        local_map: LocalMap,
        cloud: PointCloud,
        prior: Pose2,
        covariance: Array,
        first: _FirstScan,
    ) -> ScanMatch | RefusedScan:
        """Search near the odometry first, and in the widest window where nothing fits there."""
        covariance = covariance + np.diag(_MINIMUM_DEVIATIONS**2)
        near = self._register(local_map, cloud, prior, covariance, _window(prior, covariance))
        likely = near is not None and _distance(near.pose, prior, covariance) < _UNLIKELY
        acceptable = near is not None and (likely or near.overlap >= _WIDE_OVERLAP)
        if near is not None and acceptable and near.overlap >= self.config.matching_overlap:
            return self._inflate_prior(local_map, cloud, near, prior, covariance, first)
        window = SearchWindow(prior, *_MAXIMUM_WINDOW)
        slipped = np.diag([*_MAXIMUM_WINDOW[:1] * 2, _MAXIMUM_WINDOW[1]]) ** 2
        found = self._register(local_map, cloud, prior, slipped, window)
        if found is None or found.overlap < _WIDE_OVERLAP:
            # Through a door, little of the map remains in sight, but wheel odometry is reliable.
            if (
                near is not None
                and likely
                and near.overlap >= _REDUCED_OVERLAP * self.config.matching_overlap
            ):
                return self._inflate_prior(local_map, cloud, near, prior, covariance, first)
            return RefusedScan(Refusal.LITTLE_OVERLAP, prior)
        if _is_ambiguous(local_map, cloud, window, found.pose):
            return RefusedScan(Refusal.AMBIGUOUS, prior)
        return self._with_first(found, slipped, first)

    def _with_first(self, found: Alignment, covariance: Array, first: _FirstScan) -> ScanMatch:
        """Return a match, with what the pose has taken over of the error of the first scan."""
        match = _scan_match(found, covariance, self._window_moved)
        growth = first.step(found, covariance)
        return replace(match, drift=match.drift + growth, window=match.window + growth)

    def _register(
        self,
        local_map: LocalMap,
        cloud: PointCloud,
        prior: Pose2,
        covariance: Array,
        window: SearchWindow,
    ) -> Alignment | None:
        """Correlate, then align from the peak with the odometry as prior."""
        peak = local_map.find_peak(cloud.query_points, window, _MINIMUM_SCORE)
        start = prior if peak is None else peak.pose
        weak = Prior(prior, np.linalg.inv(covariance))
        found = local_map.align(cloud, start, _REACH, weak)
        return None if found is None else self._opened(local_map, cloud, found, weak)

    def _opened(
        self, local_map: LocalMap, cloud: PointCloud, found: Alignment, prior: Prior
    ) -> Alignment:
        """Return an alignment, without what it seems to measure along a corridor if asked for."""
        direction = open_direction(found) if self._open_ended else None
        if direction is None:
            return found
        start, kept = keeping_prior(found, prior, direction)
        again = local_map.align(cloud, start, _LAST_REACH, kept)
        return without_direction(again or found, direction)

    def _inflate_prior(
        self,
        local_map: LocalMap,
        cloud: PointCloud,
        found: Alignment,
        prior: Pose2,
        P: Array,
        first: _FirstScan,
    ) -> ScanMatch:
        """Inflate the odometry covariance to match the innovation; return the match with it.

        P (3, 3) is scaled until the squared Mahalanobis distance has its expected value, so that
        wheels that slip in one direction are trusted less in all of them (covariance matching;
        Mehra, 1972).
        """
        scale = _distance(found.pose, prior, P) ** 2 / 3.0
        if scale > 1.0:
            P = scale * P
            weaker = Prior(prior, np.linalg.inv(P))
            again = local_map.align(cloud, found.pose, _LAST_REACH, weaker)
            found = found if again is None else self._opened(local_map, cloud, again, weaker)
        return self._with_first(found, P, first)


def _distance(pose: Pose2, prior: Pose2, covariance: Array) -> float:
    """Return the Mahalanobis distance of a pose from the odometry's."""
    off = np.asarray(prior.between(pose))
    return math.sqrt(max(float(off @ np.linalg.solve(covariance, off)), 0.0))


def _check_prior(prior: Pose2, covariance: Array) -> None:
    if not prior.is_finite():
        raise RegistrationError(f'prior is {tuple(prior)}, expected finite values')
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        raise RegistrationError(
            f'covariance of the prior has shape {covariance.shape} or is not finite, '
            'expected a finite (3, 3)'
        )
    if np.diag(covariance).min() < 0.0:
        raise RegistrationError('covariance of the prior has a negative variance')


def _window(prior: Pose2, covariance: Array) -> SearchWindow:
    """Return the window of 3 standard deviations of the odometry, within limits."""
    position = math.sqrt(max(covariance[0, 0], covariance[1, 1]))
    heading = math.sqrt(covariance[2, 2])
    return SearchWindow(
        prior,
        min(_SIGMAS * position + _MINIMUM_WINDOW[0], _MAXIMUM_WINDOW[0]),
        min(_SIGMAS * heading + _MINIMUM_WINDOW[1], _MAXIMUM_WINDOW[1]),
        _ANGLE_STEP,
        position_penalty=_PENALTY / (2.0 * position) ** 2,
        heading_penalty=_PENALTY / (2.0 * heading) ** 2,
    )


def _is_ambiguous(
    local_map: LocalMap, cloud: PointCloud, window: SearchWindow, pose: Pose2
) -> bool:
    points = cloud.query_points
    score = local_map.score_profile(points, pose, (1.0, 0.0), np.zeros(1))[0]
    other = local_map.find_other_mode(points, window, pose, _MODES_APART, _OTHER_MODE * score)
    return other is not None


def _scan_match(found: Alignment, covariance: Array, window_moved: bool) -> ScanMatch:
    """Split the error of the pose into that of the scan and that of the odometry (Joseph form).

    With the scan's information A and the odometry's covariance P, the error after the match has
    covariance C = (A + P⁻¹)⁻¹ = C A C + C P⁻¹ C. The first term is the scan's own: white. The
    second is what is left of the odometry's: a random walk. So is the error of the window's
    frame, which moves when a scan is kept. A takes the returns to be as noisy as their residuals:
    in the simulated office both parts then agree with the true motion between scans 1 to 200
    apart (benchmarks/scan_matching_noise.py).
    """
    certainty = np.linalg.inv(covariance)
    information = found.information
    left = np.linalg.inv(information + certainty)
    white = _transformed(left, information)
    drift = _transformed(left, certainty)
    share = WINDOW_DRIFT * (1.0 - found.independent) if window_moved else 0.0
    window = share * white
    return ScanMatch(
        found.pose, white, drift + window, window, information, found.overlap, found.rms
    )


def _transformed(transform: Array, information: Array) -> Array:
    """Return T A Tᵀ for symmetric T, symmetric and positive semidefinite whatever the rounding.

    Where A is large in one direction and next to nothing in another, as along a corridor, the
    product alone may have negative eigenvalues.
    """
    product: Array = transform @ information @ transform
    asymmetry = np.abs(product - product.T).max()
    if asymmetry <= _ROUNDING * np.abs(product).max() and np.linalg.eigvalsh(product)[0] >= 0.0:
        return product
    values, vectors = np.linalg.eigh(information)
    root = transform @ (vectors * np.sqrt(values.clip(0.0)))
    positive: Array = root @ root.T
    return positive
