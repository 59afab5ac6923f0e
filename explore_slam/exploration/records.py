"""Input and output of the planner."""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from explore_slam.data import BatteryLevel, Plan, VehicleBody
from explore_slam.geometry import Array, Pose2

Cell = tuple[int, int]
Point = tuple[float, float]


class Grid(Protocol):
    """What exploration needs of an occupancy grid: see mapping.OccupancyGrid."""

    @property
    def resolution(self) -> float:
        """Side of a cell (m)."""

    @property
    def origin(self) -> tuple[float, float]:
        """Lower left corner (m) of cell [0, 0]."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""

    def probability(self) -> NDArray[np.float32]:
        """Return the probability (H, W) that a cell is occupied."""

    def known(self) -> NDArray[np.bool_]:
        """Return whether each cell (H, W) has been observed."""

    def levels(self) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
        """Return the level (H, W) of each cell, and the probability (65536,) of each level.

        The same levels mean the same, so that changes are found by comparison. The probabilities
        are indexed by a level's bits as uint16; NaN is unknown.
        """

    def to_cell(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return the cells (N, 2) of points (N, 2) m."""

    def to_point(self, cells: ArrayLike) -> Array:
        """Return the centres (N, 2) m of cells (N, 2)."""


class ExplorationStatus(Enum):
    """State of the exploration; the values are those of the topic explore/status.

    Exploration ends as complete if nothing is left, and otherwise as incomplete: frontiers remain
    that no vehicle can reach.
    """

    STARTED = 'exploration_started'
    IN_PROGRESS = 'exploration_in_progress'
    PAUSED = 'exploration_paused'
    COMPLETE = 'exploration_complete'
    INCOMPLETE = 'exploration_incomplete'
    RETURNING = 'returning_to_origin'
    RETURNED = 'returned_to_origin'

    @property
    def explored(self) -> bool:
        """Whether exploration has ended: nothing is left, or nothing that can be reached."""
        return self in (ExplorationStatus.COMPLETE, ExplorationStatus.INCOMPLETE)


class PlanningMode(Enum):
    """Task of the team."""

    EXPLORE = 'explore'
    RETURN_HOME = 'return_home'
    PAUSED = 'paused'


class KnownPlace(NamedTuple):
    """A place (m) on the way of the team that is near a vehicle, but far along the way driven.

    deviation: largest standard deviation (m) of its position relative to the vehicle.
    """

    place: Point
    deviation: float


class VehicleSnapshot(NamedTuple):
    """One vehicle at planning time.

    active: whether it accepts plans. home: where it started.
    goal: where it is sent before it explores, with right of way over those that explore.
    battery: a vehicle whose battery is low drives home and explores no more; one whose battery is
    critical stays where it is.
    known_places: where it may close a loop.
    has_camera: whether it has one that shows obstacles above and below the plane of the laser.
    """

    pose: Pose2
    active: bool = True
    home: Pose2 | None = None
    body: VehicleBody = VehicleBody()
    goal: Pose2 | None = None
    battery: BatteryLevel = BatteryLevel.OK
    known_places: tuple[KnownPlace, ...] = ()
    has_camera: bool = False


@dataclass(frozen=True)
class Frontier:
    """Known free cells beside unknown ones.

    cells (N, 2); centroid of them (m).
    target: the viewpoint (m) from which a vehicle sees the frontier; target_cell: its cell.
    size: length (m).
    gain: unknown area (m²) that is expected to be seen from the target.
    look_at: centre (m) of the unknown cells behind the frontier.
    showing: area (m²) that a visit is expected to show at least; see expected_showing.
    """

    cells: NDArray[np.int64]
    centroid: Point
    target: Point
    target_cell: Cell
    size: float
    gain: float = 0.0
    look_at: Point | None = None
    showing: float = math.inf


@dataclass(frozen=True)
class PlanningResult:
    """Result of one planning cycle.

    plans: the plan in force of every vehicle that should drive. An unchanged plan is the same
    object as in the last result, so that a plan is sent when its identity changes. A vehicle
    without a plan should stand still.
    waiting: why vehicles have no plan, by name.
    costs (V, F): travel cost (m) of each vehicle, in the order of `vehicles`, to each frontier.
    searched: False if frontiers could not be searched, see reason.
    unreachable: number of frontiers that are left, but given up or out of reach; they are known
    once no target is left. unreached_m2: area that is expected behind them (m²).
    warning: what the operator should know of the map, '' if nothing.
    refused: vehicles whose goal cannot be reached.
    """

    status: ExplorationStatus
    reason: str
    plans: dict[str, Plan] = field(default_factory=dict)
    waiting: dict[str, str] = field(default_factory=dict)
    frontiers: tuple[Frontier, ...] = ()
    vehicles: tuple[str, ...] = ()
    costs: Array = field(default_factory=lambda: np.empty((0, 0)))
    searched: bool = True
    unreachable: int = 0
    refused: tuple[str, ...] = ()
    unreached_m2: float = 0.0
    warning: str = ''


def unreached_text(frontiers: int, area: float) -> str:
    """Return number and area (m²) of what is left, such as '3 frontiers (81 m²)'."""
    return f'{frontiers} {"frontier" if frontiers == 1 else "frontiers"} ({area:.0f} m²)'
