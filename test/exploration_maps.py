"""Small maps as text: # is occupied, . free, ? unknown; the first line has the highest y."""

import numpy as np

from explore_slam.mapping import GridConfig, OccupancyGrid


def grid_of(text, resolution=0.25, cells_per_letter=1):
    lines = [line.strip() for line in text.strip().splitlines()][::-1]
    letters = np.array([list(line) for line in lines])
    letters = letters.repeat(cells_per_letter, 0).repeat(cells_per_letter, 1)
    probability = np.where(letters == '#', 0.97, 0.03)
    config = GridConfig(resolution=resolution)
    return OccupancyGrid.from_probability(probability, letters != '?', (0.0, 0.0), config)


def point_of(row_from_top, col, text, resolution=0.25, cells_per_letter=1):
    """Center of a letter in metres."""
    rows = len(text.strip().splitlines())
    side = resolution * cells_per_letter
    return (col + 0.5) * side, (rows - row_from_top - 0.5) * side
