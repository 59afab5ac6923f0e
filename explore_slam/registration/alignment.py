"""Point-to-line alignment of a cloud with a surface map (PLICP; Censi, ICRA 2008)."""

import math
from dataclasses import dataclass, replace

import numpy as np

from explore_slam.compiled import kernel
from explore_slam.errors import RegistrationError
from explore_slam.geometry import Array, Pose2
from explore_slam.registration.angles import wrapped
from explore_slam.registration.surface_map import SurfaceMap, nearest_element

# Where no other source is given, values were chosen on the Intel, ACES and Belgioioso logs;
# `benchmarks/laser_graph_slam.py` shows what a change does.
_ITERATIONS = 25  # at most; usually below ten
_CONVERGED_STEP = 1e-4  # m and rad (summed): a step below this ends the search
_REACH_SHRINKS = 0.7  # per iteration
_MINIMUM_REACH = 0.15  # m
_CAUCHY = 0.05  # m, scale of the robust weight
_MAXIMUM_RESIDUAL = 0.2  # m, in the root mean square
_MINIMUM_COSINE = 0.7  # minimum cosine between the normals of a return and of its surface
_MINIMUM_RETURNS = 15  # returns with a partner: five times the unknowns
MINIMUM_DEVIATION = 0.005  # m, of a return; above it, that of the residuals
# Beams over which errors of neighbours are correlated: those of real walls, which are uneven, up
# to 15 beams (autocorrelation of the residuals on the Intel log), simulated ones hardly.
_CORRELATED_BEAMS = 20
_MINIMUM_INDEPENDENT_FRACTION = 0.05  # of the returns that is independent
# rad, standard deviation of a fitted normal: without it a featureless corridor seems to hold
# information along its axis, which is nothing but noise of the normals.
NORMAL_DEVIATION = 0.05
# Ratio of the information along the weakest direction to that across it, below which what is
# measured along it is noise: in simulated corridors without features noise gives up to 0.011
# (test_alignment), their end wall of 2 m, 6 m away, 0.044.
OPEN_DIRECTION = 0.02
_KEPT_DEVIATION = 1e-4  # m, from the prior in a direction in which nothing is measured


@dataclass(frozen=True)
class Prior:
    """Gaussian prior of the pose; information (3, 3) in the frame of the vehicle."""

    pose: Pose2
    information: Array


@dataclass(frozen=True)
class Alignment:
    """Result of an alignment.

    information (3, 3): of the geometry alone (no prior), in the vehicle frame at the pose;
    overlap: fraction of the returns that have a surface within reach; rms (m): of their distances;
    matched: their number; independent: fraction of their errors that is independent.
    """

    pose: Pose2
    information: Array
    overlap: float
    rms: float
    matched: int
    independent: float

    def weakest_direction(self) -> tuple[Array, float]:
        """Return the least certain direction (2,) in the vehicle frame and its deviation (m).

        In a corridor it is the axis. The deviation is infinite where nothing was measured.
        """
        values, vectors = np.linalg.eigh(_translation_information(self.information))
        least = float(values[0])
        return vectors[:, 0], 1.0 / math.sqrt(least) if least > 0.0 else math.inf


def _translation_information(information: Array) -> Array:
    """Return the marginal information (2, 2) of the translation."""
    turn = information[2, 2]
    if turn <= 0.0:
        return information[:2, :2]
    across = information[:2, 2]
    marginal: Array = information[:2, :2] - np.outer(across, across) / turn
    return marginal


def open_direction(found: Alignment) -> Array | None:
    """Return the direction (2,) in the vehicle frame that an alignment has left open, or None."""
    values = np.linalg.eigvalsh(_translation_information(found.information))
    return None if values[0] > OPEN_DIRECTION * values[1] else found.weakest_direction()[0]


def keeping_prior(found: Alignment, prior: Prior, direction: Array) -> tuple[Pose2, Prior]:
    """Return start and prior of an alignment that measures nothing in a direction (2,).

    In that direction the pose is that of the prior ("solution remapping"; Zhang, Kaess and Singh,
    "On degeneracy of optimization-based state estimation problems", ICRA 2016). Across it the
    alignment decides anew, since noise turns the direction a little.
    """
    off = found.pose.between(prior.pose)
    along = float(direction @ (off.x, off.y))
    start = found.pose.compose(Pose2(along * direction[0], along * direction[1], 0.0))
    information = prior.information.copy()
    information[:2, :2] += np.outer(direction, direction) / _KEPT_DEVIATION**2
    return start, Prior(prior.pose, information)


def without_direction(found: Alignment, direction: Array) -> Alignment:
    """Return an alignment that says nothing of a direction (2,) in the vehicle frame."""
    across = np.eye(3)
    across[:2, :2] -= np.outer(direction, direction)
    return replace(found, information=across @ found.information @ across)


def align(
    surface: SurfaceMap,
    points: Array,
    normals: Array,
    weights: Array,
    start: Pose2,
    reach: float,
    prior: Prior | None = None,
) -> Alignment | None:
    """Return the pose of points (n, 2) with normals (n, 2) at which they lie on the surfaces.

    weights (n,): of the points, from 0 to 1.

    reach (m): farthest surface of a return at first; it shrinks to 0.15 m. With a prior, what
    the geometry leaves open stays as the prior has it. None if fewer than 15 returns match.
    """
    if not start.is_finite() or not reach > 0.0:
        raise RegistrationError(f'start is {tuple(start)} and reach {reach}, expected finite > 0')
    if len(points) < _MINIMUM_RETURNS or not len(surface.points):
        return None
    at, information = start if prior is None else prior.pose, np.zeros((3, 3))
    if prior is not None:
        information = prior.information
        if information.shape != (3, 3) or not np.isfinite(information).all():
            raise RegistrationError('prior information is not a finite matrix of shape (3, 3)')
    pose, hessian, matched, rms, independent = _iterate(
        surface,
        points,
        normals,
        weights,
        (start.x, start.y, start.theta),
        reach,
        (at.x, at.y, at.theta),
        information,
    )
    if matched < _MINIMUM_RETURNS:
        return None
    share = matched / len(points)
    return Alignment(Pose2.from_array(pose), hessian, share, rms, int(matched), independent)


@kernel
def _iterate(
    surface: SurfaceMap,
    points: Array,
    normals: Array,
    weights: Array,
    start: tuple[float, float, float],
    reach: float,
    prior: tuple[float, float, float],
    prior_information: Array,
) -> tuple[Array, Array, int, float, float]:
    """Gauss-Newton over the pose error in the vehicle frame, with matches anew in every step."""
    pose = np.array(start)
    information, matched, rms, independent = np.zeros((3, 3)), 0, 0.0, 1.0
    for _ in range(_ITERATIONS):
        A, b, rms, residuals = _normal_equations(surface, points, normals, weights, pose, reach)
        matched = len(residuals)
        if matched < _MINIMUM_RETURNS:
            break
        # the returns are as noisy as their residuals, and as independent
        deviation, independent = _noise(residuals)
        certainty = independent / max(deviation, MINIMUM_DEVIATION) ** 2
        information, b = _without_normal_noise(certainty * A, certainty * b)
        # error of the prior in the vehicle frame
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = prior[0] - pose[0], prior[1] - pose[1]
        turn = wrapped(prior[2] - pose[2])
        off = np.array([c * dx + s * dy, c * dy - s * dx, turn])
        system = information + prior_information
        for i in range(3):
            system[i, i] += 1e-6
        step = np.linalg.solve(system, b + prior_information @ off)
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        settled = reach <= _MINIMUM_REACH
        reach = max(reach * _REACH_SHRINKS, _MINIMUM_REACH)
        if settled and np.abs(step).sum() < _CONVERGED_STEP:
            break
    return pose, information, matched, rms, independent


@kernel
def _without_normal_noise(A: Array, b: Array) -> tuple[Array, Array]:
    """Return A and b without the spurious information that comes from noisy normals.

    Normals that scatter around one direction have components along the surface. These sum up
    to NORMAL_DEVIATION² of the information across, all along the weakest direction v of the
    translation: A' = A - d v vᵀ, with b' so that the solution of A' δ = b' remains A⁻¹ b.
    """
    turn = max(A[2, 2], 1e-9)
    xx, yy = A[0, 0] - A[0, 2] ** 2 / turn, A[1, 1] - A[1, 2] ** 2 / turn
    xy = A[0, 1] - A[0, 2] * A[1, 2] / turn
    weakest = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    spurious = min(NORMAL_DEVIATION**2 * (A[0, 0] + A[1, 1]), max(weakest, 0.0))
    heading = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
    v = np.array([math.cos(heading), math.sin(heading), 0.0])
    regular = A + 1e-6 * np.eye(3)
    along = spurious * (v @ np.linalg.solve(regular, b))
    return A - spurious * np.outer(v, v), b - along * v


@kernel
def _noise(residuals: Array) -> tuple[float, float]:
    """Return standard deviation (m) and independent fraction f of residuals (n,).

    They are in the order of the beams. The sum of n equally correlated errors has the variance of
    n / f independent ones with 1 / f = 1 + 2 Σ ρ(k): the autocorrelation ρ, with the weights of
    Bartlett's window (Newey and West, 1987).
    """
    count = len(residuals)
    variance = np.dot(residuals, residuals) / count
    inflation = 1.0
    for k in range(1, min(_CORRELATED_BEAMS, count - 1) + 1):
        product = np.dot(residuals[k:], residuals[:-k]) / count
        taper = 1.0 - k / (_CORRELATED_BEAMS + 1.0)
        inflation += 2.0 * taper * product / max(variance, 1e-12)
    fraction = 1.0 / max(inflation, 1.0)
    return math.sqrt(variance), max(fraction, _MINIMUM_INDEPENDENT_FRACTION)


@kernel
def _normal_equations(
    surface: SurfaceMap,
    points: Array,
    normals: Array,
    weights: Array,
    pose: Array,
    reach: float,
) -> tuple[Array, Array, float, Array]:
    """Return A (3, 3), b (3,) of A δ = b for independent returns with a variance of 1 m².

    Also the root mean square (m) of the residuals of the returns matched, and these residuals
    (n,), bounded by the robust weights.
    """
    A, b, matched, squares = np.zeros((3, 3)), np.zeros(3), 0, 0.0
    residuals = np.empty(len(points))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for n in range(len(points)):
        px, py = points[n, 0], points[n, 1]
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        nx, ny = c * normals[n, 0] - s * normals[n, 1], s * normals[n, 0] + c * normals[n, 1]
        k = nearest_element(surface, x, y, nx, ny, reach, _MINIMUM_COSINE)
        if k < 0:
            continue
        nx, ny = surface.normals[k, 0], surface.normals[k, 1]
        residual = nx * (surface.points[k, 0] - x) + ny * (surface.points[k, 1] - y)
        squares += min(residual * residual, _MAXIMUM_RESIDUAL**2)
        weight = 1.0 / (1.0 + (residual / _CAUCHY) ** 2)
        residuals[matched] = math.sqrt(weight) * residual
        matched += 1
        weight *= weights[n]
        jx, jy = c * nx + s * ny, c * ny - s * nx
        jt = jy * px - jx * py
        A[0, 0] += weight * jx * jx
        A[0, 1] += weight * jx * jy
        A[0, 2] += weight * jx * jt
        A[1, 1] += weight * jy * jy
        A[1, 2] += weight * jy * jt
        A[2, 2] += weight * jt * jt
        b[0] += weight * jx * residual
        b[1] += weight * jy * residual
        b[2] += weight * jt * residual
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    return A, b, math.sqrt(squares / max(matched, 1)), residuals[:matched]
