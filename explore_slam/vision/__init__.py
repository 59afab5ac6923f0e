"""Room 'vision'; see doc/architecture."""
