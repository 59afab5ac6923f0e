"""The kinds of measurements that the agent processes; a new kind is a module and a line here."""

from typing import Any

from explore_slam.agent.measurements.frames import FRAMES
from explore_slam.agent.measurements.inter_robot import INTER_ROBOT
from explore_slam.agent.measurements.kind import MeasurementHandler
from explore_slam.agent.measurements.landmarks import LANDMARKS
from explore_slam.agent.measurements.obstacles import OBSTACLES
from explore_slam.agent.measurements.scans import SCANS
from explore_slam.agent.measurements.tags import TAGS
from explore_slam.errors import AgentError

KINDS: tuple[MeasurementHandler[Any], ...] = (
    SCANS, FRAMES, LANDMARKS, TAGS, OBSTACLES, INTER_ROBOT,
)  # fmt: skip

_BY_RECORD = {kind.record: kind for kind in KINDS}


def kind_of(measurement: object) -> MeasurementHandler[Any]:
    """Return the kind of a measurement; AgentError if the type of the record is unknown."""
    kind = _BY_RECORD.get(type(measurement))
    if kind is None:
        names = [record.__name__ for record in _BY_RECORD]
        raise AgentError(f'measurement is a {type(measurement).__name__}, expected one of {names}')
    return kind
