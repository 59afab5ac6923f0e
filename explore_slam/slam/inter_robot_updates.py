"""Updates with the positions at which vehicles of the team measure each other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from explore_slam.data import InterRobotObservation
from explore_slam.geometry import Array
from explore_slam.slam.particles.resampling import stratified_normals
from explore_slam.slam.posterior.redrawing import PathRedrawer
from explore_slam.slam.storage.ancestry import Index
from explore_slam.slam.team_state import TeamState
from explore_slam.slam.update.inter_robot import condition_on_observation

# Inter-robot observations whose covariance grows by more than this factor repeat the one before:
# they are left out, since each becomes two keyframes of the joint graph that are never dropped.
_REPETITION = 5.0


class InterRobotUpdates:
    """Conditions the poses of two vehicles on what one of them measured of the other."""

    def __init__(self, team: TeamState, redrawer: PathRedrawer) -> None:
        self._team = team
        self._redrawer = redrawer

    def without_repetition(
        self, number: int, target: int, observation: InterRobotObservation
    ) -> InterRobotObservation | None:
        """Return an observation with the covariance that it has as a repetition.

        None if it adds too little to what the same vehicle measured shortly before.
        """
        factor = 1.0
        if self._team.joint is not None:
            factor = self._team.correlation.factor_between(number, target, observation.stamp)
        if factor > _REPETITION:
            return None
        return replace(observation, covariance=factor * observation.covariance)

    def update(self, number: int, target: int, observation: InterRobotObservation) -> None:
        """Update with the position of a target, whose motion has been predicted up to now.

        FloatingPointError if numbers overflow.
        """
        team = self._team
        particles, groups, config = team.particles, team.groups, team.config
        zeros = np.zeros((config.particles, 3))
        target_P = particles.pending[target].end_covariance()
        poses, P = particles.propagate(number, team.random)
        target_poses = particles.predicted(target)

        def condition(poses: Array, theirs: Array, normals: Array) -> tuple[Array, Array]:
            weights = groups.of(number).weights()
            return condition_on_observation(
                (poses, P), (theirs, target_P), observation, config, normals, weights
            )

        def likelihood(orders: Sequence[Index]) -> Array:
            return condition(poses.copy(), target_poses[orders[0]], zeros)[0]

        group, other = groups.of(number), groups.of(target)
        if other is not group:
            arrays, random = particles.arrays, team.random
            poses = poses[groups.merge(group, [other], likelihood, arrays, random)]
            target_poses = particles.predicted(target)
            group = groups.of(number)
        normals = stratified_normals(team.random, config.particles, 3)
        predicted, target_predicted = poses.copy(), target_poses.copy()
        log_likelihoods, remaining = condition(poses, target_poses, normals)
        group.reweight(log_likelihoods)
        particles.place(number, poses, predicted, P)
        particles.place(target, target_poses, target_predicted, target_P, remaining)
        if team.joint is not None:
            seer, seen = (team.joint.keyframe(v, team.estimate(v)[0]) for v in (number, target))
            team.joint.observe_vehicle(seer, seen, observation)
        if team.engine.resamples_before_sampling(group):
            team.resample(group)
        self._redrawer.redraw_if_due(group)
        team.correlation.add_between(number, target, observation.stamp)
