"""Tags in the joint graph: poses that vehicles have measured, and which of them are the same.

Every visit of a tag by a vehicle is a node of its own, so that a visit can be found to be of
another tag, or of another place, without losing a measurement. Nodes of the same tag are tied by a
closure, which can be retracted like any other.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import IDENTITY, Array, Pose2
from explore_slam.slam import checks
from explore_slam.slam.checkpoint import State
from explore_slam.slam.posterior.joint_posterior import JointPosterior, RelativePose
from explore_slam.slam.posterior.loop_constraints import LoopConstraints
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.team_state import TeamState

# m, m, rad: how well two visits of a tag agree beside the errors of their observations: what its
# size, the calibration of the cameras and their mounts add
_SAME = np.array([0.01, 0.01, 0.02])
_UNKNOWN = 1e3  # rad: deviation of a heading that a survey does not give


class TagConstraints:
    """Adds nodes of tags to the joint graph, and ties them to each other and to a survey."""

    def __init__(
        self, team: TeamState, redrawer: PathRedrawer, constraints: LoopConstraints
    ) -> None:
        self._team = team
        self._redrawer = redrawer
        self._constraints = constraints

    @property
    def _joint(self) -> JointPosterior:
        return self._team.required_joint()

    def add(self, keyframe: int, pose: Pose2) -> int:
        """Add a node for a tag seen at a pose from a keyframe of the path; return the node."""
        self._redrawer.complete_pending()
        return self._joint.add_tag(self._constraints.node_of(keyframe), pose)

    def observe(self, node: int, keyframe: int, pose: Pose2, information: Array) -> int:
        """Record the pose of a tag in the frame of a keyframe of the path; return its factor.

        information (3, 3): singular where the heading is unknown. The keyframe must be pinned.
        """
        self._redrawer.complete_pending()
        return self._joint.observe_tag(
            self._constraints.node_of(keyframe), node, pose, information
        )

    def drop(self, factor: int) -> None:
        """Drop an observation that others of the same visit make superfluous."""
        self._redrawer.complete_pending()
        self._joint.graph.drop_factor(factor)

    def redraw_if_off(self, node: int, keyframe: int, pose: Pose2, information: Array) -> bool:
        """Redraw the paths if an observation just recorded differs from what was expected.

        See LoopConstraints.close; return whether a redraw was begun.
        """
        measured = RelativePose(self._constraints.node_of(keyframe), node, pose, information)
        if not self._joint.is_closure_due([measured]):
            return False
        return self._redrawer.redraw_soon(self._joint.vehicles_at([node]))

    def tie(self, pairs: Sequence[tuple[int, int]]) -> list[int]:
        """Record that nodes (a, b) are of the same tag; return a factor for each pair."""
        return self._constraints.close_nodes([same_tag(a, b) for a, b in pairs])

    def retract(self, factor: int) -> None:
        """Undo a `tie` that has turned out to be wrong."""
        self._constraints.retract(factor)

    def join(
        self,
        number: int,
        frame: Pose2,
        pairs: Sequence[tuple[int, int]],
        surveyed: Mapping[int, tuple[Array, Array]],
    ) -> list[int]:
        """Take a vehicle of unknown start into the map by tags that are known in both.

        frame: pose of the vehicle's frame in the map. pairs: nodes of the same tags, see `tie`.
        surveyed: poses of nodes of the vehicle, if the map is in the frame of a survey; see
        `survey`.
        """
        team, joint = self._team, self._joint
        if number not in team.unlocalized:
            raise SlamError(f'{team.vehicles[number]!r} is in the map already')
        at = checks.check_pose('frame', frame)
        self._redrawer.complete_pending()
        saved = _copy(joint.state_dict())
        joint.move([number], at)
        team.unlocalized.remove(number)
        try:
            if surveyed:
                self.survey(surveyed, None)
            return self.tie(pairs) if pairs else []
        except SlamError:
            joint.restore(saved)
            team.unlocalized.add(number)
            raise

    def survey(self, poses: Mapping[int, tuple[Array, Array]], frame: Pose2 | None) -> None:
        """Tie nodes of tags to their surveyed poses, and redraw all paths in the map.

        poses: node -> pose (3,), NaN for an unknown heading, and deviations (3,). frame: pose of
        the map's frame so far in that of the survey; None: the map is in that frame already.
        """
        team, joint = self._team, self._joint
        self._redrawer.complete_pending()
        saved = _copy(joint.state_dict())
        inside = [n for n in range(len(team.vehicles)) if n not in team.unlocalized]
        if frame is not None:
            joint.move_map(inside, checks.check_pose('frame', frame))
        for node, (pose, deviations) in poses.items():
            known = np.isfinite(pose)
            at = np.where(known, pose, joint.graph.estimate(node))
            spread = np.where(known, deviations, _UNKNOWN)
            joint.graph.add_prior(node, at, np.diag(spread**2))
        replacement = self._redrawer.draw(inside)
        if replacement is None:
            joint.restore(saved)
            raise SlamError('with the surveyed tags the joint graph has no definite optimum')
        self._redrawer.replace_particles(replacement)

    def pose(self, node: int) -> Array:
        """Return the estimated pose (3,) of a tag, in the frame of those who have seen it."""
        return self._joint.graph.estimate(node)

    def covariance(self, node: int) -> Array:
        """Return the covariance (3, 3) of the pose of a tag, in the axes of that frame."""
        return self._joint.graph.covariance(node)

    def relative_covariance(self, node: int, other: int) -> Array:
        """Return the covariance (3, 3) of the pose of one tag in the frame of another."""
        found: Array = self._joint.relative_covariance(node, np.array([other]))[0]
        return found


def same_tag(a: int, b: int) -> RelativePose:
    """Return the closure which says that two nodes are of the same tag."""
    return RelativePose(a, b, IDENTITY, np.diag(_SAME**-2.0))


def _copy(state: State) -> State:
    return {name: np.array(value) for name, value in state.items()}
