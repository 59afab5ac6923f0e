"""Search for a vehicle whose pose in the map is unknown: every region, every heading.

A search takes up to a second; it is done region by region, so that it can run in slices between
other work or in a thread of its own.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Array, Pose2, between, compose, wrap_angle
from explore_slam.registration import LocalMap, Peak, SearchWindow
from explore_slam.slam.checkpoint import State
from explore_slam.slam.closures.agreement import (
    Candidate,
    candidate_rows,
    candidates_of_rows,
    largest_agreement,
    span,
    unexpired,
)
from explore_slam.slam.closures.anchors import (
    REGION_SPACING,
    Anchors,
    Query,
    Region,
    pose_of,
)
from explore_slam.slam.closures.closure import Closure, closure_information, poses_differ
from explore_slam.slam.closures.config import ClosureConfig
from explore_slam.slam.closures.uniqueness import Fit, fit_of, trail_of

# Where no other source is given, values were chosen on the Intel, ACES and Belgioioso logs;
# `benchmarks/laser_graph_slam.py` shows what a change does.
QUERY_LENGTH = 8.0  # m driven, whose scans are searched together
_MINIMUM_QUERY_LENGTH = 6.0  # m; less does not distinguish rooms
_WINDOW = 0.5 * 2.0 * REGION_SPACING + 1.0  # m: half the distance of the centres used, and 1 m
_ANGLE_STEP = math.radians(2.0)
_SAME_PLACE = (2.0, math.radians(45.0))  # m, rad: one region per place and heading is enough
_REACH = 0.4  # m, of the alignment at first
_MODES_APART = (0.5, 0.17)  # m, rad: nearer poses are the same mode
# Share of the returns that must lie on known surfaces: around the path that the vehicle has in
# common with the map, part of what it has seen may not have been mapped yet (Intel: 0.5 to 0.65).
_MINIMUM_OVERLAP = 0.5
_SURROUNDINGS = 8.0  # m around a match: all that is known there
_MAXIMUM_ANCHORS_AROUND = 40  # anchors; more of them are taken in turn
_AGREEMENTS = 4  # candidates from different scans
_AGREEMENT_SPAN = 6.0  # m driven
_PENDING_DISTANCE = 30.0  # m


@dataclass(frozen=True)
class _Found:
    region: Region
    peak: Peak
    pose: Array  # (3,) in the map


class GlobalSearch:
    """Searches for vehicles of unknown start; keeps candidates until enough of them agree."""

    def __init__(self, config: ClosureConfig, anchors: Anchors) -> None:
        self.config = config
        self.anchors = anchors
        self.pending: list[Candidate] = []

    def state_dict(self) -> State:
        """Return the candidates that wait; see `from_state`."""
        return {'pending': candidate_rows(self.pending)}

    @classmethod
    def from_state(cls, state: State, config: ClosureConfig, anchors: Anchors) -> Self:
        """Make a search that continues exactly from a state of `state_dict`.

        anchors: restored before.
        """
        made = cls(config, anchors)
        made.pending = candidates_of_rows(state['pending'], anchors)
        return made

    def remove_anchor(self, keyframe: int) -> None:
        """Forget the candidates that an anchor is part of, because it will be removed."""
        self.pending = [c for c in self.pending if keyframe not in (c.a.keyframe, c.b.keyframe)]

    def search(
        self, keyframe: int, poses: Array, localized: Collection[int]
    ) -> Iterator[list[Closure]]:
        """Search for the anchor of a keyframe among those of localized vehicles.

        poses (K, 3): of all keyframes, by number; those of the localized vehicles are in one
        frame, those of the keyframe's vehicle in another. The result yields after each region the
        closures that join the two: none until the last step, and then only if enough candidates
        agree. It searches the anchors of this moment at these poses, which must not change
        meanwhile: pass a copy.
        """
        anchor = self.anchors.of_keyframe(keyframe)
        if anchor.vehicle in localized:
            raise SlamError(
                f'vehicle {anchor.vehicle} is already in the map, expected a vehicle with unknown '
                'start pose'
            )
        pose_of(poses, keyframe)
        query = self.anchors.query(anchor, poses, QUERY_LENGTH)
        regions = []
        if query.distance_driven >= _MINIMUM_QUERY_LENGTH:
            regions = list(self._regions(poses, localized))
        return self._search(query, regions, poses, localized)

    def _search(
        self, query: Query, regions: list[Region], poses: Array, localized: Collection[int]
    ) -> Iterator[list[Closure]]:
        found: list[_Found] = []
        for region in regions:
            best = max((match.peak.score for match in found), default=0.0)
            least = max(self.config.closure_score, self.config.closure_other_mode * best)
            window = SearchWindow(IDENTITY, _WINDOW, math.pi, _ANGLE_STEP)
            peak = region.map.find_peak(query.points, window, least)
            if peak is not None:
                pose = compose(poses[region.centre.keyframe], np.asarray(peak.pose))
                found.append(_Found(region, peak, pose))
            yield []
        candidate = self._candidate(query, found, poses, localized)
        if candidate is None:
            return
        group = self._agreeing(candidate, poses)
        if not group:
            return
        for fit in self._fits(group, poses, localized):
            if fit is None:
                yield []
            elif fit.is_unique(self.config.closure_other_mode):
                self._forget(candidate.b.vehicle)
                yield [member.closure for member in reversed(group)]

    def _regions(self, poses: Array, localized: Collection[int]) -> Iterator[Region]:
        """Yield a region for each place and heading of the localized vehicles."""
        seen: list[Array] = []
        for vehicle in sorted(localized):
            for number in self.anchors.region_numbers(vehicle):
                if number % 2:
                    continue
                region = self.anchors.region(vehicle, number, poses)
                if region is None:
                    continue
                pose = poses[region.centre.keyframe]
                if all(poses_differ(pose, other, *_SAME_PLACE) for other in seen):
                    seen.append(pose)
                    yield region

    def _candidate(
        self, query: Query, found: list[_Found], poses: Array, localized: Collection[int]
    ) -> Candidate | None:
        """Return the best match if it passes all tests and nothing else is nearly as good.

        A region is one pass through a place, and the query may have seen more than it: overlap
        and pose are evaluated with all that is known around the place. The map may still be
        growing there, so that less overlap is required than of a loop; `fit_of` tests for the
        false joins that this would permit.
        """
        if not found:
            return None
        best = max(found, key=lambda match: match.peak.score)
        needed = self.config.closure_other_mode * best.peak.score
        for match in found:
            if match.peak.score > needed and poses_differ(match.pose, best.pose, *_MODES_APART):
                return None
        region, window = best.region, SearchWindow(IDENTITY, _WINDOW, math.pi, _ANGLE_STEP)
        if region.centre.keyframe not in self.anchors:  # removed during the search
            return None
        if region.map.find_other_mode(query.points, window, best.peak.pose, _MODES_APART, needed):
            return None
        surroundings = self._surroundings(region, best.pose, poses, localized)
        alignment = surroundings.align(query.surfaces, best.peak.pose, _REACH)
        if (
            alignment is None
            or alignment.overlap < _MINIMUM_OVERLAP
            or alignment.rms > self.config.closure_rms
        ):
            return None
        closure = Closure(
            region.centre.keyframe,
            query.anchor.keyframe,
            alignment.pose,
            closure_information(surroundings, query, alignment),
            best.peak.score,
            alignment.overlap,
            alignment.rms,
        )
        return Candidate(region.centre, query.anchor, closure)

    def _surroundings(
        self, region: Region, pose: Array, poses: Array, localized: Collection[int]
    ) -> LocalMap:
        """Return the map of all localized anchors around a pose, in the frame of the region."""
        table = self.anchors.table()
        wanted = np.isin(table.vehicles, list(localized)) & (table.keyframes < len(poses))
        keyframes = table.keyframes[wanted]
        off = poses[keyframes, :2] - pose[:2]
        near = keyframes[(off**2).sum(axis=1) < _SURROUNDINGS**2]
        near = near[:: 1 + len(near) // _MAXIMUM_ANCHORS_AROUND]
        offsets = between(poses[region.centre.keyframe], poses[near])
        around = [self.anchors.of_keyframe(int(keyframe)) for keyframe in near]
        clouds = [anchor.cloud for anchor in (*around, *region.anchors)]
        placed = [Pose2.from_array(at) for at in (*offsets, *region.offsets)]
        return LocalMap.of(clouds, placed)

    def _agreeing(self, candidate: Candidate, poses: Array) -> list[Candidate]:
        """Hold the candidate; return those that agree with it, if they are enough for a join."""
        self.pending = unexpired(self.pending, candidate, _PENDING_DISTANCE)
        group = largest_agreement(candidate, self.pending, poses)
        self.pending.append(candidate)
        if len(group) < _AGREEMENTS or span(group) <= _AGREEMENT_SPAN:
            return []
        return group

    def _forget(self, vehicle: int) -> None:
        """Forget the candidates of a vehicle, because it is joined."""
        self.pending = [c for c in self.pending if c.b.vehicle != vehicle]

    def _fits(
        self, group: Collection[Candidate], poses: Array, localized: Collection[int]
    ) -> Iterator[Fit | None]:
        """Yield how the vehicle's path fits into the map at the pose of a group of candidates."""
        frame = join_transform([member.closure for member in group], poses)
        vehicle = next(iter(group)).b.vehicle
        present = [anchor for anchor in self.anchors if anchor.keyframe < len(poses)]
        trail = trail_of([anchor for anchor in present if anchor.vehicle == vehicle])
        known = [anchor for anchor in present if anchor.vehicle in localized]
        placed = compose(np.asarray(frame), poses[[anchor.keyframe for anchor in trail]])
        return fit_of(trail, placed, known, poses[[anchor.keyframe for anchor in known]])


def join_transform(closures: Collection[Closure], poses: Array) -> Pose2:
    """Return the mean pose, in the map, of the vehicle's own frame that the closures predict."""
    if not closures:
        raise SlamError('no closures, expected one or more')
    predicted = []
    for closure in closures:
        in_map = Pose2.from_array(closure.query_pose(poses))
        predicted.append(in_map.compose(Pose2.from_array(poses[closure.keyframe_b]).inverse()))
    values = np.array(predicted)
    heading = math.atan2(np.sin(values[:, 2]).mean(), np.cos(values[:, 2]).mean())
    return Pose2(float(values[:, 0].mean()), float(values[:, 1].mean()), wrap_angle(heading))
