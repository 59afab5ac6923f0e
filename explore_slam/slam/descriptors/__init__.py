"""Indices over landmark descriptors."""
