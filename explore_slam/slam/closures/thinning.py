"""Select the anchors of known places that may be removed, to bound their number by the area."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from explore_slam.geometry import Array, Pose2, between
from explore_slam.slam.checkpoint import State
from explore_slam.slam.closures.anchors import Anchor, Anchors
from explore_slam.slam.closures.loop_search import RelativeCovariance

# Where no other source is given, values were chosen on the Intel, ACES and Belgioioso logs;
# `benchmarks/laser_graph_slam.py` shows what a change does.
_RECENT_DISTANCE = 15.0  # m of each vehicle that are kept: queries and the nearest loops need them
_SAME_PLACE = 3.0  # m; older anchors nearer than this may show the same
# Anchors of the same place that are compared: the most similar, where a difference of the heading
# by 1 rad counts as much as one of the position by 1 m. A laser with a field of view of 180° shows
# something else in every direction, so that it takes many from around to show the same. On a
# patrol of the simulated office (`explore_slam benchmark endurance`), 1.5 m and 16 anchors left
# 856 after 8 min, 3 m and 48 left 654.
_MAXIMUM_OLDER_ANCHORS = 48
_HEADING_DISTANCE = 1.0  # m/rad
_OVERLAP = 0.9  # fraction of the returns that older anchors show too
_KNOWN_DEVIATION = 0.1  # m, deviation of the pose relative to the older anchors
_ON_SURFACE = 0.15  # m: a return this near one of an older anchor is the same


class Thinning:
    """Selects the anchors that repeat what older ones show; each is evaluated once."""

    def __init__(self, anchors: Anchors) -> None:
        self.anchors = anchors
        self.evaluated: set[int] = set()

    def state_dict(self) -> State:
        """Return what has been evaluated; see `from_state`."""
        return {'evaluated': np.array(sorted(self.evaluated), np.int64)}

    @classmethod
    def from_state(cls, state: State, anchors: Anchors) -> Self:
        """Make a thinning that continues exactly from a state of `state_dict`.

        anchors: restored before.
        """
        made = cls(anchors)
        made.evaluated = set(state['evaluated'].tolist())
        return made

    def redundant(
        self,
        poses: Array,
        covariance: RelativeCovariance,
        frames: Sequence[int] | None = None,
    ) -> list[int]:
        """Return the keyframes whose anchors may be removed.

        poses (K, 3): of all keyframes; covariance: of relative poses, see LoopSearch.search;
        frames: of each vehicle, in which its poses are. Default: all in one. An anchor may go when
        kept older anchors of the same place show 90 % of its returns and its pose relative to them
        is known to 0.1 m.
        """
        gone: list[int] = []
        removed: set[int] = set()
        newest = {anchor.vehicle: anchor.distance_driven for anchor in self.anchors}
        for anchor in self.anchors:
            is_past = newest[anchor.vehicle] - anchor.distance_driven > _RECENT_DISTANCE
            if not is_past or anchor.keyframe in self.evaluated:
                continue
            self.evaluated.add(anchor.keyframe)
            older = self._older(anchor, poses, removed, frames)
            if older and self._is_known(anchor, older, covariance):
                shown = _share_shown(anchor, older, poses)
                if shown > _OVERLAP:
                    gone.append(anchor.keyframe)
                    removed.add(anchor.keyframe)
        return gone

    def _older(
        self, anchor: Anchor, poses: Array, removed: set[int], frames: Sequence[int] | None
    ) -> list[Anchor]:
        """Return the most similar kept anchors of the same place from another visit."""
        table, vehicle = self.anchors.table(), anchor.vehicle
        offsets = between(poses[anchor.keyframe], poses[table.keyframes])
        same_visit = (table.vehicles == vehicle) & (
            anchor.distance_driven - table.distances_driven < _RECENT_DISTANCE
        )
        chosen = (np.hypot(*offsets[:, :2].T) < _SAME_PLACE) & ~same_visit
        chosen &= table.keyframes < anchor.keyframe
        chosen &= ~np.isin(table.keyframes, list(removed))
        if frames is not None:
            chosen &= np.asarray(frames)[table.vehicles] == frames[vehicle]
        near = np.flatnonzero(chosen)
        squared = (offsets[near, :2] ** 2).sum(axis=1) + (
            _HEADING_DISTANCE * offsets[near, 2]
        ) ** 2
        most = near[np.lexsort((table.keyframes[near], squared))[:_MAXIMUM_OLDER_ANCHORS]]
        return [self.anchors.of_keyframe(keyframe) for keyframe in table.keyframes[most].tolist()]

    def _is_known(
        self, anchor: Anchor, older: list[Anchor], covariance: RelativeCovariance
    ) -> bool:
        keyframes = np.array([other.keyframe for other in older], np.int64)
        P = covariance(anchor.keyframe, keyframes)
        return bool(np.linalg.eigvalsh(P[:, :2, :2])[:, 1].min() < _KNOWN_DEVIATION**2)


def _share_shown(anchor: Anchor, older: list[Anchor], poses: Array) -> float:
    """Return the fraction of an anchor's returns that lie on returns of older anchors."""
    offsets = between(poses[anchor.keyframe], np.array([poses[other.keyframe] for other in older]))
    known = np.concatenate(
        [
            other.cloud.moved(Pose2.from_array(at)).sparse_points
            for other, at in zip(older, offsets, strict=True)
        ]
    )
    points = anchor.cloud.query_points
    if not len(points) or not len(known):
        return 0.0
    distances, _ = cKDTree(known).query(points)
    return float((distances < _ON_SURFACE).mean())
