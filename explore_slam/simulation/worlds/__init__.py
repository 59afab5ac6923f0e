"""Worlds: files, maps, solids and painted surfaces."""
