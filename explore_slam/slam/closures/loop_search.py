"""Search for loops: parts of the map that match the scans of the last metres driven.

1. The query is the last 6 m of a vehicle; the candidates are regions of the map within the
   uncertainty of the query's pose relative to them.
2. Correlation over that uncertainty, then point-to-line alignment.
3. Tests: overlap and residual; no other mode in the window or in another region.
4. A window that is small leads to a closure at once; elsewhere several candidates must agree.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, between, compose, planar_rotation
from explore_slam.registration import Alignment, PointCloud, SearchWindow
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.closures.agreement import (
    Candidate,
    candidate_rows,
    candidates_of_rows,
    largest_agreement,
    span,
    unexpired,
)
from explore_slam.slam.closures.anchors import (
    QUERY_LENGTH,
    REGION_SPACING,
    Anchor,
    Anchors,
    Integers,
    Query,
    Region,
)
from explore_slam.slam.closures.closure import (
    Closure,
    ClosureEnds,
    acceptable,
    closure_information,
    poses_differ,
)
from explore_slam.slam.closures.config import ClosureConfig

RelativeCovariance = Callable[[int, Integers], Array]

# Where no other source is given, values were chosen on the Intel, ACES and Belgioioso logs;
# `benchmarks/laser_graph_slam.py` shows what a change does.
# m/m and rad/m: growth of the errors of position and heading where no covariance is given
_DRIFT: Array = np.array([0.012, 0.0015])
_SIGMAS = 3.0  # standard deviations of the relative pose that the search window covers
_MINIMUM_WINDOW = (0.5, 0.08)  # m, rad
_WIDEST_TURN = 0.7  # rad
_NEAR = 2.5  # m; up to so far outside the window, a region may still overlap the query
_WIDE = 3.0  # m; a wider window is searched more coarsely, in more regions and less often
_ANGLE_STEP, _WIDE_ANGLE_STEP = math.radians(1.0), math.radians(1.5)
_REGIONS, _WIDE_REGIONS = 3, 9
_REGIONS_APART = 6.0  # m driven: nearer ones hold the same anchors
_REACH = 0.4  # m, of the alignment at first
_MODES_APART = (0.5, 0.17)  # m, rad
_REGIONS_DISAGREE = (0.5, 0.15)  # m, rad
_OTHER_MODES_WITHIN = 2.0  # m; other modes are searched at least this far
_SMALL_WINDOW, _SMALL_CORRECTION = 1.0, 0.5  # m; a closure within both needs no agreement
_AGREEMENT_SPAN = 1.5  # m driven
_MINIMUM_SPACING = 0.1  # m driven between closures that add information
_PENDING_DISTANCE = 12.0  # m; older candidates are forgotten
_BODY = 3.0  # m; nearer than this another vehicle may be in the scans
# A closure is retracted when its squared Mahalanobis distance stays above this (chi-square with
# 3 degrees of freedom: 1 in 1e5) in as many checks.
_INCONSISTENT = 25.9
_CHECKS = 3


@dataclass(frozen=True)
class _Found:
    """An alignment of the query with a region, and the window it was searched in."""

    region: Region
    window: SearchWindow
    correlated: Pose2
    score: float
    alignment: Alignment
    pose: Array  # (3,) of the query in the map


class LoopSearch:
    """Holds the anchors of all vehicles and the accepted closures; searches for new ones."""

    def __init__(self, config: ClosureConfig) -> None:
        self.config = config
        self.anchors = Anchors()
        self.closures: list[Closure] = []
        self.pending: list[Candidate] = []
        self._closed_at: dict[int, float] = {}  # vehicle -> distance driven at its last closure
        # ends of the closures that may share scans with the next one
        self._accepted: list[ClosureEnds] = []
        self._inconsistent: dict[tuple[int, int], int] = {}

    def add_anchor(
        self, keyframe: int, vehicle: int, cloud: PointCloud, distance_driven: float, stamp: float
    ) -> None:
        """Add a keyframe with a cloud in the vehicle's frame; see Anchor."""
        self.anchors.add(Anchor(keyframe, vehicle, distance_driven, stamp, cloud))

    def adopt(self, closures: Sequence[Closure]) -> None:
        """Add closures that another search has found, to recheck them with the others."""
        self.closures += closures
        for closure in closures:
            self._note_closed(closure)

    def drop(self, closures: Sequence[Closure]) -> None:
        """Forget closures that are no longer part of the graph."""
        gone = {id(closure) for closure in closures}
        self.closures = [closure for closure in self.closures if id(closure) not in gone]

    def remove_anchor(self, keyframe: int) -> None:
        """Forget an anchor; closures that it is part of remain."""
        self.anchors.remove(keyframe)
        self.pending = [c for c in self.pending if keyframe not in (c.a.keyframe, c.b.keyframe)]

    def search(
        self,
        keyframe: int,
        poses: Array,
        covariance: RelativeCovariance | None = None,
        tied: Collection[int] | None = None,
    ) -> list[Closure]:
        """Return the closures that are accepted with the anchor of a keyframe.

        poses (K, 3): of all keyframes, by number, in the map. covariance: function of the
        query's keyframe and others (n,) that returns the covariances (n, 3, 3) of their relative
        poses; without it, errors grow with the distance driven. tied: vehicles whose poses are in
        the same frame as the query's; default: all.
        """
        anchor = self.anchors.of_keyframe(keyframe)
        if poses.ndim != 2 or poses.shape[1] != 3 or not np.isfinite(poses).all():
            raise SlamError(f'poses have shape {poses.shape}, expected finite values (K, 3)')
        number = self.anchors.number_added(anchor.vehicle)
        if number % self.config.closure_every:
            return []
        windows = self._regions_in_reach(anchor, poses, covariance, tied)
        if not windows:
            return []
        widest = max(window.reach for _, window in windows)
        if widest > _WIDE and number % (2 * self.config.closure_every):
            return []
        query = self.anchors.query(anchor, poses)
        found = [
            match
            for region, window in windows
            if (match := self._match(query, region, window, poses)) is not None
        ]
        passed = [
            self._candidate(query, match, poses, covariance)
            for match in sorted(found, key=lambda match: -match.score)
            if acceptable(match.alignment, self.config)
            and not self._is_ambiguous(match, found, query)
        ]
        accepted: list[Closure] = []
        for n, (candidate, window) in enumerate(passed):
            # Regions overlap: the same returns must not count twice.
            if not any(_is_same_place(candidate, other) for other, _ in passed[:n]):
                accepted += self._decide(candidate, window, poses)
        return accepted

    # ---- candidates

    def _regions_in_reach(
        self,
        anchor: Anchor,
        poses: Array,
        covariance: RelativeCovariance | None,
        tied: Collection[int] | None,
    ) -> list[tuple[Region, SearchWindow]]:
        """Return the nearest regions that the query may lie on, and the window in each."""
        nearest = self._nearest_of_regions(anchor, poses, tied)
        if not nearest:
            return []
        keyframes = np.array([other.keyframe for _, _, other in nearest], np.int64)
        deviations = self._deviations(anchor, [other for _, _, other in nearest])
        if covariance is not None:
            P = covariance(anchor.keyframe, keyframes)
            position = np.linalg.eigvalsh(P[:, :2, :2])[:, 1]
            deviations = np.sqrt(np.maximum(np.stack([position, P[:, 2, 2]], axis=1), 0.0))
        reaches = np.minimum(
            _MINIMUM_WINDOW[0] + _SIGMAS * deviations[:, 0], self.config.closure_widest_window
        )
        turns = np.minimum(_MINIMUM_WINDOW[1] + _SIGMAS * deviations[:, 1], _WIDEST_TURN)
        chosen: list[tuple[Region, SearchWindow]] = []
        distances_driven: list[tuple[int, float]] = []
        for k, (distance, region_number, other) in enumerate(nearest):
            most = _REGIONS if reaches[k] < _WIDE else _WIDE_REGIONS
            distance_driven = region_number * REGION_SPACING
            taken = any(
                v == other.vehicle and abs(w - distance_driven) < _REGIONS_APART
                for v, w in distances_driven
            )
            if distance > reaches[k] + _NEAR or taken or len(chosen) >= most:
                continue
            newest = math.inf
            if other.vehicle == anchor.vehicle:
                newest = anchor.distance_driven - 0.5 * self.config.closure_minimum_distance
            region = self.anchors.region(other.vehicle, region_number, poses, newest)
            if region is None:
                continue
            distances_driven.append((other.vehicle, distance_driven))
            centre = between(poses[region.centre.keyframe], poses[anchor.keyframe])
            step = _ANGLE_STEP if reaches[k] < _WIDE else _WIDE_ANGLE_STEP
            chosen.append(
                (region, SearchWindow(Pose2.from_array(centre), reaches[k], turns[k], step))
            )
        return chosen

    def _nearest_of_regions(
        self, anchor: Anchor, poses: Array, tied: Collection[int] | None
    ) -> list[tuple[float, int, Anchor]]:
        """Return distance (m), number and nearest anchor of every region, nearest first."""
        table = self.anchors.table()
        if table.keyframes.max() >= len(poses):
            raise SlamError(f'there are {len(poses)} poses, expected {table.keyframes.max() + 1}')
        off = poses[table.keyframes, :2] - poses[anchor.keyframe, :2]
        distances = np.hypot(off[:, 0], off[:, 1])
        own = table.vehicles == anchor.vehicle
        passed = own & (
            anchor.distance_driven - table.distances_driven >= self.config.closure_minimum_distance
        )
        body = (distances < _BODY) & (
            np.abs(table.stamps - anchor.stamp) < self.config.closure_delay
        )
        wanted = passed | (~own & ~body)
        wanted &= distances < self.config.closure_widest_window + _NEAR
        if tied is not None:
            wanted &= np.isin(table.vehicles, list(tied))
        best: dict[tuple[int, int], tuple[float, int, Anchor]] = {}
        candidates = np.flatnonzero(wanted)
        for n in candidates[np.argsort(distances[candidates], kind='stable')]:
            number = round(float(table.distances_driven[n]) / REGION_SPACING)
            key = (int(table.vehicles[n]), number)
            if key not in best:
                other = self.anchors.of_keyframe(int(table.keyframes[n]))
                best[key] = (float(distances[n]), number, other)
        return sorted(best.values(), key=lambda entry: (entry[0], entry[2].keyframe))

    def _deviations(self, anchor: Anchor, others: Sequence[Anchor]) -> Array:
        """Return deviations (n, 2) m, rad that grow with the distance since the last closure."""
        own = anchor.distance_driven - self._closed_at.get(anchor.vehicle, 0.0)
        distances_driven = np.array(
            [
                own
                if other.vehicle == anchor.vehicle
                else own
                + max(other.distance_driven - self._closed_at.get(other.vehicle, 0.0), 0.0)
                for other in others
            ]
        )
        deviations: Array = distances_driven[:, None] * _DRIFT
        return deviations

    # ---- matching and tests

    def _match(
        self, query: Query, region: Region, window: SearchWindow, poses: Array
    ) -> _Found | None:
        peak = region.map.find_peak(query.points, window, self.config.closure_score)
        if peak is None:
            return None
        alignment = region.map.align(query.surfaces, peak.pose, _REACH)
        if alignment is None:
            return None
        pose = compose(poses[region.centre.keyframe], np.asarray(alignment.pose))
        return _Found(region, window, peak.pose, peak.score, alignment, pose)

    def _is_ambiguous(self, match: _Found, found: Sequence[_Found], query: Query) -> bool:
        """Return whether another region or another pose in the window fits nearly as well."""
        needed = self.config.closure_other_mode * match.score
        if any(
            other.score > needed and poses_differ(other.pose, match.pose, *_REGIONS_DISAGREE)
            for other in found
        ):
            return True
        window = match.window
        wide = SearchWindow(
            window.centre,
            max(window.reach, _OTHER_MODES_WITHIN),
            window.turn,
            window.angle_step,
        )
        return (
            match.region.map.find_other_mode(
                query.points, wide, match.correlated, _MODES_APART, needed
            )
            is not None
        )

    def _decide(self, candidate: Candidate, window: SearchWindow, poses: Array) -> list[Closure]:
        """Accept a candidate, or hold it until enough others agree; return what is accepted."""
        b = candidate.b
        correction = between(poses[b.keyframe], candidate.closure.query_pose(poses))
        if (
            window.reach < _SMALL_WINDOW
            and math.hypot(correction[0], correction[1]) < _SMALL_CORRECTION
        ):
            return self._accept([candidate])
        self.pending = unexpired(self.pending, candidate, _PENDING_DISTANCE)
        group = largest_agreement(candidate, self.pending, poses)
        self.pending.append(candidate)
        if len(group) < self.config.closure_agreements or span(group) <= _AGREEMENT_SPAN:
            return []
        return self._accept(group)

    def _candidate(
        self, query: Query, match: _Found, poses: Array, covariance: RelativeCovariance | None
    ) -> tuple[Candidate, SearchWindow]:
        """Return the candidate that ties the query to the nearest anchor of the region."""
        region, alignment = match.region, match.alignment
        off = region.offsets[:, :2] - (alignment.pose.x, alignment.pose.y)
        a = region.anchors[int(np.argmin((off**2).sum(axis=1)))]
        pose = between(poses[a.keyframe], match.pose)
        R = planar_rotation(float(pose[2]) - alignment.pose.theta)
        internal_covariance = None
        if covariance is not None:
            internal_covariance = (
                R.T @ _internal_covariance(query, region, a, float(pose[2]), covariance) @ R
            )
        information = (
            R @ closure_information(region.map, query, alignment, internal_covariance) @ R.T
        )
        closure = Closure(
            a.keyframe,
            query.anchor.keyframe,
            Pose2.from_array(pose),
            information,
            match.score,
            alignment.overlap,
            alignment.rms,
        )
        return Candidate(a, query.anchor, closure), match.window

    def _accept(self, group: Sequence[Candidate]) -> list[Closure]:
        accepted = [self._with_shared_error(candidate) for candidate in reversed(group)]
        self.closures += accepted
        taken = {id(candidate) for candidate in group}
        self.pending = [c for c in self.pending if id(c) not in taken]
        for closure in accepted:
            self._note_closed(closure)
        return accepted

    def _note_closed(self, closure: Closure) -> None:
        """Update the distance that the vehicles of a closure had driven at their last one."""
        for keyframe in (closure.keyframe_a, closure.keyframe_b):
            end = self.anchors.of_keyframe(keyframe)
            self._closed_at[end.vehicle] = max(
                self._closed_at.get(end.vehicle, 0.0), end.distance_driven
            )

    def _with_shared_error(self, candidate: Candidate) -> Closure:
        """Return the closure with the information that it adds to those on the same path segment.

        Two queries share the scans of the segment that they have in common, and their errors. The
        errors of closures at a spacing d are correlated by the common part of the length q of a
        query; a fraction d / q of them counts as independent.
        """
        a, b = candidate.a, candidate.b
        self._accepted = [
            other
            for other in self._accepted
            if other.vehicle_b != b.vehicle or b.distance_driven - other.distance_b < QUERY_LENGTH
        ]
        spacings = [
            abs(b.distance_driven - other.distance_b)
            for other in self._accepted
            if (other.vehicle_a, other.vehicle_b) == (a.vehicle, b.vehicle)
            and abs(a.distance_driven - other.distance_a) < QUERY_LENGTH
        ]
        self._accepted.append(ClosureEnds.of(a, b))
        spacing = min(max(min(spacings, default=QUERY_LENGTH), _MINIMUM_SPACING), QUERY_LENGTH)
        information = spacing / QUERY_LENGTH * candidate.closure.information
        return replace(candidate.closure, information=information)

    # ---- state

    def state_dict(self) -> State:
        """Return the whole state as named arrays; see `from_state`."""
        rows = [closure.row() for closure in self.closures]
        return {
            **under('anchors', self.anchors.state_dict()),
            'closures': np.array(rows).reshape(-1, 17),
            'pending': candidate_rows(self.pending),
            'closed_at': np.array(list(self._closed_at.items()), np.float64).reshape(-1, 2),
            'accepted': np.array(self._accepted, np.float64).reshape(-1, 4),
            'inconsistent': np.array(
                [(*key, count) for key, count in self._inconsistent.items()], np.int64
            ).reshape(-1, 3),
        }

    @classmethod
    def from_state(cls, state: State, config: ClosureConfig) -> Self:
        """Make a search that continues exactly from a state of `state_dict`."""
        made = cls(config)
        made.anchors = Anchors.from_state(part('anchors', state))
        made.closures = [Closure.from_row(row) for row in state['closures']]
        made.pending = candidates_of_rows(state['pending'], made.anchors)
        made._closed_at = {
            int(vehicle): float(distance_driven) for vehicle, distance_driven in state['closed_at']
        }
        made._accepted = [
            ClosureEnds(int(vehicle_a), distance_a, int(vehicle_b), distance_b)
            for vehicle_a, distance_a, vehicle_b, distance_b in state['accepted'].tolist()
        ]
        made._inconsistent = {(int(a), int(b)): int(n) for a, b, n in state['inconsistent']}
        return made

    # ---- retraction

    def recheck(self, squared_distances: Array) -> list[Closure]:
        """Return the closures that have become inconsistent, and forget them.

        squared_distances (n,): Mahalanobis distances of `closures` at the present estimate of
        the graph. A closure is inconsistent when it is so in three checks in a row.
        """
        distances = np.asarray(squared_distances, dtype=np.float64)
        if distances.shape != (len(self.closures),) or np.isnan(distances).any():
            raise SlamError(
                f'squared distances have shape {distances.shape}, '
                f'expected {len(self.closures)} of the closures'
            )
        kept, inconsistent = [], []
        counts: dict[tuple[int, int], int] = {}
        for closure, distance in zip(self.closures, distances, strict=True):
            key = (closure.keyframe_a, closure.keyframe_b)
            count = self._inconsistent.get(key, 0) + 1 if distance > _INCONSISTENT else 0
            if count >= _CHECKS:
                inconsistent.append(closure)
                continue
            kept.append(closure)
            if count:
                counts[key] = count
        self.closures, self._inconsistent = kept, counts
        return inconsistent


def _is_same_place(one: Candidate, other: Candidate) -> bool:
    """Return whether two candidates of one query lead to the same part of a vehicle's path."""
    return (
        one.a.vehicle == other.a.vehicle
        and abs(one.a.distance_driven - other.a.distance_driven) < _REGIONS_APART
    )


def _internal_covariance(
    query: Query, region: Region, a: Anchor, heading: float, covariance: RelativeCovariance
) -> Array:
    """Return the covariance (3, 3) of relative pose errors within query and map, in the axes of a.

    heading (rad): of the query in the frame of anchor a. The error of a scan of the query relative
    to the newest is taken as that of its middle one; the error of the map around a as that of
    either half of it, the mean of two. In the simulated office single closures then have a squared
    Mahalanobis distance from the truth of 1.3 to 2.1 on average, where 3 is expected.
    """
    n = len(region.anchors)
    sides = np.array([region.anchors[n // 4].keyframe, region.anchors[3 * n // 4].keyframe])
    middle = np.array([query.middle.keyframe], np.int64)
    turn = planar_rotation(heading)
    own = turn @ covariance(query.anchor.keyframe, middle)[0] @ turn.T
    total: Array = own + 0.5 * covariance(a.keyframe, sides.astype(np.int64)).mean(axis=0)
    return total
