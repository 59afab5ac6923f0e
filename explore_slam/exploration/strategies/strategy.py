"""What a strategy is given, what it returns, and how it is registered."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from explore_slam.data import VehicleBody
from explore_slam.exploration.records import Frontier
from explore_slam.exploration.routes import RouteGrid
from explore_slam.exploration.sections import AssignmentConfig
from explore_slam.geometry import Array


class RouteSource(Protocol):
    """Source of travel costs between any two places."""

    def routes(self, vehicle: str) -> RouteGrid:
        """Return the coarse grid on which they are computed for a vehicle."""


class Situation(NamedTuple):
    """The state of the team in one planning cycle; V vehicles, F frontiers.

    vehicles: names (V,).
    costs: (V, F) m, of travel from each vehicle to each frontier; inf if unreachable.
    current: (V,) index of the frontier that each vehicle is on its way to, or -1.
    switches: (V,) how often each vehicle has switched targets since it last reached one.
    bodies: (V,) size, speed and view of each vehicle; empty: all of them are standard.
    """

    scene: RouteSource
    vehicles: tuple[str, ...]
    frontiers: list[Frontier]
    costs: Array
    current: list[int]
    switches: list[int]
    bodies: tuple[VehicleBody, ...] = ()

    @property
    def kinds(self) -> tuple[VehicleBody, ...]:
        """Size, speed and view of each vehicle (V,)."""
        return self.bodies or (VehicleBody(),) * len(self.vehicles)

    @property
    def slowness(self) -> Array:
        """Time that each vehicle (V,) takes for a way, as a multiple of that of the fastest."""
        speeds = np.array([body.speed for body in self.kinds])
        slowness: Array = speeds.max() / speeds
        return slowness

    @property
    def efforts(self) -> Array:
        """The costs (V, F) as the travel (m) of the fastest vehicle in the same time."""
        efforts: Array = self.costs * self.slowness[:, None]
        return efforts

    def side_ranges(self, usual: float) -> Array:
        """Return how far to the side each vehicle (V,) sees (m); usual: see side_range."""
        return np.array([body.side_range(usual) for body in self.kinds])

    @property
    def targets(self) -> Array:
        """Targets (F, 2) m of the frontiers."""
        return np.array([frontier.target for frontier in self.frontiers])

    def costs_with_hysteresis(self, margin: float) -> Array:
        """Return the efforts with the margin (m) subtracted from those of the current targets.

        The margin doubles with every switch, so that a vehicle cannot alternate for ever.
        """
        biased = self.efforts
        for vehicle, target in enumerate(self.current):
            if target >= 0:
                biased[vehicle, target] -= margin * 2.0 ** self.switches[vehicle]
        return biased


class Strategy(Protocol):
    """Assigns frontiers to vehicles, cycle by cycle."""

    def assign(self, situation: Situation) -> list[int]:
        """Return for each vehicle the index of its frontier, -1 for none."""


@dataclass(frozen=True)
class StrategyKind:
    """A strategy as it is registered.

    create: from its parameters and the range (m) of the laser.
    probability_costs: charge cells with their probability, as in the paper, and compute costs on
    the full grid; otherwise clearance is charged too, and costs are computed on blocks of cells.
    """

    create: Callable[[AssignmentConfig, float], Strategy]
    probability_costs: bool = False
