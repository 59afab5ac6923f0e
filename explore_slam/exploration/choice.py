"""Which vehicle goes to which frontier, by the strategy that is set."""

import math

import numpy as np

from explore_slam.exploration.assignment import (
    assign_jointly,
    assign_nearest,
    assign_random,
    assign_targets,
)
from explore_slam.exploration.config import ExplorationConfig
from explore_slam.exploration.frontiers import visible_unknown
from explore_slam.exploration.records import Frontier
from explore_slam.exploration.scene import Scene
from explore_slam.geometry import Array

RAYS = 48


def choose_targets(
    scene: Scene,
    frontiers: list[Frontier],
    costs: Array,
    kept: list[int],
    generator: np.random.Generator,
) -> list[int]:
    """Return for each vehicle the index of its frontier, -1 for none.

    costs (V, F) m; kept holds for each vehicle the frontier it is on the way to, or -1.
    """
    config: ExplorationConfig = scene.config
    sensor = config.frontiers.sensor_range
    targets = np.array([f.target for f in frontiers])
    strategy = config.assignment.strategy
    if strategy == 'random':
        drawn = assign_random(costs, generator)
        return [k if k >= 0 else d for k, d in zip(kept, drawn, strict=True)]
    biased = costs.astype(np.float64)
    for i, target in enumerate(kept):
        if target >= 0:
            biased[i, target] -= config.assignment.hysteresis
    if strategy == 'nearest':
        return assign_nearest(biased)
    if strategy == 'paper':
        return assign_targets(biased, targets, sensor, config.assignment.travel_weight)
    biased -= config.assignment.gain_weight * expected_gains(scene, frontiers)[None]
    return assign_jointly(biased, targets, sensor, config.assignment.overlap_weight)


def expected_gains(scene: Scene, frontiers: list[Frontier]) -> Array:
    """Return for each frontier the unknown area in sight of its target, as a share of a disc."""
    reach = int(scene.config.frontiers.sensor_range / scene.grid.resolution)
    occupied = ~(scene.costs.free | scene.costs.unknown)
    area = math.pi * reach * reach
    return np.array(
        [
            visible_unknown(occupied, scene.costs.unknown, *f.target_cell, reach, RAYS) / area
            for f in frontiers
        ]
    )
