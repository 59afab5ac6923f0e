"""Grid worlds drawn as text: # is a wall, g glass, space and . free; the first line is on top."""

import numpy as np

from explore_slam.simulation.worlds.grid_world import FREE, GLASS, SOLID, GridWorld

CELLS = {' ': FREE, '.': FREE, '#': SOLID, 'g': GLASS}


def drawn_world(rows, size=0.5, resolution=0.05):
    """Return a world in which each character is a square with sides of size (m)."""
    small = np.array([[CELLS[character] for character in row] for row in rows], np.int8)[::-1]
    times = round(size / resolution)
    return GridWorld(np.kron(small, np.ones((times, times), np.int8)), resolution)
