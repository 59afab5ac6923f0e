"""Live exploration of an indoor environment by several vehicles with one common landmark map."""
