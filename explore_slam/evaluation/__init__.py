"""Room 'evaluation'; see doc/architecture."""
