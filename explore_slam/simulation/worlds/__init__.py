"""Worlds: solids, painted surfaces and cells, read from world files or map_server maps."""
