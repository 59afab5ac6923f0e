"""Room 'agent'; see doc/architecture."""
