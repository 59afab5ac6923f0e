"""Room 'exploration'; see doc/architecture."""
