"""Drives of vehicles through worlds of walls, with drift, loop search and joint graph."""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from registration.ray_caster import polyline, scan_of

from explore_slam.geometry import Pose2, between, wrap_angle
from explore_slam.registration import scan_cloud
from explore_slam.slam.closures import ClosureConfig, LoopSearch
from explore_slam.slam.graph import GraphConfig, JointGraph

STEP = 0.5  # m between keyframes


def along(*corners, step=STEP):
    """Return poses along a line through corners, turning on the spot in steps of 30 degrees."""
    poses, heading = [], None
    for a, b in itertools.pairwise(corners):
        distance_driven = math.dist(a, b)
        new = math.atan2(b[1] - a[1], b[0] - a[0])
        if heading is not None:
            turn = wrap_angle(new - heading)
            parts = max(math.ceil(abs(turn) / 0.52), 1)
            poses += [Pose2(*a, heading + turn * k / parts) for k in range(1, parts)]
        heading = new
        parts = math.ceil(distance_driven / step)
        x, y = np.linspace(a, b, parts, endpoint=False).T
        poses += [Pose2(*at, heading) for at in zip(x.tolist(), y.tolist(), strict=True)]
    return poses


def corridor_of_rooms(x0, y0, period, rooms, side=1.0):
    """Return the walls of a corridor 2 m wide along x with equal rooms on one side."""
    end = x0 + period * rooms
    parts = [polyline((x0, y0 - side), (end, y0 - side))]
    for k in range(rooms):
        left = x0 + k * period
        near, far = y0 + side, y0 + side * 3.5
        parts += [
            polyline((left, near), (left + 0.8, near)),
            polyline((left + 1.8, near), (left + period, near)),
            polyline((left + 0.1, near), (left + 0.1, far), (left + period - 0.1, far)),
            polyline((left + period - 0.1, far), (left + period - 0.1, near)),
            polyline((left + 1.9, far), (left + 1.9, far - side * 0.6)),
        ]
    return np.vstack(parts)


@dataclass
class Vehicle:
    """Where a vehicle was, and by how much its odometry is wrong."""

    path: list[Pose2]
    way_scale: float = 1.0
    turn_scale: float = 1.0
    noise: float = 0.0  # m and rad per keyframe
    start: Pose2 | None = None  # as given; default: right


@dataclass
class Drive:
    """The true poses by keyframe, and what loop search and graph made of the measurements."""

    search: LoopSearch
    graph: JointGraph
    true: list[Pose2] = field(default_factory=list)
    distance_driven: dict[int, float] = field(default_factory=dict)
    factors: list[int] = field(default_factory=list)

    def errors(self):
        """Return the distances (n,) m and turns (n,) rad of the closures from the truth."""
        off = [
            between(self.true[c.keyframe_a].between(self.true[c.keyframe_b]), c.pose)
            for c in self.search.closures
        ]
        values = np.array(off).reshape(-1, 3)
        return np.hypot(values[:, 0], values[:, 1]), np.abs(values[:, 2])


def drive(world_at, vehicles, seed=0, config=None, calibrated=False, sight=math.pi):
    """Drive vehicles one keyframe each in turn; world_at(keyframe, vehicle) returns the walls."""
    random = np.random.default_rng(seed)
    run = Drive(
        LoopSearch(config or ClosureConfig()), JointGraph(GraphConfig(graph_bounded=False))
    )
    keyframe, last = 0, {}
    for k in range(max(len(vehicle.path) for vehicle in vehicles)):
        for v, vehicle in enumerate(vehicles):
            if k >= len(vehicle.path):
                continue
            true = vehicle.path[k]
            run.true.append(true)
            if v not in last:
                run.graph.add_start(v, keyframe, np.array(vehicle.start or true))
                run.distance_driven[v] = 0.0
            else:
                u = np.array(last[v].between(true))
                distance_driven, turn = math.hypot(u[0], u[1]), abs(u[2])
                u[:2] *= vehicle.way_scale
                u[2] *= vehicle.turn_scale
                u += vehicle.noise * random.normal(size=3) * (0.3, 0.3, 0.1)
                deviations = np.array(
                    [
                        0.03 * distance_driven + 0.004,
                        0.01 * distance_driven + 0.004,
                        0.003 * distance_driven + 0.02 * turn + 0.001,
                    ]
                )
                run.graph.add_keyframe(v, keyframe, u, np.diag(deviations**2))
                run.distance_driven[v] += distance_driven
            last[v] = true
            scan = scan_of(world_at(keyframe, v), true, 0.01, random, stamp=float(k), sight=sight)
            cloud = scan_cloud(scan, farthest=20.0)
            run.search.add_anchor(keyframe, v, cloud, run.distance_driven[v], float(k))
            covariance = run.graph.relative_covariance if calibrated else None
            new = run.search.search(keyframe, run.graph.path(), covariance)
            new_factors = [add(run.graph, c, robust=False) for c in new]
            if new:
                run.graph.optimize()
                for factor in new_factors:
                    run.graph.remove_factor(factor)
                run.factors += [add(run.graph, c, robust=True) for c in new]
                run.graph.optimize()
            keyframe += 1
    return run


def add(graph, closure, *, robust):
    """Add a closure to a graph."""
    return graph.add_relative_pose(
        closure.keyframe_a,
        closure.keyframe_b,
        np.array(closure.pose),
        closure.information,
        robust=robust,
    )
