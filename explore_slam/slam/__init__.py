"""Room 'slam'; see doc/architecture."""
