"""Room 'simulation'; see doc/architecture."""
