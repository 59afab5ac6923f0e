"""Room 'nodes'; see doc/architecture."""
