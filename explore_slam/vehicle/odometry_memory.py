"""The odometry frame of a robot in a file, so that it survives a restart of the driver."""

import json
import logging
import math
import os
import time
from pathlib import Path

import numpy as np

from explore_slam.geometry import Array, Pose2
from explore_slam.vehicle.arcos_status import CounterState

_log = logging.getLogger(__name__)
_PERIOD = 1.0  # s between writes while the vehicle moves; counters make up for older ones


class OdometryMemory:
    """Keeps pose, counters and covariance of one robot in a JSON file.

    A robot goes on counting when its driver ends: as long as it has power, the next driver can
    continue the frame. A file that cannot be read or written costs that, and a warning.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._written = -math.inf
        self._last: CounterState | None = None
        self._failed = False

    def load(self, robot: str) -> tuple[CounterState, Array] | None:
        """Return counters and covariance (3, 3) of a robot; None for another one or none.

        robot: name and subclass that it reports.
        """
        try:
            content = json.loads(self.path.read_text(encoding='utf-8'))
            if content['robot'] != robot:
                return None
            pose = Pose2(*(float(value) for value in content['pose']))
            x, y, heading = (int(value) for value in content['counters'])
            covariance = np.array(content['covariance'], dtype=np.float64)
            if covariance.shape != (3, 3) or not np.isfinite([*pose, *covariance.flat]).all():
                raise ValueError('numbers that are not finite, or too few')
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            _log.warning('%s: cannot be read, odometry begins at zero (%s)', self.path, error)
            return None
        return CounterState(pose, x, y, heading), covariance

    def save(
        self, robot: str, state: CounterState, covariance: Array, *, now: bool = False
    ) -> None:
        """Write the state if it has changed, at most once a second unless it must be now."""
        time_now = time.monotonic()
        if state == self._last or (not now and time_now - self._written < _PERIOD):
            return
        self._written, self._last = time_now, state
        content = {
            'robot': robot,
            'pose': list(state.pose),
            'counters': [state.x, state.y, state.heading],
            'covariance': covariance.tolist(),
        }
        # not synchronized with the disk, which may take long: the robot waits for its commands
        draft = self.path.with_name(self.path.name + '.new')
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(content), encoding='utf-8')
            os.replace(draft, self.path)
        except OSError as error:
            if not self._failed:
                _log.warning(
                    '%s: cannot be written, a restart of the driver begins a new odometry frame '
                    '(%s)', self.path, error,
                )  # fmt: skip
            self._failed = True
