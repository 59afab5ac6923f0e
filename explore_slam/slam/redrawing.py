"""When the paths are drawn anew from the joint posterior, and what the particles take over.

Drawing from a large graph takes longer than an update may. It then runs in another thread, and its
samples replace the particles before the next update. Samples that lacked updates would have to be
updated again: taken two keyframes late, they had a NEES of 5.1 where 3 is right (design study).
"""

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import NamedTuple

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.slam.association.state import MAJORITY, AssociationState
from explore_slam.slam.joint_posterior import Drawn, Redraw, Snapshot
from explore_slam.slam.particles.group import Group
from explore_slam.slam.particles.resampling import normalized
from explore_slam.slam.team_state import TeamState
from explore_slam.slam.update.engine import PoseProposal

# Part of the observations with a distinctive descriptor that may lie outside of all gates before
# the particles are taken as contradicted: outliers are a few percent (MR.CLAM 6, TUM fr1_rpy).
_CONTRADICTED = 0.3


class _Flight(NamedTuple):
    """Samples that another thread draws."""

    snapshot: Snapshot
    drawn: Future[list[Drawn]]


@cache
def _executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix='redraw')


class Redrawing:
    """Replaces particles by samples of the joint posterior; without one, nothing is ever due."""

    def __init__(self, team: TeamState) -> None:
        self._team = team
        self._flight: _Flight | None = None

    def is_contradicted(
        self, number: int, association: AssociationState, proposal: PoseProposal
    ) -> bool:
        """Return whether observations contradict particles that have a common error.

        Particles of few ancestors share whatever error these had: when a loop is closed, hardly
        any of them fits, or the landmarks lie outside of all gates. Samples of the joint posterior
        contain that error.
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
        return bool(missed > _CONTRADICTED * np.count_nonzero(distinctive))

    def redraw_if_due(self, group: Group) -> bool:
        """Redraw the paths of a group if it no longer represents the posterior.

        A small graph is drawn from at once. A large one is drawn from in another thread while the
        caller goes on; `settle`, at the next update, waits for the samples and takes them. Nothing
        but motion happens in between, whatever the threads do, so that nothing has to be repeated
        and the same calls give the same results. Return whether the paths have been redrawn.
        """
        joint = self._team.joint
        if joint is None or not joint.is_due(group):
            return False
        snapshot = joint.snapshot(self._tied(group.vehicles))
        if snapshot.factors > self._team.config.redraw_beside:
            random = np.random.default_rng(self._team.random.integers(0, 2**63, 2))
            self._flight = _Flight(snapshot, _executor().submit(joint.draw, snapshot, random))
            return False
        redraw = self._drawn(snapshot)
        if redraw is None:
            return False
        self.take(redraw)
        return True

    def settle(self) -> bool:
        """Take the samples that another thread draws, if it does; return whether there are any.

        Must be called before anything but motion changes what is known of the paths.
        """
        flight, self._flight = self._flight, None
        joint = self._team.joint
        if flight is None or joint is None:
            return False
        try:
            drawn = flight.drawn.result()
        except SlamError:
            return False
        self.take(joint.adopt(flight.snapshot, drawn))
        return True

    def draw(self, vehicles: Iterable[int]) -> Redraw | None:
        """Return samples of vehicles and of all that are connected with them.

        None if the graph has no definite optimum, because covariances differ by too many orders of
        magnitude; the particles that there are then go on.
        """
        joint = self._team.joint
        return None if joint is None else self._drawn(joint.snapshot(self._tied(vehicles)))

    def _drawn(self, snapshot: Snapshot) -> Redraw | None:
        joint, random = self._team.required_joint(), self._team.random
        before = random.bit_generator.state
        try:
            return joint.adopt(snapshot, joint.draw(snapshot, random))
        except SlamError:
            random.bit_generator.state = before
            return None

    def _tied(self, vehicles: Iterable[int]) -> list[int]:
        """Return vehicles and all that groups or measurements connect with them, ascending."""
        joint, groups = self._team.required_joint(), self._team.groups
        members, found = set[int](), set(vehicles)
        while found != members:
            members = found
            found = {v for n in members for v in groups.of(n).vehicles}
            found |= {v for n in members for v in joint.graph.tied(n)}
        return sorted(members)

    def take(self, redraw: Redraw) -> None:
        """Replace the particles of some vehicles by samples.

        The rows of their landmarks are fused from the stored observations when they are next
        needed. Landmarks of which no observation is stored are removed.
        """
        landmarks, groups = self._team.map, self._team.groups
        old = [groups.of(number) for number in redraw.vehicles]
        mine = landmarks.entries_of(old)
        known = np.isin(landmarks.ids[mine], redraw.ids)
        if self._team.joint is not None:
            self._team.joint.graph.remove_landmarks(landmarks.ids[mine[~known]])
        landmarks.remove(mine[~known])
        kept = mine[known]
        places = np.searchsorted(redraw.ids, landmarks.ids[kept])
        landmarks.defer(kept, redraw.samples.number, redraw.positions[places])
        group = Group(redraw.vehicles, self._team.config.particles)
        group.samples = [redraw.samples]
        groups.replace(group)
        particles = self._team.particles
        for number in redraw.vehicles:
            if number in redraw.calibrations:
                particles.calibrations[number] = redraw.calibrations[number]
            particles.take(
                number,
                redraw.poses[number],
                redraw.chains[number],
                redraw.pending[number],
                moved=redraw.moved[number],
            )
