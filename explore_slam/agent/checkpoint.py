"""The agent's state as a file: the filter, the scans with their keyframes, closures and tags.

One npz file, written atomically, without pickled objects. Odometry is not stored, since its frame
does not survive a restart of the bases: after loading, each vehicle continues from its pose.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent.config import AgentConfig
from explore_slam.agent.loop_closing import LoopClosing
from explore_slam.agent.tag_mapping import TagMapping
from explore_slam.data import LaserScan
from explore_slam.errors import AgentError, ExploreSlamError
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, LaserMap, VehicleDisc
from explore_slam.slam import TeamBelief, checkpoint
from explore_slam.tags import table_of

State = dict[str, NDArray[Any]]
VERSION = 4


class Saved(NamedTuple):
    """What a saved state consists of."""

    belief: TeamBelief
    laser_map: LaserMap
    loops: LoopClosing
    tags: TagMapping


def save(path: Path, saved: Saved) -> None:
    """Write the state; AgentError if it cannot be written."""
    state = {'agent_version': np.array(VERSION)}
    vehicles = list(saved.belief.vehicles)
    state |= checkpoint.under('belief', saved.belief.state_dict())
    state |= checkpoint.under('scans', _scans_state(saved.laser_map, vehicles))
    state |= checkpoint.under('loops', saved.loops.state_dict())
    state |= checkpoint.under('tags', saved.tags.state_dict())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        checkpoint.write(path, state)
    except (ExploreSlamError, OSError) as error:
        raise AgentError(f'state cannot be saved: {error}') from error


def load(path: Path, config: AgentConfig) -> Saved:
    """Read filter, scans, closures and tags; AgentError for a missing or different file."""
    try:
        state = checkpoint.read(path)
        version = int(state.get('agent_version', np.array(-1)))
        if version != VERSION:
            raise AgentError(f'{path} has agent state version {version}, expected {VERSION}')
        belief = TeamBelief.from_state(checkpoint.part('belief', state))
        scans = checkpoint.part('scans', state)
        loops = LoopClosing.from_state(checkpoint.part('loops', state), config.closures)
        tags = TagMapping(config.vision.tags, table_of(config.vision.tags).poses)
        tags.restore(checkpoint.part('tags', state))
        laser_map = _laser_map(scans, list(belief.vehicles), config.mapping)
        return Saved(belief, laser_map, loops, tags)
    except AgentError:
        raise
    except (ExploreSlamError, KeyError, ValueError, IndexError) as error:
        raise AgentError(f'state cannot be loaded: {error}') from error


def _scans_state(laser_map: LaserMap, vehicles: list[str]) -> State:
    """Return the scans of a laser map as arrays; vehicles by their index in the list."""
    scans, numbers, bodies, deskewed, bearings = [], [], [], [], [np.empty(0, np.float32)]
    for row, item in enumerate(laser_map.scans):
        scan = item.scan
        numbers.append((item.keyframe, vehicles.index(item.vehicle), scan.ranges.size))
        scans.append(
            (scan.stamp, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
            + tuple(item.laser_in_keyframe)
        )
        if scan.bearings is not None:
            deskewed.append(row)
            bearings.append(scan.bearings)
        bodies += [(row, body.keyframe, *body.offset, body.radius) for body in item.bodies]
    ranges = [item.scan.ranges for item in laser_map.scans]
    return {
        'numbers': np.array(numbers, np.int64).reshape(-1, 3),
        'scans': np.array(scans, np.float64).reshape(-1, 8),
        'ranges': np.concatenate([np.empty(0, np.float32), *ranges]),
        'deskewed': np.array(deskewed, np.int64),
        'bearings': np.concatenate(bearings),
        'bodies': np.array(bodies, np.float64).reshape(-1, 6),
    }


def _laser_map(state: State, vehicles: list[str], config: GridConfig) -> LaserMap:
    """Return the laser map of the arrays that _scans_state made."""
    laser_map = LaserMap(config)
    bodies: dict[int, list[VehicleDisc]] = {}
    for row, keyframe, x, y, theta, radius in state['bodies'].tolist():
        bodies.setdefault(int(row), []).append(
            VehicleDisc(int(keyframe), Pose2(x, y, theta), radius)
        )
    first, first_bearing = 0, 0
    deskewed = set(state['deskewed'].tolist())
    rows = zip(state['numbers'].tolist(), state['scans'].tolist(), strict=True)
    for row, ((keyframe, vehicle, count), (*sweep, x, y, theta)) in enumerate(rows):
        stamp, angle_min, increment, range_min, range_max = sweep
        ranges = state['ranges'][first : first + count]
        first += count
        bearings = None
        if row in deskewed:
            bearings = state['bearings'][first_bearing : first_bearing + count]
            first_bearing += count
        scan = LaserScan(
            stamp, angle_min, increment, ranges, range_min, range_max, bearings=bearings
        )
        laser_map.add(keyframe, vehicles[vehicle], scan, Pose2(x, y, theta), bodies.get(row, []))
    return laser_map
