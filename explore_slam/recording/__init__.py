"""Room 'recording'; see doc/architecture."""
