"""The light simulator on a grid of cells, for planning studies."""
