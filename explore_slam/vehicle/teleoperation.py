"""Arbitration of velocity commands: teleoperation goes before the path follower."""

import math


class Teleoperation:
    """Knows whether somebody drives the vehicle by hand; all times are monotonic seconds."""

    def __init__(self) -> None:
        self._last = -math.inf

    def command(self, now: float) -> None:
        """Take note of a command by hand, also of one to stand."""
        self._last = now

    def is_active(self, now: float, timeout: float) -> bool:
        """Return whether the last command is younger than timeout (s)."""
        return now - self._last < timeout
