"""Relative poses of keyframes, as loop closing measures them, in the joint graph of the filter."""

from collections.abc import Sequence

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import Array
from explore_slam.slam.posterior.joint_posterior import RelativePose
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.storage.row_format import Places
from explore_slam.slam.team_state import TeamState


class LoopConstraints:
    """Closures between keyframes of the path, by their numbers there."""

    def __init__(self, team: TeamState, redrawer: PathRedrawer) -> None:
        self._team = team
        self._redrawer = redrawer

    def node_of(self, keyframe: int) -> int:
        """Return the number of a keyframe in the joint graph."""
        path = self._team.path
        if not 0 <= keyframe < len(path):
            raise SlamError(f'keyframe is {keyframe}, expected 0 … {len(path) - 1}')
        return path.nodes[keyframe]

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe, so that closures can be measured relative to it."""
        self._team.required_joint().pin(self.node_of(keyframe))

    def unpin(self, keyframe: int) -> None:
        """Undo a `pin`."""
        self._redrawer.complete_pending()
        self._team.required_joint().unpin(self.node_of(keyframe))

    def close(self, closures: Sequence[RelativePose]) -> list[int]:
        """Record closures; return a number for each. See FastSlam.close_loops."""
        return self.close_nodes(
            [
                closure._replace(
                    reference=self.node_of(closure.reference),
                    keyframe=self.node_of(closure.keyframe),
                )
                for closure in closures
            ]
        )

    def close_nodes(self, measured: Sequence[RelativePose]) -> list[int]:
        """Record closures between nodes of the graph, keyframes or tags; see `close`."""
        joint, groups = self._team.required_joint(), self._team.groups
        ends = [joint.vehicles_at([c.reference, c.keyframe]) for c in measured]
        self._redrawer.complete_pending()
        merges = any(groups.of(v) is not groups.of(pair[0]) for pair in ends for v in pair)
        factors: list[int] = []
        try:
            factors.extend(joint.close(closure) for closure in measured)
        except SlamError:
            for factor in factors:
                joint.retract_closure(factor)
            raise
        vehicles = [vehicle for pair in ends for vehicle in pair]
        if merges:
            replacement = self._redrawer.draw(vehicles)
            if replacement is not None:
                self._redrawer.replace_particles(replacement)
            drawn = replacement is not None
        else:
            drawn = not joint.is_closure_due(measured) or self._redrawer.redraw_soon(vehicles)
        if not drawn:
            for factor in factors:
                joint.retract_closure(factor)
            raise SlamError('with these closures the joint graph has no definite optimum')
        return factors

    def retract(self, number: int) -> None:
        """Remove a closure that has turned out to be wrong."""
        self._redrawer.complete_pending()
        self._team.required_joint().retract_closure(number)

    def drop(self, number: int) -> None:
        """Drop a closure that repeats others; the path stays where it is."""
        self._redrawer.complete_pending()
        self._team.required_joint().drop_closure(number)

    def distances(self) -> dict[int, float]:
        """Return the squared Mahalanobis distance of every closure from the path, by number."""
        return self._team.required_joint().closure_distances()

    def relative_covariance(
        self, reference: int, keyframes: Places, *, keep: bool = True
    ) -> Array:
        """Return covariances (n, 3, 3) of keyframes' poses in the frame of a reference."""
        nodes = np.array(self._team.path.nodes, np.int64)
        joint = self._team.required_joint()
        return joint.relative_covariance(self.node_of(reference), nodes[keyframes], keep=keep)
