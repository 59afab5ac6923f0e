"""The grid simulator: kinematic vehicles with a laser in a grid world, for planning studies."""
