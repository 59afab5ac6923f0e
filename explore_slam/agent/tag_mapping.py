"""Tags in the map: landmarks with an identity close loops, join vehicles and fix the map's frame.

1. Observations of a tag wait until several of a vehicle, from different keyframes, agree on where
   it is: one that was read wrong stays alone and never enters the graph.
2. Together they are a sighting: one visit of a tag by a vehicle, a node of the joint graph.
3. A sighting is tied to an earlier one of the same tag if drift explains the difference; a large
   difference needs other tags that agree with it.
4. A vehicle of unknown start joins the map when the tags that both know agree on its frame.
5. Surveyed tags move the map into their frame, and hold it there.
6. Ties that contradict the path since it was drawn anew are retracted.
"""

import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from explore_slam.agent.loop_closing import Join, LoopClosing
from explore_slam.agent.vehicle_track import Keyframe
from explore_slam.data import UNKNOWN_HEADING, TagObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2, between, compose, moved_enough, wrap_angle
from explore_slam.slam import TeamBelief
from explore_slam.slam.checkpoint import State
from explore_slam.slam.closures.tag_frames import FrameFit, TagPair, TagPlace, fit_frame
from explore_slam.tags import TagConfig, TagPose

logger = logging.getLogger(__name__)

# Chosen by hand; `explore_slam benchmark tags` and test_tag_mapping show what a change does.
_AGREEMENTS = 3  # observations of a tag that must agree before it is believed
_SPACING = (0.1, 0.1)  # m, rad between keyframes whose observations count: others repeat errors
_VISIT = 10.0  # m driven without a tag, after which another visit of it begins
_MAXIMUM_OBSERVATIONS = 6  # of a visit that are kept, those with the smallest errors
_MAXIMUM_VISITS = 2  # of a tag by a vehicle that are nodes: later ones add to the newest
# m, m per m driven: what observations of one visit may differ by beside their deviations
_SAME_PLACE = (0.15, 0.03)
_GATE = 3.0  # standard deviations
# A tie needs no other tag where it corrects little, within a small uncertainty (as in
# slam.closures.loop_search), or where it lies well within the uncertainty (chi-square with 3
# degrees of freedom: 1 in 100).
_SMALL_WINDOW, _SMALL_CORRECTION = 1.0, 0.5  # m
_WITHIN = 11.3
# Squared Mahalanobis distance up to which drift may explain a difference where two tags agree, see
# slam.relocalization: covariances may be too small before a first loop is closed. Beyond it, three
# have to agree.
_PLAUSIBLE = 64.0
_MINIMUM_DEVIATIONS = np.array([0.03, 0.03, 0.03])  # m, m, rad: errors that no covariance models
# A single tag determines a frame if its heading is known this well, from this many observations.
_LONE_HEADING, _LONE_OBSERVATIONS = 0.06, 5  # rad, number
_FRAME_HEADING = 0.1  # rad: largest deviation of the heading of a frame
_RETRACTED = 0.3  # m between two sightings of a tag that are not the same, in as many checks:
_CHECKS = 3
_MAP = -1  # frame of the map; a vehicle of unknown start has its own, by its number


class TagCounts(NamedTuple):
    """What observations of tags have led to: sightings, ties between them, ties retracted."""

    sightings: int = 0
    closed: int = 0
    retracted: int = 0


@dataclass
class SeenTag:
    """A tag measured from a keyframe: pose (3,) in its frame, information (3, 3).

    driven: distance (m) that the vehicle had driven. factor: in the graph; -1 while it waits.
    """

    keyframe: int
    pose: Array
    information: Array
    driven: float
    factor: int = -1

    @property
    def position_deviation(self) -> float:
        """Standard deviation (m) of the position, in its worst direction."""
        return 1.0 / math.sqrt(float(np.linalg.eigvalsh(self.information[:2, :2])[0]))

    @classmethod
    def of(cls, keyframe: int, pose: Array, covariance: Array, driven: float) -> Self:
        """Make an observation; a heading that is not known gets no information."""
        information = np.linalg.inv(covariance)
        if covariance[2, 2] >= UNKNOWN_HEADING:
            information = np.zeros((3, 3))
            information[:2, :2] = np.linalg.inv(covariance[:2, :2])
        return cls(keyframe, pose.copy(), 0.5 * (information + information.T), driven)


@dataclass
class TagSighting:
    """A visit of a tag by a vehicle: its node in the graph, and the observations there.

    tie: factor that ties it to an earlier sighting, its node `root`; -1: it is not tied.
    wrong: checks in a row in which the tie contradicted the path. used: whether its pose is held
    by a survey.
    """

    tag: int
    vehicle: int
    node: int
    observations: list[SeenTag] = field(default_factory=list)
    tie: int = -1
    root: int = -1
    wrong: int = 0
    used: bool = False

    @property
    def driven(self) -> float:
        """Distance (m) that the vehicle had driven at the newest observation."""
        return max(item.driven for item in self.observations)

    @property
    def keyframe(self) -> int:
        """The keyframe of the newest observation."""
        return max(item.keyframe for item in self.observations)

    def place(self, pose: Array) -> TagPlace:
        """Return where the tag is, with the deviations of its observations."""
        total = sum(item.information for item in self.observations)
        smallest = float(np.linalg.eigvalsh(np.asarray(total)[:2, :2])[0])
        heading = float(np.asarray(total)[2, 2])
        return TagPlace(pose, smallest**-0.5, max(heading, 1e-3) ** -0.5)


class TagMapping:
    """Sightings of tags by all vehicles, and what they tie together."""

    def __init__(self, config: TagConfig, surveyed: Mapping[int, TagPose]) -> None:
        self.config = config
        self.surveyed = dict(surveyed)
        self.frame_is_surveyed = False
        self.sightings: list[TagSighting] = []
        self._pending: dict[tuple[int, int], list[SeenTag]] = {}  # (vehicle, tag)
        self._odometry: dict[int, Pose2] = {}  # of each vehicle's newest keyframe with tags
        self._driven: dict[int, float] = {}
        self._redraws = 0
        self._contradicted: set[int] = set()  # surveyed tags that a warning has named

    def configure(self, config: TagConfig, surveyed: Mapping[int, TagPose]) -> None:
        """Replace the settings; tags that hold the map already do so as before."""
        self.config, self.surveyed = config, dict(surveyed)

    def add(
        self,
        belief: TeamBelief,
        loops: LoopClosing,
        vehicle: str,
        keyframe: Keyframe,
        observations: TagObservations,
    ) -> TagCounts:
        """Take the tags that a vehicle has seen at its newest keyframe."""
        number = belief.vehicles.index(vehicle)
        last = self._odometry.get(number)
        moved = Pose2(0.0, 0.0, 0.0) if last is None else last.between(keyframe.odometry)
        self._odometry[number] = keyframe.odometry
        driven = self._driven.get(number, 0.0) + math.hypot(moved.x, moved.y)
        self._driven[number] = driven
        self._forget_old(belief, number)
        path, before, closed = belief.best_path(), len(self.sightings), 0
        for tag, pose, covariance in zip(
            observations.ids.tolist(), observations.poses, observations.covariances, strict=True
        ):
            seen = SeenTag.of(keyframe.number, pose, covariance, driven)
            sighting = self._assign(belief, number, tag, seen, path)
            if sighting is not None:
                closed += self._use(belief, loops, sighting)
        return TagCounts(len(self.sightings) - before, closed, self._retract_contradicted(belief))

    # ---- observations become sightings

    def _assign(
        self, belief: TeamBelief, number: int, tag: int, seen: SeenTag, path: Array
    ) -> TagSighting | None:
        """Add an observation to a sighting, which is returned, or let it wait for others."""
        own = [s for s in self.sightings if (s.vehicle, s.tag) == (number, tag)]
        sighting = own[-1] if own else None
        if sighting is not None:
            at = compose(path[seen.keyframe], seen.pose)
            off = math.dist(at[:2], belief.tags.pose(sighting.node)[:2])
            since = seen.driven - sighting.driven
            same_visit = since < _VISIT or len(own) >= _MAXIMUM_VISITS
            if same_visit and off < _tolerance(seen, min(since, _VISIT)):
                return sighting if self._extend(belief, sighting, seen, path) else None
        waiting = self._pending.setdefault((number, tag), [])
        if waiting and not _is_apart(waiting[-1], seen, path):
            return None
        belief.pin(seen.keyframe)
        waiting.append(seen)
        at = compose(path[seen.keyframe], seen.pose)
        agreeing = [
            other
            for other in waiting
            if math.dist(at[:2], compose(path[other.keyframe], other.pose)[:2])
            < _tolerance(seen, seen.driven - other.driven) + _GATE * other.position_deviation
        ]
        if len(agreeing) < _AGREEMENTS:
            return None
        return self._begin(belief, number, tag, agreeing)

    def _begin(
        self, belief: TeamBelief, number: int, tag: int, agreeing: list[SeenTag]
    ) -> TagSighting:
        """Make a sighting of observations that agree."""
        best = min(agreeing, key=lambda item: item.position_deviation)
        node = belief.tags.add(best.keyframe, Pose2.from_array(best.pose))
        sighting = TagSighting(tag, number, node)
        for seen in agreeing:
            _observe(belief, sighting, seen)
            belief.unpin(seen.keyframe)
        used = {id(seen) for seen in agreeing}
        waiting = self._pending[number, tag]
        self._pending[number, tag] = [seen for seen in waiting if id(seen) not in used]
        self.sightings.append(sighting)
        return sighting

    def _extend(
        self, belief: TeamBelief, sighting: TagSighting, seen: SeenTag, path: Array
    ) -> bool:
        """Add an observation to a sighting, if it is among the best; return whether it is."""
        newest = max(sighting.observations, key=lambda item: item.keyframe)
        if not _is_apart(newest, seen, path):
            return False
        if len(sighting.observations) >= _MAXIMUM_OBSERVATIONS:
            worst = max(sighting.observations, key=lambda item: item.position_deviation)
            if worst.position_deviation <= seen.position_deviation:
                return False
            belief.tags.drop(worst.factor)
            sighting.observations = [o for o in sighting.observations if o is not worst]
        _observe(belief, sighting, seen)
        if sighting.tie >= 0 or sighting.used or any(s.root == sighting.node for s in self._tied):
            belief.tags.redraw_if_off(
                sighting.node, seen.keyframe, Pose2.from_array(seen.pose), seen.information
            )
        return True

    @property
    def _tied(self) -> Iterable[TagSighting]:
        return (sighting for sighting in self.sightings if sighting.tie >= 0)

    def _forget_old(self, belief: TeamBelief, number: int) -> None:
        """Forget the observations of a vehicle that have waited for too long."""
        for (vehicle, tag), waiting in self._pending.items():
            if vehicle != number:
                continue
            old = [o for o in waiting if self._driven[number] - o.driven >= _VISIT]
            for seen in old:
                belief.unpin(seen.keyframe)
            self._pending[vehicle, tag] = [o for o in waiting if o not in old]

    # ---- sightings are tied together

    def _use(self, belief: TeamBelief, loops: LoopClosing, sighting: TagSighting) -> int:
        """Use what a sighting says now; return how many ties it has led to."""
        frame = self._frame(belief, sighting.vehicle)
        closed = self._tie(belief, frame)
        if frame == _MAP:
            self._survey(belief)
        for number, name in enumerate(belief.vehicles):
            if not belief.is_in_map(name) and frame in (_MAP, number):
                closed += self._join(belief, loops, number)
        return closed

    def _frame(self, belief: TeamBelief, vehicle: int) -> int:
        return _MAP if belief.is_in_map(belief.vehicles[vehicle]) else vehicle

    def _roots(self, belief: TeamBelief, frame: int) -> dict[int, TagSighting]:
        """Return, by tag, the sighting in a frame that most others are tied to; else the first."""
        weight = {s.node: 0 for s in self.sightings}
        for sighting in self._tied:
            weight[sighting.root] += 1
        roots: dict[int, TagSighting] = {}
        for sighting in self.sightings:
            if sighting.tie >= 0 or self._frame(belief, sighting.vehicle) != frame:
                continue
            other = roots.get(sighting.tag)
            if other is None or weight[sighting.node] > weight[other.node]:
                roots[sighting.tag] = sighting
        return roots

    def _tie(self, belief: TeamBelief, frame: int) -> int:
        """Tie the sightings in a frame to others of the same tags; return how many were tied."""
        roots = self._roots(belief, frame)
        by_vehicle: dict[int, list[TagSighting]] = {}
        certain: list[tuple[TagSighting, TagSighting]] = []
        for sighting in self.sightings:
            root = roots.get(sighting.tag)
            if (
                root is None
                or root is sighting
                or sighting.tie >= 0
                or sighting.wrong >= _CHECKS
                or any(other.root == sighting.node for other in self._tied)
                or self._frame(belief, sighting.vehicle) != frame
            ):
                continue
            if self._is_certain(belief, root, sighting):
                certain.append((root, sighting))
            else:
                by_vehicle.setdefault(sighting.vehicle, []).append(sighting)
        for own in by_vehicle.values():
            certain += self._agreeing(belief, own, roots)
        return self._close(belief, certain)

    def _is_certain(self, belief: TeamBelief, root: TagSighting, sighting: TagSighting) -> bool:
        """Return whether drift explains where a tag was seen again, without another tag."""
        off, P = _difference(belief, root, sighting)
        distance = float(off @ np.linalg.solve(P, off))
        window = _GATE * math.sqrt(float(np.linalg.eigvalsh(P[:2, :2])[-1]))
        if distance >= _PLAUSIBLE:
            return False
        if window < _SMALL_WINDOW and math.hypot(off[0], off[1]) < _SMALL_CORRECTION:
            return True
        return distance < _WITHIN

    def _agreeing(
        self, belief: TeamBelief, own: list[TagSighting], roots: Mapping[int, TagSighting]
    ) -> list[tuple[TagSighting, TagSighting]]:
        """Return roots and sightings of a vehicle, of different tags, that agree on its drift."""
        newest = {sighting.tag: sighting for sighting in own}
        fit = fit_frame([_pair(belief, s, roots[tag]) for tag, s in newest.items()])
        if fit is None:
            return []
        chosen = [(roots[pair.tag], newest[pair.tag]) for pair in fit.pairs]
        distances = []
        for root, sighting in chosen:
            off, P = _difference(belief, root, sighting)
            distances.append(float(off @ np.linalg.solve(P, off)))
        needed = 2 if max(distances) < _PLAUSIBLE else 3
        if len(chosen) < needed or fit.contradicting >= len(chosen):
            return []
        return chosen

    def _close(self, belief: TeamBelief, pairs: list[tuple[TagSighting, TagSighting]]) -> int:
        """Tie sightings to their roots; return how many were tied."""
        if not pairs:
            return 0
        try:
            factors = belief.tags.tie([(root.node, sighting.node) for root, sighting in pairs])
        except SlamError as error:
            logger.warning('tags %s: %s', sorted({s.tag for _, s in pairs}), error)
            return 0
        for (root, sighting), factor in zip(pairs, factors, strict=True):
            sighting.tie, sighting.root, sighting.wrong = factor, root.node, 0
        return len(pairs)

    def _retract_contradicted(self, belief: TeamBelief) -> int:
        """Undo the ties that the path contradicts since it was drawn anew."""
        if belief.redraws == self._redraws:
            return 0
        self._redraws, count = belief.redraws, 0
        for sighting in list(self._tied):
            off = math.dist(
                belief.tags.pose(sighting.node)[:2], belief.tags.pose(sighting.root)[:2]
            )
            sighting.wrong = sighting.wrong + 1 if off > _RETRACTED else 0
            if sighting.wrong >= _CHECKS:
                belief.tags.retract(sighting.tie)
                sighting.tie = sighting.root = -1
                count += 1
        return count

    # ---- vehicles of unknown start, surveyed tags

    def _join(self, belief: TeamBelief, loops: LoopClosing, number: int) -> int:
        """Take a vehicle into the map if the tags that both know agree on its frame."""
        own, known = self._roots(belief, number), self._roots(belief, _MAP)
        pairs = []
        for tag, sighting in own.items():
            if tag in known:
                pairs.append(_pair(belief, sighting, known[tag]))
            elif self.frame_is_surveyed and tag in self.surveyed:
                pairs.append(self._surveyed_pair(belief, sighting))
        fit = fit_frame(pairs)
        if fit is None or not _is_reliable(fit, {**own, **known}, own):
            return 0
        tied = [(known[pair.tag], own[pair.tag]) for pair in fit.pairs if pair.tag in known]
        surveyed = [own[pair.tag] for pair in fit.pairs if pair.tag not in known]
        try:
            factors = belief.tags.join(
                number,
                fit.frame,
                [(root.node, sighting.node) for root, sighting in tied],
                {s.node: self._survey_of(s.tag) for s in surveyed},
            )
        except SlamError as error:
            logger.warning('%s cannot join the map: %s', belief.vehicles[number], error)
            return 0
        for (root, sighting), factor in zip(tied, factors, strict=True):
            sighting.tie, sighting.root, sighting.wrong = factor, root.node, 0
        for sighting in surveyed:
            sighting.used = True
        self._report_join(belief, loops, number, tied)
        tags = ', '.join(str(pair.tag) for pair in fit.pairs)
        logger.info('%s joined the map by the tags %s', belief.vehicles[number], tags)
        return len(tied)

    def _report_join(
        self,
        belief: TeamBelief,
        loops: LoopClosing,
        number: int,
        tied: list[tuple[TagSighting, TagSighting]],
    ) -> None:
        """Report a join, with the relative pose of two keyframes that saw the same tag."""
        if not tied:
            return
        root, sighting = tied[-1]
        path = belief.best_path()
        loops.report_join(
            Join(
                belief.vehicles[number],
                belief.stamp_of(sighting.keyframe),
                self._driven[number],
                belief.vehicles[root.vehicle],
                belief.stamp_of(root.keyframe),
                Pose2.from_array(between(path[root.keyframe], path[sighting.keyframe])),
            ),
            (root.vehicle, number),
        )

    def _survey(self, belief: TeamBelief) -> None:
        """Move the map into the frame of the surveyed tags, or hold it there by another one."""
        roots = self._roots(belief, _MAP)
        known = {t: s for t, s in roots.items() if t in self.surveyed and not s.used}
        if not known:
            return
        if self.frame_is_surveyed:
            chosen, frame = [s for s in known.values() if self._is_in_place(belief, s)], None
        else:
            fit = fit_frame([self._surveyed_pair(belief, s) for s in known.values()])
            if fit is None or not _is_reliable(fit, known, known):
                return
            chosen, frame = [known[pair.tag] for pair in fit.pairs], fit.frame
        if not chosen:
            return
        try:
            belief.tags.survey({s.node: self._survey_of(s.tag) for s in chosen}, frame)
        except SlamError as error:
            logger.warning('surveyed tags %s: %s', [s.tag for s in chosen], error)
            return
        for sighting in chosen:
            sighting.used = True
        if frame is not None:
            self.frame_is_surveyed = True
            logger.info(
                'the map is in the frame of the surveyed tags %s from now on',
                ', '.join(str(s.tag) for s in chosen),
            )

    def _is_in_place(self, belief: TeamBelief, sighting: TagSighting) -> bool:
        """Return whether a tag is where it was surveyed; one that is not is named once."""
        pose, deviations = self._survey_of(sighting.tag)
        at = belief.tags.pose(sighting.node)
        off = at[:2] - pose[:2]
        P = belief.tags.covariance(sighting.node)[:2, :2]
        P = P + np.diag(deviations[:2] ** 2 + _MINIMUM_DEVIATIONS[:2] ** 2)
        if off @ np.linalg.solve(P, off) < _PLAUSIBLE:
            return True
        if sighting.tag not in self._contradicted:
            self._contradicted.add(sighting.tag)
            logger.warning(
                'tag %d is at (%.2f m, %.2f m), %.2f m from its surveyed pose: it is not used to '
                'fix the frame of the map; correct its pose in tags.yaml',
                sighting.tag, at[0], at[1], math.hypot(off[0], off[1]),
            )  # fmt: skip
        return False

    def _survey_of(self, tag: int) -> tuple[Array, Array]:
        """Return the surveyed pose (3,) of a tag, NaN for an unknown heading, and deviations."""
        pose, config = self.surveyed[tag], self.config
        yaw = math.nan if pose.yaw is None else pose.yaw
        spread = [config.tag_survey_deviation] * 2 + [config.tag_survey_heading]
        return np.array([pose.x, pose.y, yaw]), np.array(spread)

    def _surveyed_pair(self, belief: TeamBelief, sighting: TagSighting) -> TagPair:
        pose, deviations = self._survey_of(sighting.tag)
        heading = float(deviations[2]) if np.isfinite(pose[2]) else math.pi
        there = TagPlace(np.nan_to_num(pose), float(deviations[0]), heading)
        return TagPair(sighting.tag, sighting.place(belief.tags.pose(sighting.node)), there)

    # ---- state

    def state_dict(self) -> State:
        """Return everything but settings and odometry, whose frame does not survive a restart."""
        groups = [((s.vehicle, s.tag), n, s.observations) for n, s in enumerate(self.sightings)]
        groups += [(key, -1, waiting) for key, waiting in self._pending.items()]
        rows = [
            (*key, n, o.keyframe, o.factor, o.driven, *o.pose, *o.information.ravel())
            for key, n, observations in groups
            for o in observations
        ]
        sightings = [
            (s.tag, s.vehicle, s.node, s.tie, s.root, s.wrong, s.used) for s in self.sightings
        ]
        return {
            'sightings': np.array(sightings, np.int64).reshape(-1, 7),
            'observations': np.array(rows, np.float64).reshape(-1, 18),
            'driven': np.array(list(self._driven.items()), np.float64).reshape(-1, 2),
            'contradicted': np.array(sorted(self._contradicted), np.int64),
            'counters': np.array([self.frame_is_surveyed, self._redraws], np.int64),
        }

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned; nothing where a saved state knows no tags."""
        if not state:
            return
        self.sightings = [
            TagSighting(tag, vehicle, node, [], tie, root, wrong, bool(used))
            for tag, vehicle, node, tie, root, wrong, used in state['sightings'].tolist()
        ]
        for row in state['observations']:
            vehicle, tag, n, keyframe, factor = (int(value) for value in row[:5])
            seen = SeenTag(
                keyframe, row[6:9].copy(), row[9:].reshape(3, 3).copy(), float(row[5]), factor
            )
            if n >= 0:
                self.sightings[n].observations.append(seen)
            else:
                self._pending.setdefault((vehicle, tag), []).append(seen)
        self._driven = {int(vehicle): driven for vehicle, driven in state['driven'].tolist()}
        self._contradicted = set(state['contradicted'].tolist())
        surveyed, self._redraws = state['counters'].tolist()
        self.frame_is_surveyed = bool(surveyed)


def _observe(belief: TeamBelief, sighting: TagSighting, seen: SeenTag) -> None:
    """Record an observation of a sighting in the graph."""
    seen.factor = belief.tags.observe(
        sighting.node, seen.keyframe, Pose2.from_array(seen.pose), seen.information
    )
    sighting.observations.append(seen)


def _tolerance(seen: SeenTag, since: float) -> float:
    """Return what observations of one visit may differ by (m), driven `since` (m) apart."""
    return _SAME_PLACE[0] + _SAME_PLACE[1] * abs(since) + _GATE * seen.position_deviation


def _is_apart(one: SeenTag, other: SeenTag, path: Array) -> bool:
    """Return whether a vehicle has moved enough between observations for both to count."""
    moved = Pose2.from_array(between(path[one.keyframe], path[other.keyframe]))
    return one.keyframe != other.keyframe and moved_enough(moved, *_SPACING)


def _difference(
    belief: TeamBelief, root: TagSighting, sighting: TagSighting
) -> tuple[Array, Array]:
    """Return the pose (3,) of one sighting of a tag relative to another, and its covariance."""
    off = between(belief.tags.pose(root.node), belief.tags.pose(sighting.node))
    off[2] = wrap_angle(float(off[2]))
    P = belief.tags.relative_covariance(root.node, sighting.node)
    return off, P + np.diag(_MINIMUM_DEVIATIONS**2)


def _pair(belief: TeamBelief, here: TagSighting, there: TagSighting) -> TagPair:
    poses = (belief.tags.pose(s.node) for s in (here, there))
    return TagPair(here.tag, *(s.place(p) for s, p in zip((here, there), poses, strict=True)))


def _is_reliable(
    fit: FrameFit, known: Mapping[int, TagSighting], own: Mapping[int, TagSighting]
) -> bool:
    """Return whether the tags that agree on a frame are enough to rely on it."""
    count = len(fit.pairs)
    if fit.contradicting >= count or fit.heading_deviation > _FRAME_HEADING:
        return False
    if count > 1:
        return True
    (pair,) = fit.pairs
    seen = min(len(known[pair.tag].observations), len(own[pair.tag].observations))
    return pair.heading_deviation < _LONE_HEADING and seen >= _LONE_OBSERVATIONS
