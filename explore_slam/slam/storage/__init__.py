"""Storage of landmark rows and of the ancestry of particles."""
