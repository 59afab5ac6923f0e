"""Correlated errors of repeated observations of one landmark by one vehicle.

Measurements of a landmark from about the same place have about the same error: ranges from the
size of a bar code or from stereo have a bias per view, not white noise. On MR.CLAM 6 successive
range errors of a landmark correlate by 0.94 to 0.97, bearing errors by 0.4 to 0.8
(`benchmarks/noise_mrclam.py`). Of a first-order autoregressive error with correlation ρ, n
samples carry the information of n (1 − ρ)/(1 + ρ) independent ones, so each counts with its
covariance times (1 + ρ)/(1 − ρ).
"""

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.slam.checkpoint import State
from explore_slam.slam.config import CorrelationConfig
from explore_slam.slam.storage.row_format import Places

# Largest correlation: an observation keeps at least a thousandth of its information.
_LARGEST = 0.998

# m and rad; in which landmarks pass through the view of a camera of 60°, at a distance of 1 to 2 m
_VIEW = np.array([1.0, 1.0])


class ObservationCorrelation:
    """Where and when each vehicle observed each landmark last.

    Motion is measured as (distance m, turn rad, time s) in units of the correlation lengths.
    """

    def __init__(self, vehicles: int, config: CorrelationConfig) -> None:
        self.config = config
        self._travelled = np.zeros((vehicles, 2))  # distance (m) and turn (rad) so far
        # by vehicle and entry of the map: id observed there, distance, turn and stamp
        self._ids = np.full((vehicles, 0), -1, np.int64)
        self._last = np.empty((vehicles, 0, 3))
        # by observer and target: whether observed, distance and turn of both, and stamp
        self._met = np.zeros((vehicles, vehicles), np.bool_)
        self._vehicles = np.zeros((vehicles, vehicles, 3))

    def predict(self, vehicle: int, increment: Pose2) -> None:
        """Note the motion of a vehicle."""
        moved = float(np.hypot(increment.x, increment.y))
        self._travelled[vehicle] += (moved, abs(increment.theta))

    def factor_between(self, vehicle: int, target: int, stamp: float) -> float:
        """Return the factor for an observation of another vehicle.

        Its error changes as either of the two moves.
        """
        if not self.config.correlated_observations or not self._met[vehicle, target]:
            return 1.0
        now = np.append(self._travelled[vehicle] + self._travelled[target], stamp)
        return float(self._inflation(now - self._vehicles[vehicle, target]))

    def add_between(self, vehicle: int, target: int, stamp: float) -> None:
        """Note that a vehicle observed another one now."""
        now = np.append(self._travelled[vehicle] + self._travelled[target], stamp)
        self._met[vehicle, target] = True
        self._vehicles[vehicle, target] = now

    def factors(self, vehicle: int, stamp: float, entries: Places, ids: Places) -> Array:
        """Return (K,) by how much the covariance of each observation grows, 1 or more.

        entries (K,) of the landmarks observed, -1 for none, and their ids (K,).
        """
        factors = np.ones(len(entries))
        if not self.config.correlated_observations:
            return factors
        self._reserve(int(entries.max(initial=-1)) + 1)
        known = np.flatnonzero(entries >= 0)
        known = known[self._ids[vehicle, entries[known]] == ids[known]]
        since = np.append(self._travelled[vehicle], stamp) - self._last[vehicle, entries[known]]
        factors[known] = self._inflation(since)
        return factors

    def ages(self, vehicle: int, entries: Places, ids: Places) -> Array:
        """Return (K,) the motion of a vehicle since it observed landmarks, infinite if never.

        entries (K,) of the landmarks and their ids (K,). The unit is the motion in which landmarks
        pass through the view of a camera; of distance and turn, the larger counts.
        """
        self._reserve(int(entries.max(initial=-1)) + 1)
        moved = self._travelled[vehicle] - self._last[vehicle, entries, :2]
        known = self._ids[vehicle, entries] == ids
        ages: Array = np.where(known, (moved / _VIEW).max(axis=1), np.inf)
        return ages

    def _inflation(self, since: Array) -> Array:
        """Return (1 + ρ)/(1 − ρ) for motions (…, 3) since the last observation."""
        rho = np.exp(-(np.abs(since) / self.config.lengths()).sum(axis=-1))
        rho = np.minimum(rho, _LARGEST)
        inflation: Array = (1.0 + rho) / (1.0 - rho)
        return inflation

    def add(self, vehicle: int, stamp: float, entries: Places, ids: Places) -> None:
        """Note that a vehicle observed landmarks (K,), -1 for none, now."""
        self._reserve(int(entries.max(initial=-1)) + 1)
        known = entries >= 0
        self._ids[vehicle, entries[known]] = ids[known]
        self._last[vehicle, entries[known]] = np.append(self._travelled[vehicle], stamp)

    def state_dict(self) -> State:
        """Return everything."""
        return {
            'travelled': self._travelled,
            'ids': self._ids,
            'last': self._last,
            'met': self._met,
            'vehicles': self._vehicles,
        }

    def restore(self, state: State) -> None:
        """Restore what `state_dict` returned."""
        self._travelled = state['travelled'].copy()
        self._met, self._vehicles = state['met'].copy(), state['vehicles'].copy()
        self._ids, self._last = state['ids'].copy(), state['last'].copy()

    def _reserve(self, entries: int) -> None:
        vehicles, have = self._ids.shape
        if entries > have:
            extra = max(entries - have, have // 2 + 256)
            self._ids = np.concatenate([self._ids, np.full((vehicles, extra), -1, np.int64)], 1)
            self._last = np.concatenate([self._last, np.zeros((vehicles, extra, 3))], 1)
