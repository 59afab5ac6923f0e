"""Join vehicles of unknown start, which are filtered in frames of their own, to the map."""

import math
from collections.abc import Sequence

import numpy as np

from explore_slam.data import LandmarkObservations
from explore_slam.errors import SlamError
from explore_slam.geometry import Array, Pose2
from explore_slam.slam import checks
from explore_slam.slam.association.candidates import find_candidates
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.posterior.joint_posterior import RelativePose
from explore_slam.slam.posterior.loop_constraints import LoopConstraints
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.relocalization.landmark_join import LandmarkJoin
from explore_slam.slam.team_state import TeamState


class Joining:
    """Joins vehicles to the map by closures, by landmarks or at a given pose."""

    def __init__(
        self, team: TeamState, redrawer: PathRedrawer, constraints: LoopConstraints
    ) -> None:
        self._team = team
        self._redrawer = redrawer
        self._constraints = constraints
        config = team.config.relocalization
        self._finders = {number: LandmarkJoin(config) for number in sorted(team.unlocalized)}

    def predict(self, number: int, increment: Pose2) -> None:
        """Propagate a vehicle by an odometry increment."""
        if number in self._team.unlocalized:
            self._finders[number].predict(increment)

    def by_closures(
        self, number: int, frame: Pose2, closures: Sequence[RelativePose]
    ) -> list[int]:
        """Join a vehicle that closures tie to the map; see FastSlam.join."""
        team, joint = self._team, self._team.required_joint()
        name = team.vehicles[number]
        if number not in team.unlocalized:
            raise SlamError(f'{name!r} is in the map already')
        at = checks.check_pose('frame', frame)
        ends = [self._constraints.node_of(k) for c in closures for k in (c.reference, c.keyframe)]
        tied = set(joint.graph.vehicles_of(ends).tolist()) if ends else set()
        if number not in tied or tied & (team.unlocalized - {number}) or len(tied) < 2:
            names = [team.vehicles[other] for other in sorted(tied)]
            raise SlamError(f'closures tie {names}, expected {name!r} and vehicles in the map')
        self._redrawer.complete_pending()
        saved = {name: np.array(value) for name, value in joint.state_dict().items()}
        joint.move([number], at)
        team.unlocalized.remove(number)
        try:
            return self._constraints.close(closures)
        except SlamError:
            joint.restore(saved)
            team.unlocalized.add(number)
            raise

    def by_landmarks(self, number: int, observations: LandmarkObservations) -> bool:
        """Join a vehicle by landmarks of the map that it observes; return whether it joined."""
        team = self._team
        config = team.config
        if number not in team.unlocalized or not config.relocalization.relocalization:
            return False
        hidden = team.hidden_landmarks(number)
        estimate, P = team.estimate(number)
        own = None if hidden is None else ~hidden
        found = find_candidates(
            team.map, observations, config.association, estimate, P, math.inf, own
        )
        finder, R = self._finders[number], found.measured.R
        deviations = np.sqrt(0.5 * (R[:, 0] + R[:, 3]))
        similar = np.where(found.is_distinctive[:, None], found.similar_ids, -1)
        finder.add(found.observed.z, deviations, similar)
        positions = team.map.positions(finder.similar_ids(), team.best_particles(), team.groups)
        pose = finder.search(positions, estimate, team.random)
        if pose is None:
            return False
        deviation = np.array([pose.position_deviation] * 2 + [pose.heading_deviation])
        try:
            self.at_pose(number, pose.pose, np.diag(deviation**2))
        except SlamError:
            return False
        return True

    def at_pose(self, number: int, pose: Pose2, covariance: Array) -> None:
        """Join a vehicle whose current pose in the map is known with a covariance (3, 3)."""
        team, joint = self._team, self._team.required_joint()
        self._redrawer.complete_pending()
        estimate = team.estimate(number)[0]
        saved = {name: np.array(value) for name, value in joint.state_dict().items()}
        keyframe = joint.keyframe(number, estimate)
        joint.move([number], pose.compose(estimate.inverse()))
        joint.measure_pose(keyframe, pose, covariance)
        replacement = self._redrawer.draw([number])
        if replacement is None:
            joint.restore(saved)
            raise SlamError(f'at {pose} the joint graph has no definite optimum')
        team.unlocalized.remove(number)
        self._redrawer.replace_particles(replacement)
        team.has_motion[number] = True

    def state_dict(self) -> State:
        """Return the matches of the unlocalized vehicles with landmarks of the map."""
        state: State = {}
        for number in self._team.unlocalized:
            state |= under(f'finder{number}', self._finders[number].state_dict())
        return state

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned, for the unlocalized vehicles."""
        for number in self._team.unlocalized:
            self._finders[number] = LandmarkJoin(self._team.config.relocalization)
            self._finders[number].restore(part(f'finder{number}', state))
