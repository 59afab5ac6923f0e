"""What a measurement kind consists of."""

from collections.abc import Callable
from dataclasses import dataclass

from explore_slam.agent.measurement_queue import Stamped
from explore_slam.agent.team import Team
from explore_slam.agent.vehicle_track import VehicleTrack


def _accept(_team: Team, _measurement: Stamped) -> None:
    """Accept every measurement."""


def enqueue(team: Team, track: VehicleTrack, measurement: Stamped) -> None:
    """Queue a measurement until odometry reaches its stamp."""
    track.wait(measurement, team.config.inputs.measurement_queue_length)


@dataclass(frozen=True)
class MeasurementHandler[M: Stamped]:
    """How the agent treats one type of record.

    record: type of the record.
    process: use a measurement; odometry has reached its stamp.
    check: raise AgentError for a record that can never be used.
    enqueue: store a new measurement until it is due.
    draws_map: the record enters the map; it is ignored while its vehicle is displaced.
    """

    record: type[M]
    process: Callable[[Team, VehicleTrack, M], None]
    check: Callable[[Team, M], None] = _accept
    enqueue: Callable[[Team, VehicleTrack, M], None] = enqueue
    draws_map: bool = False
