"""Room 'mapping'; see doc/architecture."""
