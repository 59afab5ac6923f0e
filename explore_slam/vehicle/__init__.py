"""Room 'vehicle'; see doc/architecture."""
