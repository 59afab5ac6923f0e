"""Room 'cli'; see doc/architecture."""
