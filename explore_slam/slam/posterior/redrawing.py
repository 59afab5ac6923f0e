"""Redraw: replace the paths of all particles by samples of the joint posterior.

Sampling from a large graph takes longer than an update may. It then runs in another thread, and
the samples replace the particles before the next update. They are not taken any later, because
they would lack the updates made in between and be overconfident.
"""

import logging
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.slam.association.state import MAJORITY, AssociationState
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.resampling import normalized
from explore_slam.slam.posterior.joint_posterior import (
    ParticleReplacement,
    PosteriorSamples,
    Snapshot,
)
from explore_slam.slam.team_state import TeamState
from explore_slam.slam.update.engine import PoseProposal

logger = logging.getLogger(__name__)

# Part of the observations with a distinctive descriptor that may lie outside of all gates before
# the observations contradict the particles: well above the few percent of outliers in MR.CLAM 6
# and TUM fr1_rpy.
_CONTRADICTED_FRACTION = 0.3


class _PendingRedraw(NamedTuple):
    """A redraw that another thread is sampling for."""

    snapshot: Snapshot
    samples: Future[list[PosteriorSamples]]


@cache
def _executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix='redraw')


class PathRedrawer:
    """Decides when a redraw is due, and does it; without a joint graph, none is ever due."""

    def __init__(self, team: TeamState) -> None:
        self._team = team
        self._pending: _PendingRedraw | None = None

    def is_contradicted(
        self, number: int, association: AssociationState, proposal: PoseProposal
    ) -> bool:
        """Return whether observations contradict particles that have an error in common.

        Particles with few ancestors share the error of these. When a loop is closed, very few of
        them then explain the observations, or the landmarks lie outside of all gates. Samples of
        the joint posterior cover that error.
        """
        joint, config = self._team.joint, self._team.config
        group = self._team.groups.of(number)
        if joint is None or joint.is_fresh(group):
            return False
        least = config.redraw_effective * config.particles
        if proposal.effective_particles(group.log_weights) < least:
            return True
        weights = normalized(group.log_weights + proposal.log_likelihoods)[1]
        associated = association.support(weights).sum(axis=1) > MAJORITY
        distinctive = association.found.is_distinctive
        missed = np.count_nonzero(distinctive & ~associated)
        return bool(missed > _CONTRADICTED_FRACTION * np.count_nonzero(distinctive))

    def redraw_if_due(self, group: Group) -> bool:
        """Redraw the paths of a group if it no longer represents the posterior; see `redraw_soon`.

        Returns whether the paths have been redrawn already.
        """
        joint = self._team.joint
        if joint is None or not joint.is_due(group):
            return False
        return self.redraw_soon(group.vehicles) and self._pending is None

    def redraw_soon(self, vehicles: Iterable[int]) -> bool:
        """Redraw the paths of vehicles and all that are connected with them, without a long wait.

        A small graph is sampled at once. A large one is sampled in another thread while the caller
        continues; `complete_pending`, at the next update, waits for the samples and takes them.
        Only motion is recorded in between, whatever the speed of the threads, so that no update
        has to be repeated and the same calls give the same results.

        Returns False if the graph has no definite optimum; of a large graph this is not known yet.
        """
        joint = self._team.required_joint()
        snapshot = joint.snapshot(self._tied(vehicles))
        if snapshot.factors > self._team.config.async_redraw_threshold:
            random = np.random.default_rng(self._team.random.integers(0, 2**63, 2))
            draw = partial(joint.draw, snapshot, random, with_marginals=True)
            self._pending = _PendingRedraw(snapshot, _executor().submit(draw))
            return True
        new = self._sampled(snapshot)
        if new is None:
            return False
        self.replace_particles(new)
        return True

    def complete_pending(self) -> bool:
        """Complete a redraw that runs in another thread; return whether there was one.

        Must be called before anything other than motion changes the joint graph.
        """
        pending, self._pending = self._pending, None
        joint = self._team.joint
        if pending is None or joint is None:
            return False
        try:
            sampled = pending.samples.result()
        except SlamError as error:
            names = ', '.join(self._team.vehicles[v] for v in pending.snapshot.vehicles)
            logger.warning('paths of %s are not drawn anew: %s', names, error)
            return False
        self.replace_particles(joint.adopt(pending.snapshot, sampled))
        return True

    def draw(self, vehicles: Iterable[int]) -> ParticleReplacement | None:
        """Return samples for vehicles and all that are connected with them.

        None if the graph has no definite optimum, because covariances differ by too many orders of
        magnitude; the present particles then remain.
        """
        joint = self._team.joint
        return None if joint is None else self._sampled(joint.snapshot(self._tied(vehicles)))

    def _sampled(self, snapshot: Snapshot) -> ParticleReplacement | None:
        joint, random = self._team.required_joint(), self._team.random
        before = random.bit_generator.state
        try:
            return joint.adopt(snapshot, joint.draw(snapshot, random))
        except SlamError:
            random.bit_generator.state = before
            return None

    def _tied(self, vehicles: Iterable[int]) -> list[int]:
        """Return vehicles and all that groups or measurements tie to them, ascending."""
        joint, groups = self._team.required_joint(), self._team.groups
        members, found = set[int](), set(vehicles)
        while found != members:
            members = found
            found = {v for n in members for v in groups.of(n).vehicles}
            found |= {v for n in members for v in joint.vehicles_tied(n)}
        return sorted(members)

    def replace_particles(self, new: ParticleReplacement) -> None:
        """Replace the particles of some vehicles by samples of the joint posterior.

        The rows of their landmarks are fused from the stored observations on next use. Landmarks
        without stored observations are removed.
        """
        landmarks, groups = self._team.map, self._team.groups
        old = [groups.of(number) for number in new.vehicles]
        mine = landmarks.entries_of(old)
        known = np.isin(landmarks.ids[mine], new.ids)
        if self._team.joint is not None:
            self._team.joint.graph.remove_landmarks(landmarks.ids[mine[~known]])
        landmarks.remove(mine[~known])
        kept = mine[known]
        places = np.searchsorted(new.ids, landmarks.ids[kept])
        landmarks.defer(kept, new.samples.number, new.positions[places])
        group = Group(new.vehicles, self._team.config.particles)
        group.samples = [new.samples]
        groups.replace(group)
        particles = self._team.particles
        for number in new.vehicles:
            if number in new.calibrations:
                particles.calibrations[number] = new.calibrations[number]
            particles.take(
                number,
                new.poses[number],
                new.chains[number],
                new.pending[number],
                moved=new.moved[number],
            )
