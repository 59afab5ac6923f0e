"""Send two robots to the frontiers of a half-explored map (Burgard et al., 2005).

python examples/frontiers_and_plan.py

Find the frontiers of a grid, compute the travel cost of each robot to each of them, assign one
target per robot by utility and cost, and plan the paths.
"""

import numpy as np

from explore_slam.exploration import assign_targets, find_frontiers, plan_path, travel_cost
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, OccupancyGrid

RESOLUTION = 0.1  # m
SENSOR_RANGE = 3.5  # m: targets nearer to each other than this share what will be seen
OCCUPIED = 0.6  # cells of a higher probability cannot be entered


def half_explored_map() -> OccupancyGrid:
    """Return a map of 12 x 8 m, free in the middle and unknown at both ends."""
    probability = np.full((80, 120), 0.5)
    known = np.zeros((80, 120), bool)
    known[10:70, 30:90] = True
    probability[10:70, 30:90] = 0.05
    probability[[10, 69], 30:90] = 0.95
    probability[30:50, 58:62] = 0.95  # a cupboard in the middle of the room
    return OccupancyGrid.from_probability(
        probability, known, (0.0, 0.0), GridConfig(resolution=RESOLUTION)
    )


def main() -> None:
    """Find, assign, plan, print."""
    grid = half_explored_map()
    robots = {'robot1': Pose2(4.0, 3.0, 0.0), 'robot2': Pose2(4.5, 5.0, 0.0)}
    frontiers = find_frontiers(grid)
    print(f'{len(frontiers)} frontiers:')
    for frontier in frontiers:
        x, y = frontier.target
        print(
            f'  target ({x:.1f}, {y:.1f}), {frontier.size:.1f} m wide, gain {frontier.gain:.1f} m²'
        )

    probability = np.where(grid.known(), grid.probability(), np.nan)  # unknown: not to be entered
    starts = {name: tuple(grid.to_cell([pose[:2]])[0].tolist()) for name, pose in robots.items()}
    costs = []
    for name in robots:
        cost = travel_cost(probability, starts[name], OCCUPIED, grid.resolution)
        costs.append([float(cost[frontier.target_cell]) for frontier in frontiers])
    targets = [frontier.target for frontier in frontiers]
    chosen = assign_targets(costs, targets, SENSOR_RANGE, travel_weight=0.1)

    for index, name in enumerate(robots):
        frontier = frontiers[chosen[index]]
        cells, _ = plan_path(
            probability, starts[name], frontier.target_cell, OCCUPIED, grid.resolution
        )
        path = grid.to_point(cells)
        length = float(np.hypot(*np.diff(path, axis=0).T).sum())
        x, y = frontier.target
        print(f'{name} drives {length:.1f} m to ({x:.1f}, {y:.1f})')


if __name__ == '__main__':
    main()
