"""What happens during a run in the grid simulator: doors, glass, people, vehicles that fail.

A scenario file is YAML with a list `events`. An event acts from `start` for `duration` (s; to the
end of the run without it). Its `type` says what it does and which further keys it has:

    events:
      - {type: person, start: 20, duration: 60, position: [4.0, 2.5]}
      - {type: door, start: 0, duration: 12, from: [3.0, 1.0], to: [3.0, 2.0]}
      - {type: glass, start: 0, from: [6.0, 1.0], to: [6.0, 2.0]}
      - {type: stuck, start: 30, vehicle: robot2}
      - {type: slow, start: 0, vehicle: robot1, factor: 0.3}
      - {type: silent, start: 40, duration: 60, vehicle: robot1}

person: a disc that stops bodies and beams. door: its segment is closed. glass: its segment stops
bodies, not beams. stuck: the vehicle does not move. slow: it moves at `factor` of its speed.
silent: nothing arrives from it or at it, so that it stands. People, doors and glass appear as
soon as no vehicle is near their place.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import SimulationError
from explore_slam.files import read_mapping
from explore_slam.geometry import Array
from explore_slam.simulation.worlds.grid_world import FREE, GLASS, SOLID, GridWorld
from explore_slam.simulation.worlds.world_file import Entry

PERSON_RADIUS = 0.25  # m
PERSON_DISTANCE = 0.7  # m; a person appears as soon as no vehicle is nearer
SLOW_FACTOR = 0.3  # of the speed of a slow vehicle, unless the event gives another
PLACED = ('person', 'door', 'glass')  # types with a place in the world
OF_VEHICLES = ('stuck', 'slow', 'silent')  # types that befall a vehicle
_DOOR_DISTANCE = 0.35  # m; a door closes as soon as no vehicle is nearer
_LATEST = 1e6  # s
_FILL = {'person': SOLID, 'door': SOLID, 'glass': GLASS}


@dataclass(frozen=True)
class Event:
    """One event.

    start (s), duration (s; inf: to the end). points: position of a person, or the ends of a
    segment (m). vehicle: name, '' if none is meant. factor: of its speed.
    """

    kind: str
    start: float
    duration: float = math.inf
    points: tuple[tuple[float, float], ...] = ()
    vehicle: str = ''
    factor: float = 1.0

    @property
    def end(self) -> float:
        """Time (s) at which it ceases to act."""
        return self.start + self.duration

    def acts_at(self, now: float) -> bool:
        """Return whether a time (s) is between start and end."""
        return self.start <= now < self.end


class Conditions(NamedTuple):
    """What a vehicle suffers at one time: factor of its speed, and whether it is silent."""

    speed_factor: float = 1.0
    silent: bool = False


@dataclass(frozen=True)
class Scenario:
    """The events of a run."""

    events: tuple[Event, ...] = ()

    def check(self, world: GridWorld, vehicles: Iterable[str]) -> None:
        """Raise SimulationError unless all places are free and all vehicles exist."""
        names = list(vehicles)
        for index, event in enumerate(self.events):
            _check_places(f'events[{index}]', event, world)
            if event.vehicle and event.vehicle not in names:
                raise SimulationError(
                    f'events[{index}].vehicle is {event.vehicle!r}, expected one of {names}'
                )

    def conditions(self, vehicle: str, now: float) -> Conditions:
        """Return what a vehicle suffers at a time (s)."""
        factor, silent = 1.0, False
        for event in self.events:
            if event.vehicle == vehicle and event.acts_at(now):
                factor *= event.factor
                silent |= event.kind == 'silent'
        return Conditions(factor, silent)

    def final_world(self, world: GridWorld) -> GridWorld:
        """Return the world after all events that end: those that last for ever are in it."""
        lasting = [event for event in self.events if event.points and math.isinf(event.duration)]
        return world_with(world, lasting)


class Changes:
    """The cells of a world as events change them in the course of a run."""

    def __init__(self, world: GridWorld, scenario: Scenario) -> None:
        self.world = world
        self._original = world
        self._placed = [event for event in scenario.events if event.points]
        self._present: list[Event] = []

    def update(self, now: float, positions: Array) -> bool:
        """Let events appear and go at a time (s); return whether the world has changed.

        positions (V, 2) m: of the vehicles, near which nothing appears.
        """
        present = [
            event
            for event in self._placed
            if event.acts_at(now) and (event in self._present or _has_room(event, positions))
        ]
        if present == self._present:
            return False
        self._present = present
        self.world = world_with(self._original, present)
        return True


def world_with(world: GridWorld, events: Sequence[Event]) -> GridWorld:
    """Return a world with the people, doors and glass of events in it."""
    if not events:
        return world
    cells = world.cells.copy()
    for event in events:
        covered = _covered(event, world)
        fill = _FILL[event.kind]
        cells[covered & (cells == FREE)] = fill
    return replace(world, cells=cells)


def load_scenario(path: Path, world: GridWorld, vehicles: Iterable[str]) -> Scenario:
    """Read a scenario file for a world and vehicles.

    Raises SimulationError that names the file, the key and what was expected.
    """
    content = read_mapping(path, SimulationError, "a mapping with the key 'events'")
    Entry(path, 'the scenario', content).mapping({'events'}, set())
    entries = list(Entry(path, 'events', content['events']).items())
    events = tuple(_event(entry) for entry in entries)
    names = list(vehicles)
    for entry, event in zip(entries, events, strict=True):
        if event.vehicle and event.vehicle not in names:
            raise entry.child('vehicle').fail(f'one of {names}')
        try:
            _check_places(entry.where, event, world)
        except SimulationError as error:
            raise SimulationError(f'{path}: {error}') from error
    return Scenario(events)


def _event(entry: Entry) -> Event:
    if not isinstance(entry.value, Mapping) or 'type' not in entry.value:
        raise entry.fail("a mapping with the key 'type'")
    kind = entry.child('type').choice([*PLACED, *OF_VEHICLES])
    required = {'type', 'start'}
    optional = {'duration'}
    if kind == 'person':
        required |= {'position'}
    elif kind in PLACED:
        required |= {'from', 'to'}
    else:
        required |= {'vehicle'}
        optional |= {'factor'} if kind == 'slow' else set()
    entry.mapping(required, optional)
    start = entry.child('start').number(0.0, _LATEST, 's')
    duration = math.inf
    if entry.value.get('duration') is not None:
        duration = entry.child('duration').number(0.0, _LATEST, 's')
    if kind in OF_VEHICLES:
        factor = 0.0
        if kind == 'slow':
            factor = entry.child('factor', SLOW_FACTOR).number(0.0, 1.0, 'of the speed')
        vehicle = entry.child('vehicle').value
        if not isinstance(vehicle, str) or not vehicle:
            raise entry.child('vehicle').fail('the name of a vehicle')
        return Event(kind, start, duration, (), vehicle, factor)
    keys = ['position'] if kind == 'person' else ['from', 'to']
    points = [entry.child(key).numbers('x y') for key in keys]
    return Event(kind, start, duration, tuple((x, y) for x, y in points))


def _check_places(where: str, event: Event, world: GridWorld) -> None:
    """Raise SimulationError unless a person stands in the free, and a segment crosses it."""
    for point in event.points:
        if not world.is_inside(point):
            raise SimulationError(
                f'{where}: {list(point)} lies outside of the map, expected inside'
            )
    if event.kind == 'person':
        row, col = world.to_cell([event.points[0]])[0]
        if world.cells[row, col] != FREE:
            raise SimulationError(
                f'{where}.position is {list(event.points[0])}, in a wall, expected a free place'
            )
    elif event.points and not (world.cells[_covered(event, world)] == FREE).any():
        ends = ' to '.join(str(list(point)) for point in event.points)
        raise SimulationError(f'{where} leads from {ends}, all in a wall, expected free cells')


def _distance(event: Event, points: Array) -> Array:
    """Return the distance (N,) m of points (N, 2) m from the place of an event."""
    start, end = np.array(event.points[0]), np.array(event.points[-1])
    along = end - start
    square = float(along @ along)
    share = (
        np.clip((points - start) @ along / square, 0.0, 1.0) if square else np.zeros(len(points))
    )
    distance: Array = np.hypot(*(points - start - share[:, None] * along).T)
    return distance


def _covered(event: Event, world: GridWorld) -> NDArray[np.bool_]:
    """Return the cells (H, W) that an event fills: a disc, or a segment two cells thick."""
    width = PERSON_RADIUS if event.kind == 'person' else world.resolution
    cells = world.to_cell(np.array(event.points))
    margin = math.ceil(width / world.resolution) + 1
    low = np.maximum(cells.min(axis=0) - margin, 0)
    high = np.minimum(cells.max(axis=0) + margin + 1, world.shape)
    index = np.indices((high - low).tolist()).reshape(2, -1).T + low
    near = index[_distance(event, world.to_point(index)) <= width]
    covered = np.zeros(world.shape, np.bool_)
    covered[near[:, 0], near[:, 1]] = True
    return covered


def _has_room(event: Event, positions: Array) -> bool:
    """Return whether no vehicle (V, 2) m is too near for an event to appear."""
    needed = PERSON_DISTANCE if event.kind == 'person' else _DOOR_DISTANCE
    return bool((_distance(event, positions) >= needed).all())
