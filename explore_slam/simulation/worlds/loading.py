"""Read worlds from files: what a YAML file holds decides which reader takes it."""

from pathlib import Path

from explore_slam.errors import SimulationError
from explore_slam.simulation.worlds.grid_world import GridWorld
from explore_slam.simulation.worlds.map_world import world_of_map
from explore_slam.simulation.worlds.world import World
from explore_slam.simulation.worlds.world_file import read_entries, world_of_file

_MAP_KEY = 'image'  # a YAML file with this key is a map of map_server, any other is a world file
_YAML_SUFFIXES = ('.yaml', '.yml')
_IMAGE_SUFFIXES = ('.pgm', '.png', '.bmp')


def world_path(name: str) -> Path:
    """Return the file of a world: a path is returned unchanged, a bare name is looked up.

    Bare names are looked up in `config/worlds` of the package. Raises SimulationError that lists
    the known names.
    """
    given = Path(name)
    if given.suffix or given.exists():
        return given
    known: dict[str, Path] = {}
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / 'config/worlds', parent / 'share/explore_slam/config/worlds'):
            for path in sorted(folder.glob('*.yaml')):
                known.setdefault(path.stem, path)
    if name not in known:
        raise SimulationError(
            f'there is no world {name!r}: expected a YAML file or one of {sorted(known)}'
        )
    return known[name]


def load_world(path: Path | str) -> World:
    """Read a world file or a map_server map (both YAML).

    Raises SimulationError that names the file and what is wrong with it.
    """
    path = Path(path)
    if path.suffix.lower() in _IMAGE_SUFFIXES:
        raise SimulationError(
            f'{path} is the image of a map; give its YAML file, which holds the resolution'
        )
    content = read_entries(path)
    return world_of_map(path) if _MAP_KEY in content else world_of_file(path, content)


def load_grid_world(path: Path, resolution: float = 0.05) -> GridWorld:
    """Read a map_server map (YAML, or PGM alone) or a world file (YAML) as cells.

    resolution: side (m) of a cell for world files and for images without a YAML file.
    """
    if path.suffix.lower() in _YAML_SUFFIXES:
        content = read_entries(path)
        if _MAP_KEY not in content:
            return GridWorld.from_world(world_of_file(path, content), resolution)
    return GridWorld.from_map(path, resolution)
