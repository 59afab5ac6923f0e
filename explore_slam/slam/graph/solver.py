"""Most likely nodes of a problem, and the Gaussian posterior around them.

Levenberg-Marquardt on the robust cost (iteratively reweighted least squares): Gauss-Newton as
long as its steps lower the cost, damped where they do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from explore_slam.errors import SlamError
from explore_slam.geometry import Array, rotated
from explore_slam.slam.graph import cholesky
from explore_slam.slam.graph.factors import (
    Factors,
    Integers,
    antithetic_poses,
    assemble,
    moved,
    steepest_descent,
    total_cost,
)
from explore_slam.slam.graph.ordering import Structure, eliminate
from explore_slam.slam.graph.problem import Problem

# Marquardt's λ, relative to the diagonal: after the first step that raised the cost; what it
# changes by after each step (Marquardt, "An algorithm for least-squares estimation of nonlinear
# parameters", 1963: 10); below the minimum it is zero
FIRST_DAMPING, DAMPING_FACTOR, MINIMUM_DAMPING = 1e-4, 10.0, 1e-7
LARGEST_DAMPING = 1e8
# Chosen by hand; `benchmarks/graph_speed.py` shows what a change does.
# After a step of which no component (m, rad) is larger, the Jacobians are those from before to a
# few percent: further steps are solved with the factor at hand, as long as each promises so much
# less, in squared Mahalanobis distances, than the one before.
SMALL_STEP, CONTRACTION = 0.03, 0.5
ROUNDING = 1e-12  # of the cost: what summing it up may err by
PAIRS_AT_ONCE = 32  # samples that are solved for together, so that they stay in the cache


class OptimizeSummary(NamedTuple):
    """What an optimization did."""

    iterations: int
    converged: bool
    cost_before: float  # sum of robust squared Mahalanobis distances
    cost: float
    keyframes: int
    landmarks: int
    factors: int

    @classmethod
    def total(cls, parts: Sequence['OptimizeSummary']) -> 'OptimizeSummary':
        """Sum up the optimizations of problems that are independent of each other."""
        return cls(
            max((part.iterations for part in parts), default=0),
            all(part.converged for part in parts),
            sum(part.cost_before for part in parts),
            sum(part.cost for part in parts),
            sum(part.keyframes for part in parts),
            sum(part.landmarks for part in parts),
            sum(part.factors for part in parts),
        )


class PoseSamples(NamedTuple):
    """Joint samples of keyframe poses, and of where the motions to keyframes end."""

    keyframes: Integers  # (N,) numbers, ascending
    poses: Array  # (N, 3, M)
    ends: Integers  # (E,) numbers, ascending
    chains: Array  # (E, 3, M) poses with their white errors: where the next increment starts
    calibrations: dict[int, Array]  # (3, M) by vehicle


class Factorization:
    """Cholesky factor of the information matrix of a problem with its nodes at x (N, 3)."""

    def __init__(self, factors: Factors, x: Array, structure: Structure) -> None:
        nodes = len(x)
        self.structure = structure
        self.diagonal = np.empty((nodes, 3, 3))
        self.blocks = np.empty((len(structure.rows), 3, 3))
        self.gradient = np.empty((nodes, 3))
        self.cost: float = assemble(
            factors, x, structure.place, structure.slots, structure.calibration_slots,
            self.diagonal, self.blocks, self.gradient,
        )  # fmt: skip

    def factorize(self, damping: float = 0.0) -> bool:
        """Factorize the assembled system; False where it is not positive definite."""
        for i in range(3):
            self.diagonal[:, i, i] *= 1.0 + damping
        first, rows = self.structure.first, self.structure.rows
        return cholesky.factorize(first, rows, self.diagonal, self.blocks) < 0

    def _parts(self) -> tuple[Integers, Integers, Array, Array]:
        return self.structure.first, self.structure.rows, self.diagonal, self.blocks

    def newton_step(self) -> Array:
        """Return −H⁻¹ g (N, 3) in the order of the system."""
        return self.solve(-self.gradient[:, :, None])[:, :, 0]

    def solve(self, right: Array) -> Array:
        """Return H⁻¹ b for right-hand sides b (N, 3, R) in the order of the system."""
        x = np.array(right, np.float64, order='C')
        everything = np.ones(len(x), np.bool_)
        cholesky.solve_lower(*self._parts(), everything, x)
        cholesky.solve_upper(*self._parts(), everything, x)
        return x

    def cross_covariances(self, nodes: Integers, node: int) -> Array:
        """Return the covariances (n, 3, 3) of nodes (n,) with one node, all by node number."""
        place, source = self.structure.place[nodes], self.structure.place[node]
        x = np.zeros((len(self.diagonal), 3, 3))
        x[source] = np.eye(3)
        cholesky.solve_lower(*self._parts(), self._ancestors(source), x)
        cholesky.solve_upper(*self._parts(), self._ancestors(place), x)
        found: Array = x[place]
        return found

    def _ancestors(self, rows: Integers | int) -> cholesky.Flags:
        """Return (N,) which rows of a solution those at some rows depend on."""
        wanted = np.zeros(len(self.diagonal), np.bool_)
        wanted[rows] = True
        found: cholesky.Flags = cholesky.ancestors(
            self.structure.first, self.structure.rows, wanted
        )
        return found

    @cached_property
    def marginals(self) -> Array:
        """Covariances (N, 3, 3) of all nodes, by node number."""
        found: Array = cholesky.inverse_diagonal(*self._parts())[self.structure.place]
        return found

    def sample(
        self,
        nodes: Integers,
        poses: Array,
        calibrations: Array,
        samples: int,
        random: np.random.Generator,
    ) -> tuple[Array, Array]:
        """Draw some nodes (P,), which are poses, and the last ones, which are calibrations.

        poses (P, 3), calibrations (V, 3): their estimates. Returns samples (P, 3, samples) and
        (V, 3, samples). Only what these nodes depend on is drawn.
        """
        place = self.structure.place[nodes]
        last = self.structure.place[len(self.structure.place) - len(calibrations) :]
        needed = self._ancestors(np.concatenate([place, last]))
        rows = np.flatnonzero(needed)
        out = np.empty((len(poses), 3, samples))
        others = np.repeat(calibrations[:, :, None], samples, axis=2)
        pairs = samples // 2
        for begin in range(0, pairs, PAIRS_AT_ONCE):
            count = min(PAIRS_AT_ONCE, pairs - begin)
            steps = np.zeros((len(needed), 3, count))
            steps[rows] = random.standard_normal((len(rows), 3, count))
            cholesky.solve_upper(*self._parts(), needed, steps)
            antithetic_poses(poses, steps, place, out, 2 * begin)
            others[:, :, 2 * begin : 2 * (begin + count) : 2] += steps[last]
            others[:, :, 2 * begin + 1 : 2 * (begin + count) : 2] -= steps[last]
        out[:, :, 2 * pairs :] = poses[:, :, None]
        return out, others


@dataclass(frozen=True)
class Solution:
    """Optimum of a problem and the posterior there; `JointGraph.adopt` takes it over."""

    problem: Problem
    nodes: Array  # (N, 3) optimum
    linearized_at: Array  # (N, 3) where the information matrix was taken, a tiny step away
    factorization: Factorization
    summary: OptimizeSummary

    def draw(
        self,
        samples: int,
        random: np.random.Generator,
        keyframes: Integers | None = None,
        ends: Integers | None = None,
    ) -> PoseSamples:
        """Draw joint samples of keyframe poses, and of where motions end, from the posterior.

        keyframes (n,), ends (m,): numbers, ascending, of the keyframes that either is wanted of.
        Default: all. What is not wanted takes no time unless something wanted depends on it.

        Samples come in antithetic pairs (2m, 2m + 1), optimum ⊞ ± L⁻ᵀ ε with ε standard normal
        and H = L Lᵀ, so that their mean is the optimum; the last of an odd number is the optimum.
        """
        if samples < 1:
            raise SlamError(f'samples are {samples}, expected 1 or more')
        keyframes = self.problem.keyframes if keyframes is None else keyframes
        ends = keyframes if ends is None else ends
        motion_ends, chained = self._nodes_of(ends), np.isin(ends, self.problem.chains)
        motion_ends[chained] = len(self.problem.keyframes) + np.searchsorted(
            self.problem.chains, ends[chained]
        )
        nodes, rows = np.unique(
            np.concatenate([self._nodes_of(keyframes), motion_ends]), return_inverse=True
        )
        calibrated = self.nodes[self.problem.first_calibration :]
        drawn, others = self.factorization.sample(
            nodes, self.nodes[nodes], calibrated, samples, random
        )
        return PoseSamples(
            keyframes,
            drawn[rows[: len(keyframes)]],
            ends,
            drawn[rows[len(keyframes) :]],
            dict(zip(self.problem.calibrated, others, strict=True)),
        )

    def _nodes_of(self, keyframes: Integers) -> Integers:
        """Return the nodes (n,) of the poses of keyframes (n,)."""
        known = self.problem.keyframes
        nodes = np.minimum(np.searchsorted(known, keyframes), len(known) - 1)
        unknown = keyframes[known[nodes] != keyframes]
        if len(unknown):
            raise SlamError(f'keyframe {unknown[0]} is not in the graph')
        return nodes

    def node_of(self, keyframe: int) -> int:
        """Return the node of a keyframe's pose."""
        return int(self._nodes_of(np.array([keyframe], np.int64))[0])

    def poses_of(self, keyframes: Integers) -> Array:
        """Return the most likely poses (n, 3) of keyframes (n,)."""
        poses: Array = self.nodes[self._nodes_of(keyframes)]
        return poses

    def covariance(self, keyframe: int) -> Array:
        """Return the covariance (3, 3) of a pose (m, m, rad) in the axes of the map."""
        node = self.node_of(keyframe)
        own = self.factorization.cross_covariances(np.array([node]), node)[0]
        return rotated(own, -self.nodes[node, 2])

    def compute_marginals(self) -> None:
        """Compute what `relative_covariance` would otherwise compute when it is first called."""
        _ = self.factorization.marginals

    def relative_covariance(self, reference: int, others: Integers) -> Array:
        """Return covariances (n, 3, 3) of the poses of others in the frame of a reference.

        They are in the axes of the reference, those of the components of the relative pose.
        """
        a = self.node_of(reference)
        b = self._nodes_of(others)
        # relative pose z = a⁻¹ b: its step in the frame of b is δ_b − T δ_a
        theta = self.nodes[b, 2] - self.nodes[a, 2]
        c, s = np.cos(self.nodes[a, 2]), np.sin(self.nodes[a, 2])
        dx, dy = (self.nodes[b, :2] - self.nodes[a, :2]).T
        z = np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)
        c, s = np.cos(theta), np.sin(theta)
        T = np.zeros((len(b), 3, 3))
        T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1], T[:, 2, 2] = c, s, -s, c, 1.0
        T[:, 0, 2] = -c * z[:, 1] + s * z[:, 0]
        T[:, 1, 2] = s * z[:, 1] + c * z[:, 0]
        turned = T.transpose(0, 2, 1)
        cross = self.factorization.cross_covariances(b, a) @ turned  # E[δ_b δ_aᵀ] Tᵀ
        own = T @ self.factorization.marginals[a] @ turned
        total = self.factorization.marginals[b] - cross - cross.transpose(0, 2, 1) + own
        return np.array(
            [rotated(P, -angle) for P, angle in zip(total, theta, strict=True)]
        ).reshape(-1, 3, 3)


def linearized(problem: Problem, structure: Structure, x: Array) -> Factorization:
    """Return the factorization of a problem with its nodes at x (N, 3), without damping."""
    system = Factorization(problem.factors, x, structure)
    if not system.factorize():
        raise SlamError(
            f'the graph of vehicles {problem.vehicles} has no definite information matrix: '
            'some keyframes are not connected to a start pose, or covariances differ too much'
        )
    return system


def optimize(
    problem: Problem, iterations: int, tolerance: float, structure: Structure | None = None
) -> Solution:
    """Minimize the robust cost, starting from the estimate of the problem.

    structure: of the factor, where a problem of the same nodes and factors has been solved.
    The iteration ends when the quadratic model promises less than the tolerance (in squared
    Mahalanobis distances), or after a number of steps. No step is taken that raises the cost.
    """
    factors = problem.factors
    if structure is None:
        structure = eliminate(factors, len(problem.start))
    x = linearized_at = problem.start
    system = Factorization(factors, x, structure)
    before = cost = system.cost
    damping, converged, steps = 0.0, False, 0
    while steps < iterations and damping < LARGEST_DAMPING:
        steps += 1
        definite = system.factorize(damping)
        if definite:
            step = system.newton_step()
            promised = -float((system.gradient * step).sum())
            candidate = moved(x, step, structure.place, problem.poses)
            reached = total_cost(factors, candidate)
        if definite and reached <= cost * (1.0 + ROUNDING):
            converged = promised <= tolerance and damping <= FIRST_DAMPING
            linearized_at, x, cost = x, candidate, reached
            if converged:
                break
            if damping == 0.0 and np.abs(step).max() <= SMALL_STEP:
                x, cost, converged = _refined(problem, system, x, cost, promised, tolerance)
                if converged:
                    break
            damping = damping / DAMPING_FACTOR if damping > MINIMUM_DAMPING else 0.0
        else:
            damping = max(FIRST_DAMPING, damping * DAMPING_FACTOR)
        system = Factorization(factors, x, structure)
    if not converged or damping > 0.0:
        linearized_at, system = x, linearized(problem, structure, x)
    summary = OptimizeSummary(
        steps, converged, before, cost,
        len(problem.keyframes), len(problem.landmarks), len(factors.kind),
    )  # fmt: skip
    return Solution(problem, x, linearized_at, system, summary)


def _refined(
    problem: Problem,
    system: Factorization,
    x: Array,
    cost: float,
    promised: float,
    tolerance: float,
) -> tuple[Array, float, bool]:
    """Approach the optimum with a factor from nearby (chord method).

    promised: what the last step was to lower the cost by. Returns the nodes, their cost, and
    whether the next step would lower it by less than the tolerance.
    """
    right = np.empty_like(x)
    place = system.structure.place
    steepest_descent(problem.factors, x, place, right)
    while True:
        step = system.solve(right[:, :, None])[:, :, 0]
        before, promised = promised, float((right * step).sum())
        if promised > CONTRACTION * before:
            return x, cost, False
        candidate = moved(x, step, place, problem.poses)
        reached = steepest_descent(problem.factors, candidate, place, right)
        if reached > cost * (1.0 + ROUNDING):
            return x, cost, False
        x, cost = candidate, reached
        if promised <= tolerance:
            return x, cost, True


def posterior_at(problem: Problem, x: Array | None = None) -> Solution:
    """Return the posterior around the estimate of a problem without moving it.

    x (N, 3): where to linearize; default: at the estimate.
    """
    where = problem.start if x is None else x
    structure = eliminate(problem.factors, len(problem.start))
    system = linearized(problem, structure, where)
    summary = OptimizeSummary(
        0, False, system.cost, system.cost,
        len(problem.keyframes), len(problem.landmarks), len(problem.factors.kind),
    )  # fmt: skip
    return Solution(problem, problem.start, where, system, summary)
