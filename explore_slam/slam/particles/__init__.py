"""Particles: groups of vehicles, motion, resampling, per-particle paths."""
