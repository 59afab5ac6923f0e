"""The agent's state as a file: filter, scans and views with their keyframes, closures and tags.

One npz file, written atomically, without pickled objects. Odometry is not stored, since its frame
does not survive a restart of the bases: after loading, each vehicle continues from its pose.
"""

from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent.config import AgentConfig
from explore_slam.agent.loop_closing import LoopClosing
from explore_slam.agent.tag_mapping import TagMapping
from explore_slam.data import LaserScan, ObstacleView
from explore_slam.errors import AgentError, ExploreSlamError
from explore_slam.geometry import Pose2
from explore_slam.mapping import GridConfig, LaserMap, ObstacleMap, VehicleDisc
from explore_slam.slam import TeamBelief, checkpoint
from explore_slam.tags import table_of

State = dict[str, NDArray[Any]]
VERSION = 5


class Saved(NamedTuple):
    """What a saved state consists of."""

    belief: TeamBelief
    laser_map: LaserMap
    obstacle_map: ObstacleMap
    loops: LoopClosing
    tags: TagMapping


def save(path: Path, saved: Saved) -> None:
    """Write the state; AgentError if it cannot be written."""
    state = {'agent_version': np.array(VERSION)}
    vehicles = list(saved.belief.vehicles)
    state |= checkpoint.under('belief', saved.belief.state_dict())
    state |= checkpoint.under('scans', _scans_state(saved.laser_map, vehicles))
    state |= checkpoint.under('views', _views_state(saved.obstacle_map, vehicles))
    state |= checkpoint.under('loops', saved.loops.state_dict())
    state |= checkpoint.under('tags', saved.tags.state_dict())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        checkpoint.write(path, state)
    except (ExploreSlamError, OSError) as error:
        raise AgentError(f'state cannot be saved: {error}') from error


def load(path: Path, config: AgentConfig, camera_scans: Collection[str] = ()) -> Saved:
    """Read filter, scans, views, closures and tags; AgentError for a missing or different file.

    camera_scans: vehicles whose scans are made of depth images.
    """
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
        vehicles, views = list(belief.vehicles), checkpoint.part('views', state)
        laser_map = LaserMap(config.mapping, known_free=camera_scans)
        _add_scans(laser_map, scans, vehicles)
        obstacle_map = _obstacle_map(views, vehicles, config.mapping)
        return Saved(belief, laser_map, obstacle_map, loops, tags)
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
        'sensors': np.array([item.sensor for item in laser_map.scans], np.str_),
        'deskewed': np.array(deskewed, np.int64),
        'bearings': np.concatenate(bearings),
        'bodies': np.array(bodies, np.float64).reshape(-1, 6),
    }


def _add_scans(laser_map: LaserMap, state: State, vehicles: list[str]) -> None:
    """Add the scans of the arrays that _scans_state made to a laser map."""
    bodies = _bodies_by_row(state['bodies'])
    first, first_bearing = 0, 0
    deskewed = set(state['deskewed'].tolist())
    sensors = _sensors(state)
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
            stamp,
            angle_min,
            increment,
            ranges,
            range_min,
            range_max,
            bearings=bearings,
            sensor=sensors[row],
        )
        laser_map.add(keyframe, vehicles[vehicle], scan, Pose2(x, y, theta), bodies.get(row, []))


def _views_state(obstacle_map: ObstacleMap, vehicles: list[str]) -> State:
    """Return the views of an obstacle map as arrays; vehicles by their index in the list."""
    views = obstacle_map.views
    numbers = [(i.keyframe, vehicles.index(i.vehicle), len(i.view)) for i in views]
    poses = [(item.view.stamp, *item.vehicle_in_keyframe) for item in views]
    bodies = [
        (row, body.keyframe, *body.offset, body.radius)
        for row, item in enumerate(views)
        for body in item.bodies
    ]
    none = np.empty(0, np.uint16)
    return {
        'numbers': np.array(numbers, np.int64).reshape(-1, 3),
        'poses': np.array(poses, np.float64).reshape(-1, 4),
        'sensors': np.array([item.sensor for item in views], np.str_),
        'cells': np.concatenate([np.empty((0, 2), np.int16), *(i.view.cells for i in views)]),
        'occupied': np.concatenate([none, *(item.view.occupied for item in views)]),
        'free': np.concatenate([none, *(item.view.free for item in views)]),
        'bodies': np.array(bodies, np.float64).reshape(-1, 6),
    }


def _obstacle_map(state: State, vehicles: list[str], config: GridConfig) -> ObstacleMap:
    """Return the obstacle map of the arrays that _views_state made."""
    obstacle_map = ObstacleMap(config)
    bodies, sensors = _bodies_by_row(state['bodies']), _sensors(state)
    first = 0
    rows = zip(state['numbers'].tolist(), state['poses'].tolist(), strict=True)
    for row, ((keyframe, vehicle, count), (stamp, x, y, theta)) in enumerate(rows):
        part = slice(first, first + count)
        first += count
        view = ObstacleView(
            stamp,
            state['cells'][part],
            state['occupied'][part],
            state['free'][part],
            sensors[row],
        )
        obstacle_map.add(
            keyframe, vehicles[vehicle], view, Pose2(x, y, theta), bodies.get(row, [])
        )
    return obstacle_map


def _sensors(state: State) -> list[str]:
    """Return the sensor of each scan or view; states of earlier revisions do not have it."""
    names = state.get('sensors')
    count = len(state['numbers'])
    return [''] * count if names is None else [str(name) for name in names.tolist()]


def _bodies_by_row(table: NDArray[np.float64]) -> dict[int, list[VehicleDisc]]:
    """Return the discs of a table (N, 6) by the row of their scan or view."""
    bodies: dict[int, list[VehicleDisc]] = {}
    for row, keyframe, x, y, theta, radius in table.tolist():
        bodies.setdefault(int(row), []).append(
            VehicleDisc(int(keyframe), Pose2(x, y, theta), radius)
        )
    return bodies
