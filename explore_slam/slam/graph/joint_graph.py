"""The joint graph of the keyframes and landmarks of a team.

Variables are the poses of the keyframes of all vehicles and landmarks; factors are raw
measurements, each exactly once: motion between keyframes, observations of landmarks, relative
poses from loop closing, inter-robot observations. The graph knows nothing of particles: a filter
records what was measured, and asks for joint samples of the path and for landmarks given a path.

A call that raises SlamError leaves the graph unchanged.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from explore_slam.errors import SlamError
from explore_slam.geometry import Array, between, compose, planar_rotation
from explore_slam.slam.checkpoint import State, part, under
from explore_slam.slam.graph import bounding, checks, se2
from explore_slam.slam.graph.config import GraphConfig
from explore_slam.slam.graph.factors import (
    CAUCHY,
    HUBER,
    PRIOR,
    RELATIVE_POSE,
    RELATIVE_POSITION,
    SQUARED,
    Factors,
    Integers,
    squared_norms,
)
from explore_slam.slam.graph.problem import (
    Problem,
    collect,
    landmarks_of,
    move_landmarks,
    take_over,
)
from explore_slam.slam.graph.rows import StoredObservations
from explore_slam.slam.graph.solver import (
    OptimizeSummary,
    PoseSamples,
    Solution,
    optimize,
    posterior_at,
)
from explore_slam.slam.graph.storage import Calibration, Storage
from explore_slam.slam.graph.ties import Component, components

_EXACT = 0.5 * checks.EXACT_DEVIATION**-2.0  # information of what is known exactly, and no less
# m, rad: of exact starts relative to each other, once they may move; smaller ones, over a lever of
# metres, let Gauss-Newton creep. No vehicle is placed more exactly.
_RELATIVE_START = 1e-3


class JointGraph:
    """Keyframe poses of all vehicles, landmarks, and everything that was measured of them.

    Keyframes are numbered by the caller, ascending over all vehicles; landmarks by their ids.
    Poses are (x m, y m, theta rad). Covariances of motions and of relative poses are those of
    their components, in the axes of the first pose; those of poses in the axes of the map.
    """

    def __init__(self, config: GraphConfig | None = None) -> None:
        self.config = config or GraphConfig()
        self._storage = Storage()
        self._posteriors: dict[Component, Solution] = {}
        self._ties: tuple[int, dict[int, Component]] = (-1, {})  # at which number of changes

    def state_dict(self) -> State:
        """Return the whole state as named arrays; see `from_state`."""
        state = under('storage', self._storage.state_dict())
        for number, vehicles in enumerate(self._components(None)):
            solution = self._posteriors.get(vehicles)
            if solution and solution.problem.versions == self._storage.versions_of(vehicles):
                state |= {
                    f'posterior{number}/vehicles': np.array(vehicles, np.int64),
                    f'posterior{number}/linearized_at': solution.linearized_at,
                }
        return state

    @classmethod
    def from_state(cls, state: State, config: GraphConfig | None = None) -> Self:
        """Make a graph that continues exactly from a state of `state_dict`."""
        graph = cls(config)
        graph._storage.restore(part('storage', state))
        for name in state:
            if name.startswith('posterior') and name.endswith('/vehicles'):
                where = state[name.replace('/vehicles', '/linearized_at')]
                vehicles = tuple(state[name].tolist())
                problem = collect(graph._storage, vehicles, graph.config)
                graph._keep(posterior_at(problem, where))
        return graph

    # ---- recording measurements

    def add_start(
        self, vehicle: int, keyframe: int, pose: ArrayLike, covariance: ArrayLike | None = None
    ) -> int:
        """Add the first keyframe of a vehicle; returns the factor of its prior.

        covariance: (3, 3) in the axes of the map. Default: exactly known.
        """
        store = self._storage
        if vehicle in store.newest:
            raise SlamError(f'vehicle {vehicle} has a start already')
        store.check_new(keyframe)
        at = checks.matrix('pose', pose, (3,))
        W = checks.information('covariance', covariance)
        row = store.append_keyframe(vehicle, number=keyframe, pose=at, chain=at)
        return store.add_factor(PRIOR, -1, row, at, W, SQUARED, 1.0)

    def add_calibration(self, vehicle: int, deviations: ArrayLike) -> None:
        """Estimate three calibration parameters of a vehicle's odometry from now on.

        deviations (3,): of their prior, whose mean is zero. What the parameters mean is up to the
        sensitivity of the increments.
        """
        store = self._storage
        if vehicle not in store.newest:
            raise SlamError(f'vehicle {vehicle} has no start')
        spread = _positive('deviations', deviations)
        store.calibrations[vehicle] = Calibration(spread, np.zeros(3))
        store.touch([store.newest[vehicle]])

    def calibration(self, vehicle: int) -> Array:
        """Return the estimated calibration (3,) of a vehicle; zero if it has none."""
        store = self._storage
        if vehicle not in store.newest:
            raise SlamError(f'vehicle {vehicle} is not in the graph')
        return store.calibration_of(store.newest[vehicle]).copy()

    def restart(
        self, vehicle: int, keyframe: int, pose: ArrayLike, covariance: ArrayLike | None = None
    ) -> int:
        """Continue a vehicle's path at a pose unrelated to its previous motion; returns its prior.

        For a vehicle that was relocalized, kidnapped or repositioned.
        covariance: (3, 3) in the axes of the map. Default: exactly known.
        """
        store = self._storage
        if vehicle not in store.newest:
            raise SlamError(f'vehicle {vehicle} has no start')
        store.check_new(keyframe)
        at = checks.matrix('pose', pose, (3,))
        W = checks.information('covariance', covariance)
        row = store.append_keyframe(vehicle, number=keyframe, pose=at, chain=at, connected=False)
        return store.add_factor(PRIOR, -1, row, at, W, SQUARED, 1.0)

    def add_prior(
        self, keyframe: int, pose: ArrayLike, covariance: ArrayLike | None = None
    ) -> int:
        """Add what is known of a pose from elsewhere (survey, operator); returns the factor."""
        row = self._storage.live_row_of(keyframe)
        at = checks.matrix('pose', pose, (3,))
        W = checks.information('covariance', covariance)
        return self._storage.add_factor(PRIOR, -1, row, at, W, SQUARED, 1.0)

    def add_keyframe(
        self,
        vehicle: int,
        keyframe: int,
        increment: ArrayLike,
        covariance: ArrayLike,
        white: ArrayLike | None = None,
        estimate: ArrayLike | None = None,
        sensitivity: ArrayLike | None = None,
    ) -> None:
        """Add a keyframe at the end of a vehicle's path.

        increment (3,): measured motion since the vehicle's previous keyframe, in its frame.
        covariance (3, 3): of the random walk of that motion; zero where it is exact.
        white (3, 3): covariance, in the axes of this keyframe, of an independent error of the
        measured pose that cancels in the next motion, as in scan matching: increments lead from
        measured pose to measured pose, so that successive ones contain the same error with
        opposite signs.
        estimate (3,): initial pose, used until the next optimization.
        Default: where the increment leads.
        sensitivity (3, 3): Jacobian of the increment in the vehicle's calibration; the increment
        is then the one for a calibration of zero. See `add_calibration`.
        """
        store = self._storage
        if vehicle not in store.newest:
            raise SlamError(f'vehicle {vehicle} has no start')
        store.check_new(keyframe)
        u = checks.matrix('increment', increment, (3,))
        P = checks.symmetric('covariance', covariance, 3)
        W = checks.information('covariance', P)
        white_information = (
            np.zeros((3, 3)) if white is None else checks.information('white', white)
        )
        C = np.zeros((3, 3))
        if sensitivity is not None:
            C = checks.matrix('sensitivity', sensitivity, (3, 3))
            if vehicle not in store.calibrations and C.any():
                raise SlamError(f'vehicle {vehicle} has no calibration')
        last = store.newest[vehicle]
        expected = u + C @ store.calibration_of(last)
        pose = np.empty(3)
        se2.compose(store.keyframes['chain'][last], expected, pose)
        if estimate is not None:
            pose[:] = checks.matrix('estimate', estimate, (3,))
        store.append_keyframe(
            vehicle,
            number=keyframe,
            increment=u,
            covariance=P,
            motion=u,
            motion_covariance=P,
            sensitivity=C,
            motion_sensitivity=C,
            motion_information=W,
            has_white=white is not None,
            white_information=white_information,
            pose=pose,
            chain=pose,
        )
        if self.config.graph_bounded:
            bounding.retire_older(store, vehicle, self.config)

    def add_observations(
        self,
        keyframe: int,
        landmarks: ArrayLike,
        z: ArrayLike,
        R: ArrayLike,
        weights: ArrayLike | None = None,
    ) -> None:
        """Add landmarks observed from a keyframe.

        landmarks (n,): ids. z (n, 3): positions in the vehicle frame (m). R (n, 6): covariances
        xx xy xz yy yz zz. weights (n,) in (0, 1]: an observation of weight w counts with R / w.
        """
        store = self._storage
        row = store.live_row_of(keyframe)
        ids = checks.integers('landmarks', landmarks)
        count = len(ids)
        if count == 0:
            return
        places = checks.matrix('z', z, (count, 3))
        W = checks.packed_information('R', R, count)
        weight = np.ones(count) if weights is None else checks.matrix('weights', weights, (count,))
        if not ((weight > 0.0) & (weight <= 1.0)).all():
            raise SlamError(
                f'weights lie in {weight.min():.3g} … {weight.max():.3g}, '
                'expected above 0 and at most 1'
            )
        owners = np.array([store.landmark_row_of(number) for number in ids.tolist()])
        np.add.at(store.landmarks['observation_count'], owners, 1)
        store.observations.append(
            count,
            number=store.next_observation + np.arange(count),
            keyframe=row,
            landmark=owners,
            visit=bounding.count_visits(store, row, ids, self.config.graph_visit_gap),
            z=places,
            W=W * weight[:, None],
            weight=weight,
            robust_weight=1.0,
        )
        store.next_observation += count
        store.touch([row])

    def add_relative_pose(
        self, a: int, b: int, z: ArrayLike, information: ArrayLike, *, robust: bool = True
    ) -> int:
        """Add a measured pose z (3,) of keyframe b in the frame of keyframe a, as of a closure.

        information (3, 3): of the components of z, singular where a direction is free.
        robust: with a Cauchy kernel. Returns the factor, for `remove_factor`.
        """
        i, j = self._ends(a, b)
        measured = checks.matrix('z', z, (3,))
        W = checks.bounded_information('information', information)
        kernel = CAUCHY if robust else SQUARED
        return self._storage.add_factor(
            RELATIVE_POSE, i, j, measured, W, kernel, self.config.closure_scale
        )

    def make_robust(self, factor: int) -> None:
        """Give a relative pose that was added without it the Cauchy kernel."""
        table = self._storage.factors
        row = self._factor_row(factor)
        table['robust'][row], table['scale'][row] = CAUCHY, self.config.closure_scale
        self._storage.touch([int(table[end][row]) for end in ('a', 'b')])

    def add_relative_position(self, a: int, b: int, z: ArrayLike, R: ArrayLike) -> int:
        """Add the position z (2,) of b's vehicle that a's vehicle measured, at these keyframes.

        R (2, 2): covariance; both in the frame of a. Returns the factor.
        """
        i, j = self._ends(a, b)
        measured = np.append(checks.matrix('z', z, (2,)), 0.0)
        W = np.zeros((3, 3))
        W[:2, :2] = checks.information('R', R, 2)
        threshold = self.config.graph_outlier_threshold
        return self._storage.add_factor(RELATIVE_POSITION, i, j, measured, W, HUBER, threshold)

    def remove_factor(self, factor: int) -> None:
        """Remove a factor that one of the methods above returned."""
        store = self._storage
        row = self._factor_row(factor)
        a, b = int(store.factors['a'][row]), int(store.factors['b'][row])
        if a < 0 and not self._has_other_prior(row):
            raise SlamError(f'factor {factor} is the only prior of vehicle {store.vehicle_of(b)}')
        store.factors.keep(store.factors['number'] != factor)
        ends = [end for end in (a, b) if end >= 0]
        store.touch(ends)
        for end in ends:
            bounding.drop_if_free(store, end)

    def drop_factor(self, factor: int) -> None:
        """Drop a relative pose that adds little information; it is not marginalized.

        If its second keyframe is dropped too, that keeps its pose relative to the first.
        """
        factors, keyframes = self._storage.factors, self._storage.keyframes
        row = self._factor_row(factor)
        a, b = int(factors['a'][row]), int(factors['b'][row])
        if 0 <= a < b and keyframes['reference'][b] < 0:
            keyframes['reference'][b] = a
        self.remove_factor(factor)

    def remove_landmarks(self, landmarks: ArrayLike) -> None:
        """Forget landmarks with their observations; ids that are not stored are ignored."""
        store = self._storage
        ids = checks.integers('landmarks', landmarks).tolist()
        rows = np.array(
            [store.landmark_rows[n] for n in ids if n in store.landmark_rows], np.int64
        )
        if len(rows):
            observed = np.isin(store.observations['landmark'], rows)
            store.drop_observations(observed)
            store.forget_landmarks(rows)
            if observed.any():
                store.touch()

    def merge_landmarks(self, old: ArrayLike, into: ArrayLike) -> None:
        """Give the observations of landmarks old (n,) to landmarks into (n,): they are the same.

        Old ids that are not stored are ignored.
        """
        store = self._storage
        sources, targets = checks.integers('old', old), checks.integers('into', into)
        if len(sources) != len(targets):
            raise SlamError(
                f'old has {len(sources)} ids and into {len(targets)}, expected as many'
            )
        both = set(sources.tolist()) & set(targets.tolist())
        if both:
            raise SlamError(f'landmark {min(both)} is to be merged and to be merged into')
        rows = [
            store.merge_landmark(source, target)
            for source, target in zip(sources.tolist(), targets.tolist(), strict=True)
            if source in store.landmark_rows
        ]
        if rows:
            store.forget_landmarks(np.array(rows))
            store.touch()

    def observations_since(self, keyframe: int) -> tuple[Integers, Integers]:
        """Return landmarks (n,) and numbers (n,) of a vehicle's observations from a keyframe on.

        The numbers identify the observations for `move_observations`.
        """
        store, row = self._storage, self._storage.row_of(keyframe)
        table, vehicles = store.observations, store.keyframes['vehicle']
        owners, frames = table['landmark'], table['keyframe']
        later = (owners >= 0) & (frames >= row) & (vehicles[frames] == vehicles[row])
        return store.landmarks['number'][owners[later]], table['number'][later]

    def observation_numbers(self, landmarks: ArrayLike) -> Integers:
        """Return the numbers (n,) of all stored observations of some landmarks, by id."""
        store, ids = self._storage, checks.integers('landmarks', landmarks)
        rows = [store.landmark_rows[n] for n in ids.tolist() if n in store.landmark_rows]
        numbers: Integers = store.observations['number'][
            np.isin(store.observations['landmark'], rows)
        ]
        return numbers

    def observed_landmarks(self, numbers: ArrayLike) -> tuple[Integers, Integers]:
        """Return landmarks (n,) and numbers (n,) of those observations that are still stored."""
        store, wanted = self._storage, checks.integers('numbers', numbers)
        table = store.observations
        stored = np.isin(table['number'], wanted) & (table['landmark'] >= 0)
        return store.landmarks['number'][table['landmark'][stored]], table['number'][stored]

    def move_observations(self, numbers: ArrayLike, into: ArrayLike) -> None:
        """Give observations (n,), by number, to landmarks into (n,): they show something else.

        Landmarks that are left without observations are forgotten; observations that are no longer
        stored are ignored.
        """
        store, table = self._storage, self._storage.observations
        wanted, targets = checks.integers('numbers', numbers), checks.integers('into', into)
        if len(wanted) != len(targets):
            raise SlamError(
                f'numbers has {len(wanted)} elements and into {len(targets)}, expected as many'
            )
        if not len(table) or not len(wanted):
            return
        rows = np.minimum(np.searchsorted(table['number'], wanted), len(table) - 1)
        stored = (table['number'][rows] == wanted) & (table['landmark'][rows] >= 0)
        rows, targets = rows[stored], targets[stored]
        sources = table['landmark'][rows].copy()
        moved_to = np.array(
            [store.landmark_row_of(target) for target in targets.tolist()], np.int64
        )
        table['landmark'][rows] = moved_to
        np.add.at(store.landmarks['observation_count'], moved_to, 1)
        np.subtract.at(store.landmarks['observation_count'], sources, 1)
        frames, visits = table['keyframe'][rows], table['visit'][rows]
        for target, frame, visit in zip(targets.tolist(), frames, visits.tolist(), strict=True):
            key = (target, store.vehicle_of(frame))
            last, count = store.visits.get(key, (-1, 0))
            ordinal = int(store.keyframes['ordinal'][frame])
            store.visits[key] = (max(last, ordinal), max(count, visit))
        store.forget_landmarks(np.setdiff1d(sources, table['landmark']))
        store.touch()

    def move(
        self, vehicles: Iterable[int], frame: ArrayLike, deviations: ArrayLike | None
    ) -> None:
        """Move the paths of vehicles, and the landmarks that they observed, as a rigid body.

        For vehicles whose pose in the map becomes known. frame (3,): pose, in the new frame, of
        their old frame. deviations (3,) m, m, rad: new standard deviations of their priors, which
        tied them to the old frame; None: the priors move along. Vehicles that are tied to them
        must be among them.
        """
        store, members = self._storage, sorted(set(vehicles))
        tied = {other for vehicle in members for other in self._component(vehicle)}
        if tied != set(members):
            raise SlamError(f'vehicles {members} are tied to {sorted(tied - set(members))}')
        at = checks.matrix('frame', frame, (3,))
        W = None
        if deviations is not None:
            W = np.diag(_positive('deviations', deviations) ** -2.0)
        keyframes, factors = store.keyframes, store.factors
        rows = np.isin(keyframes['vehicle'], members)
        for name in ('pose', 'chain'):
            keyframes[name][rows] = compose(at, keyframes[name][rows])
        priors = np.flatnonzero((factors['kind'] == PRIOR) & rows[factors['b']])
        factors['z'][priors] = compose(at, factors['z'][priors])
        turn = planar_rotation(float(at[2]))
        factors['W'][priors] = turn @ factors['W'][priors] @ turn.T if W is None else W
        move_landmarks(store, members, at)
        store.touch([store.newest[vehicle] for vehicle in members])

    def release_starts(self, vehicles: Sequence[int], deviations: ArrayLike) -> None:
        """Let the starts of vehicles move together, because something else fixes the frame.

        Their priors become wide, with deviations (3,) m, m, rad. Starts that were known exactly
        stay where they are relative to each other.
        """
        store, W = self._storage, np.diag(_positive('deviations', deviations) ** -2.0)
        keyframes, factors = store.keyframes, store.factors
        first: int | None = None
        exact = _RELATIVE_START**-2.0 * np.eye(3)
        for vehicle in vehicles:
            start = int(np.flatnonzero(keyframes['vehicle'] == vehicle)[0])
            priors = np.flatnonzero((factors['kind'] == PRIOR) & (factors['b'] == start))
            known = factors['W'][priors]
            if not len(priors) or known[0].diagonal().min() < _EXACT:
                continue
            factors['W'][priors] = W
            if first is not None:
                z = between(keyframes['pose'][first], keyframes['pose'][start])
                store.add_factor(RELATIVE_POSE, first, start, z, exact, SQUARED, 1.0)
            first = start if first is None else first
        store.touch()

    def pin(self, keyframe: int) -> None:
        """Keep a keyframe in the graph until it is unpinned as often as it was pinned.

        Keyframes between which something was measured stay without it.
        """
        self._storage.keyframes['pins'][self._storage.live_row_of(keyframe)] += 1

    def unpin(self, keyframe: int) -> None:
        """Undo a `pin`; a keyframe that is not needed otherwise is then dropped."""
        row = self._storage.row_of(keyframe)
        if self._storage.keyframes['pins'][row] < 1:
            raise SlamError(f'keyframe {keyframe} is not pinned')
        self._storage.keyframes['pins'][row] -= 1
        bounding.drop_if_free(self._storage, row)

    # ---- estimating

    def optimize(self, vehicle: int | None = None) -> OptimizeSummary:
        """Move the estimate of all vehicles, or of those tied to one, to the optimum.

        Vehicles that have nothing in common are optimized apart.
        """
        summaries = []
        for vehicles in self._components(vehicle):
            solution = self.solve(collect(self._storage, vehicles, self.config))
            self.adopt(solution)
            summaries.append(solution.summary)
        return OptimizeSummary.total(summaries)

    def snapshot(self, vehicle: int) -> Problem:
        """Return the problem of a vehicle and those tied to it.

        It shares nothing with the graph: another thread may `solve` it and draw from the solution
        while the graph grows, which then can `adopt` the solution.
        """
        return collect(self._storage, self._component(vehicle), self.config)

    def solve(self, problem: Problem, new_closures: Sequence[int] = ()) -> Solution:
        """Return the optimum of a problem and the posterior there; the graph stays unchanged.

        new_closures: factors of relative poses without a robust kernel; they get one after a
        first optimization, from whose optimum a second one starts.
        """
        most, tolerance = self.config.graph_iterations, self.config.graph_tolerance
        found = optimize(problem, most, tolerance)
        if not new_closures:
            return found
        robust = problem.with_robust(new_closures, self.config.closure_scale)
        start = robust._replace(start=found.nodes)
        return optimize(start, most, tolerance, found.factorization.structure)

    def adopt(self, solution: Solution) -> None:
        """Take over an optimum; keyframes added since then move with their previous one.

        The new closures in it have a robust kernel from now on.
        """
        problem = solution.problem
        is_current = problem.versions == self._storage.versions_of(problem.vehicles)
        take_over(self._storage, problem, solution.nodes)
        numbers = self._storage.factors['number']
        for factor in np.intersect1d(problem.made_robust, numbers).tolist():
            self.make_robust(int(factor))
        if is_current:
            versions = self._storage.versions_of(problem.vehicles)
            problem = problem._replace(versions=versions, made_robust=())
            self._keep(replace(solution, problem=problem))

    def posterior(self, vehicle: int) -> Solution:
        """Return the posterior of a vehicle and those tied to it around the present estimate."""
        vehicles = self._component(vehicle)
        found = self._posteriors.get(vehicles)
        if found is None or found.problem.versions != self._storage.versions_of(vehicles):
            found = self._keep(posterior_at(collect(self._storage, vehicles, self.config)))
        return found

    def _keep(self, solution: Solution) -> Solution:
        """Keep the posterior of some vehicles until they change; return what is kept."""
        kept = replace(solution, problem=solution.problem.without_factors())
        self._posteriors[kept.problem.vehicles] = kept
        return kept

    def draw(
        self, samples: int, random: np.random.Generator, vehicle: int | None = None
    ) -> PoseSamples:
        """Draw joint samples of the live keyframes of all vehicles, or of those tied to one.

        They are drawn around the present estimate: call `optimize` first. See `Solution.draw`.
        """
        drawn = [self.posterior(v[0]).draw(samples, random) for v in self._components(vehicle)]
        if len(drawn) == 1:
            return drawn[0]
        numbers, poses, _, chains = (np.concatenate([d[n] for d in drawn]) for n in range(4))
        order = np.argsort(numbers)
        calibrations = {v: c for part in drawn for v, c in part.calibrations.items()}
        numbers = numbers[order]
        return PoseSamples(numbers, poses[order], numbers, chains[order], calibrations)

    def estimate(self, keyframe: int) -> Array:
        """Return the estimated pose (3,) of a keyframe."""
        pose: Array = self._storage.keyframes['pose'][self._storage.row_of(keyframe)].copy()
        return pose

    def path(self, *, chains: bool = False) -> Array:
        """Return the estimated poses (K, 3) of all keyframes ever added, ascending by number.

        chains: those with the white errors, where the motion ends. Keyframes that were dropped
        stay relative to those with the same landmarks, or are interpolated between others.
        """
        poses: Array = self._storage.keyframes['chain' if chains else 'pose'].copy()
        return poses

    def covariance(self, keyframe: int) -> Array:
        """Return the covariance (3, 3) of a keyframe's pose in the axes of the map."""
        row = self._storage.live_row_of(keyframe)
        return self.posterior(self._storage.vehicle_of(row)).covariance(keyframe)

    def relative_covariance(self, reference: int, others: ArrayLike) -> Array:
        """Return covariances (n, 3, 3) of the poses of keyframes in the frame of a reference.

        They are in the axes of the reference. All keyframes must be tied to the reference.
        """
        row = self._storage.live_row_of(reference)
        numbers = checks.integers('others', others)
        posterior = self.posterior(self._storage.vehicle_of(row))
        return posterior.relative_covariance(reference, numbers)

    def closure_residuals(self) -> tuple[Integers, Array]:
        """Return factors (n,) and the squared Mahalanobis distance (n,) of each at the estimate.

        These are the relative poses and positions, with an expectation of 3 and 2 where they are
        consistent.
        """
        table = self._storage.factors
        closures = np.flatnonzero(table['kind'] != PRIOR)
        factors = Factors.of_rows(table, closures)
        return table['number'][closures], squared_norms(factors, self._storage.keyframes['pose'])

    def vehicles_of(self, keyframes: ArrayLike) -> Integers:
        """Return the vehicles (n,) of keyframes (n,)."""
        numbers = checks.integers('keyframes', keyframes)
        table = self._storage.keyframes
        rows = np.minimum(np.searchsorted(table['number'], numbers), len(table) - 1)
        unknown = numbers[table['number'][rows] != numbers]
        if len(unknown):
            raise SlamError(f'keyframe {unknown[0]} is not in the graph')
        found: Integers = table['vehicle'][rows]
        return found

    def newest_keyframe(self, vehicle: int) -> int:
        """Return the newest keyframe of the vehicles that are tied to one."""
        rows = [self._storage.newest[member] for member in self._component(vehicle)]
        return int(self._storage.keyframes['number'][max(rows)])

    def motion_covariance(self, begin: int, end: int) -> Array:
        """Return the covariance (3, 3), in the axes of the first, of the motion between keyframes.

        They are of the same vehicle.
        """
        table, first = self._storage.keyframes, self._storage.row_of(begin)
        row, rows = self._storage.row_of(end), list[int]()
        while row > first:
            rows.append(row)
            row = int(table['previous'][row])
        rows.reverse()
        mean, covariance = np.zeros(3), np.zeros((3, 3))
        if rows:
            increments = self._storage.calibrated_increments(rows)
            for increment, noise in zip(increments, table['covariance'][rows], strict=True):
                mean, covariance = se2.compound(mean, covariance, increment, noise)
        return covariance

    def live_keyframes(self) -> Integers:
        """Return the numbers (N,) of the keyframes that are variables, ascending."""
        numbers: Integers = self._storage.keyframes['number'][self._storage.keyframes['live']]
        return numbers

    def landmarks(self) -> tuple[Integers, Array]:
        """Return ids (L,) and positions (L, 3) of the landmarks at the last optimum."""
        table = self._storage.landmarks
        placed = table['placed'] & (table['number'] >= 0)
        return table['number'][placed], table['position'][placed]

    def observations_of(self, landmarks: ArrayLike) -> StoredObservations:
        """Return the stored observations of landmarks (L,), in their order; some may have none.

        Outliers weigh as little as they did at the last optimum.
        """
        store = self._storage
        ids = checks.integers('landmarks', landmarks)
        place_of = np.full(len(store.landmarks) + 1, -1)  # the last entry is that of row −1
        numbers = store.landmarks['number']
        order = np.argsort(numbers, kind='stable')
        at = np.minimum(np.searchsorted(numbers[order], ids), max(len(numbers) - 1, 0))
        rows = order[at] if len(numbers) else np.empty(0, np.int64)
        stored = np.flatnonzero(numbers[rows] == ids) if len(numbers) else rows
        place_of[rows[stored]] = stored
        table = store.observations
        places = place_of[table['landmark']]
        rows = np.flatnonzero(places >= 0)
        rows = rows[np.argsort(places[rows], kind='stable')]
        return StoredObservations(
            np.searchsorted(places[rows], np.arange(len(ids) + 1)),
            store.keyframes['number'][table['keyframe'][rows]],
            table['z'][rows],
            table['W'][rows] * table['robust_weight'][rows, None],
        )

    def observations_from(self, vehicles: Iterable[int]) -> tuple[Integers, StoredObservations]:
        """Return ids (L,), ascending, of all landmarks that vehicles observed, as above."""
        rows = landmarks_of(self._storage, list(vehicles))
        ids = np.sort(self._storage.landmarks['number'][rows])
        return ids, self.observations_of(ids)

    def observing_keyframes(self, vehicles: Iterable[int]) -> Integers:
        """Return the numbers (N,), ascending, of keyframes of vehicles that hold observations."""
        keyframes, observations = self._storage.keyframes, self._storage.observations
        holding = np.zeros(len(keyframes), np.bool_)
        holding[observations['keyframe'][observations['landmark'] >= 0]] = True
        numbers: Integers = keyframes['number'][
            holding & np.isin(keyframes['vehicle'], list(vehicles))
        ]
        return numbers

    def tied(self, vehicle: int) -> set[int]:
        """Return the vehicles that measurements connect with a vehicle, itself included."""
        return set(self._component(vehicle))

    def _component(self, vehicle: int) -> Component:
        if vehicle not in self._storage.newest:
            raise SlamError(f'vehicle {vehicle} is not in the graph')
        return self._tied_vehicles()[vehicle]

    def _components(self, vehicle: int | None) -> list[Component]:
        if vehicle is not None:
            return [self._component(vehicle)]
        return sorted(set(self._tied_vehicles().values()))

    def _tied_vehicles(self) -> dict[int, Component]:
        if self._ties[0] != self._storage.changes:
            self._ties = (self._storage.changes, components(self._storage))
        return self._ties[1]

    def _factor_row(self, factor: int) -> int:
        numbers = self._storage.factors['number']
        row = int(np.searchsorted(numbers, factor))
        if row == len(numbers) or numbers[row] != factor:
            raise SlamError(f'factor {factor} is not in the graph')
        return row

    def _ends(self, a: int, b: int) -> tuple[int, int]:
        """Return the rows of the two keyframes of a factor."""
        if a == b:
            raise SlamError(f'keyframe {a} cannot be measured relative to itself')
        return self._storage.live_row_of(a), self._storage.live_row_of(b)

    def _has_other_prior(self, row: int) -> bool:
        """Return whether the vehicle of a prior has another one."""
        factors, vehicle = self._storage.factors, self._storage.keyframes['vehicle']
        own = (factors['a'] < 0) & (vehicle[factors['b']] == vehicle[factors['b'][row]])
        return int(own.sum()) > 1


def _positive(what: str, values: ArrayLike) -> Array:
    """Return positive numbers (3,)."""
    found = checks.matrix(what, values, (3,))
    if not (found > 0.0).all():
        raise SlamError(f'{what} are {found}, expected positive numbers')
    return found
