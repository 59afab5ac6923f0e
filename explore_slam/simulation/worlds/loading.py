"""Read worlds from files: what a YAML file holds decides which reader takes it."""

from pathlib import Path

from explore_slam.errors import SimulationError
from explore_slam.mapping.map_files import is_map
from explore_slam.simulation.worlds.grid_world import GridWorld
from explore_slam.simulation.worlds.map_world import world_of_map
from explore_slam.simulation.worlds.world import World
from explore_slam.simulation.worlds.world_file import read_entries, world_of_file


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
    """Read a world file or a map_server map (both YAML, or an image with its YAML beside it).

    Raises SimulationError that names the file and what is wrong with it.
    """
    path = Path(path)
    return world_of_map(path) if is_map(path) else world_of_file(path, read_entries(path))


def load_grid_world(path: Path, resolution: float = 0.05, height: float = 0.0) -> GridWorld:
    """Read a map_server map (YAML, or image alone) or a world file (YAML) as cells.

    resolution: side (m) of a cell for world files and for images without a YAML file.
    height: of a vehicle (m): boards of a world file that hang lower, and pits, are solid too.
    """
    if is_map(path):
        return GridWorld.from_map(path, resolution)
    return GridWorld.from_world(world_of_file(path, read_entries(path)), resolution, height)
