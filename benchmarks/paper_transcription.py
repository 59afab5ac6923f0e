"""Literal transcription of the pseudocode of the paper (section III), in NumPy and SciPy.

Particles share nothing: each holds its pose, its landmarks and a kd-tree over their descriptors;
resampling copies whole particles. It is the reference of `slam_speed.py`.
"""

import copy
import math

import numpy as np
from scipy.spatial import cKDTree

from explore_slam.data import LandmarkObservations
from explore_slam.geometry import Array, planar_rotation


class Particle:
    """Pose (3,), landmark means (N, 3), covariances (N, 3, 3), descriptors (N, 128), kd-tree."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose.copy()
        self.means = np.empty((0, 3))
        self.covariances = np.empty((0, 3, 3))
        self.descriptors = np.empty((0, 128))
        self.tree: cKDTree | None = None
        self.weight = 1.0

    def rebuild_tree(self) -> None:
        """Build the kd-tree of the current descriptors."""
        self.tree = cKDTree(self.descriptors) if len(self.descriptors) else None


class PaperFastSlam:
    """FastSLAM(S, z, d, u) for one vehicle."""

    def __init__(self, pose: Array, particles: int, seed: int, P0: float, E0: float) -> None:
        self.random = np.random.default_rng(seed)
        self.particles = [Particle(pose) for _ in range(particles)]
        self.P0, self.E0 = P0, E0

    def step(self, increment: Array, covariance: Array, seen: LandmarkObservations) -> None:
        """Run steps 1 to 6 of the pseudocode."""
        for particle in self.particles:
            noisy = increment + self.random.multivariate_normal(np.zeros(3), covariance)
            x, y, theta = particle.pose
            c, s = math.cos(theta), math.sin(theta)
            particle.pose = np.array(
                [
                    x + c * noisy[0] - s * noisy[1],
                    y + s * noisy[0] + c * noisy[1],
                    theta + noisy[2],
                ]
            )
            particle.weight = 1.0
            new = [k for k in range(len(seen)) if not self._associate(particle, seen, k)]
            self._insert(particle, seen, new)
        weights = np.array([particle.weight for particle in self.particles])
        chosen = self.random.choice(len(weights), len(weights), p=weights / weights.sum())
        self.particles = [copy.deepcopy(self.particles[i]) for i in chosen]

    def _associate(self, particle: Particle, seen: LandmarkObservations, k: int) -> bool:
        if particle.tree is None:
            return False
        near = particle.tree.query_ball_point(seen.descriptors[k], math.sqrt(self.E0))
        H = planar_rotation(-particle.pose[2])
        origin = np.array([particle.pose[0], particle.pose[1], 0.0])
        best, best_distance = None, math.inf
        for n in near:
            nu = seen.positions[k] - H @ (particle.means[n] - origin)
            S = H @ particle.covariances[n] @ H.T + seen.covariances[k]
            p = math.exp(-0.5 * nu @ np.linalg.solve(S, nu))
            E = float(np.sum((particle.descriptors[n] - seen.descriptors[k]) ** 2))
            if p >= self.P0 and best_distance > E:
                best, best_distance = (n, nu, S, p), E
        if best is None:
            return False
        n, nu, S, p = best
        gain = particle.covariances[n] @ H.T @ np.linalg.inv(S)
        particle.means[n] += gain @ nu
        particle.covariances[n] -= gain @ H @ particle.covariances[n]
        particle.weight *= p
        return True

    def _insert(self, particle: Particle, seen: LandmarkObservations, new: list[int]) -> None:
        if not new:
            return
        T = planar_rotation(particle.pose[2])
        origin = np.array([particle.pose[0], particle.pose[1], 0.0])
        particle.means = np.vstack([particle.means, origin + seen.positions[new] @ T.T])
        particle.covariances = np.concatenate(
            [particle.covariances, T @ seen.covariances[new] @ T.T]
        )
        particle.descriptors = np.vstack([particle.descriptors, seen.descriptors[new]])
        particle.rebuild_tree()
