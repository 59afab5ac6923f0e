"""Which topics carry what; the names of doc/ros_interface, one set per vehicle."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from explore_slam.errors import RecordingError


class TopicKind(Enum):
    """What a topic of a vehicle carries; the value is its name below the vehicle's."""

    SCAN = 'scan'
    ODOMETRY = 'odom'
    COLOR = 'camera/rgb/image_raw'
    COLOR_COMPRESSED = 'camera/rgb/image_raw/compressed'
    DEPTH = 'camera/depth_registered/image_raw'
    DEPTH_COMPRESSED = 'camera/depth_registered/image_raw/compressed'
    DEPTH_COMPRESSED_DEPTH = 'camera/depth_registered/image_raw/compressedDepth'
    CAMERA_INFO = 'camera/rgb/camera_info'
    LANDMARKS = 'landmarks'
    SIGHTINGS = 'sightings'
    GROUND_TRUTH = 'ground_truth'
    INITIAL_POSE = 'initialpose'


MESSAGE_TYPES: Mapping[TopicKind, str] = {
    TopicKind.SCAN: 'sensor_msgs/msg/LaserScan',
    TopicKind.ODOMETRY: 'nav_msgs/msg/Odometry',
    TopicKind.COLOR: 'sensor_msgs/msg/Image',
    TopicKind.COLOR_COMPRESSED: 'sensor_msgs/msg/CompressedImage',
    TopicKind.DEPTH: 'sensor_msgs/msg/Image',
    TopicKind.DEPTH_COMPRESSED: 'sensor_msgs/msg/CompressedImage',
    TopicKind.DEPTH_COMPRESSED_DEPTH: 'sensor_msgs/msg/CompressedImage',
    TopicKind.CAMERA_INFO: 'sensor_msgs/msg/CameraInfo',
    TopicKind.LANDMARKS: 'sensor_msgs/msg/PointCloud2',
    TopicKind.SIGHTINGS: 'geometry_msgs/msg/PoseWithCovarianceStamped',
    TopicKind.GROUND_TRUTH: 'nav_msgs/msg/Odometry',
    TopicKind.INITIAL_POSE: 'geometry_msgs/msg/PoseWithCovarianceStamped',
}
# longest first: 'camera/rgb/image_raw/compressed' must not be taken for anything shorter
_BY_LENGTH = sorted(TopicKind, key=lambda kind: -len(kind.value))
_SENSORS = {
    TopicKind.SCAN,
    TopicKind.COLOR,
    TopicKind.COLOR_COMPRESSED,
    TopicKind.LANDMARKS,
}


_FRAMES = {
    TopicKind.COLOR,
    TopicKind.COLOR_COMPRESSED,
    TopicKind.DEPTH,
    TopicKind.DEPTH_COMPRESSED,
    TopicKind.DEPTH_COMPRESSED_DEPTH,
    TopicKind.CAMERA_INFO,
}


@dataclass(frozen=True)
class VehicleTopic:
    """One topic of one vehicle."""

    name: str
    vehicle: str
    kind: TopicKind


def topic_name(vehicle: str, kind: TopicKind) -> str:
    """Return '/robot1/scan' for ('robot1', SCAN)."""
    return f'/{vehicle}/{kind.value}'


def vehicle_topic(name: str) -> VehicleTopic | None:
    """Tell vehicle and kind from a topic's name; None if it is no topic of a vehicle."""
    for kind in _BY_LENGTH:
        vehicle = name.removesuffix('/' + kind.value).strip('/')
        if name.endswith('/' + kind.value) and vehicle:
            return VehicleTopic(name, vehicle, kind)
    return None


def vehicle_topics(
    topics: Mapping[str, str], vehicles: Iterable[str] = ()
) -> tuple[list[VehicleTopic], list[str]]:
    """Return the vehicles' topics among {name: message type}, and warnings on what is left out.

    Only the given vehicles count, or all when none are given. A vehicle that was asked for and
    has no topic, and a recording without odometry or any sensor, is a RecordingError.
    """
    wanted = list(vehicles)
    found: list[VehicleTopic] = []
    warnings: list[str] = []
    others: set[str] = set()
    for name in sorted(topics):
        topic = vehicle_topic(name)
        if topic is None:
            continue
        expected = MESSAGE_TYPES[topic.kind]
        if topics[name] != expected:
            warnings.append(f'topic {name} is of type {topics[name]}, expected {expected}: unused')
        elif wanted and topic.vehicle not in wanted:
            others.add(topic.vehicle)
        else:
            found.append(topic)
    if others:
        warnings.append(f'unknown vehicles {sorted(others)} in the recording: unused')
    _check_needed(found, wanted, topics)
    return found, warnings


def _check_needed(found: list[VehicleTopic], wanted: list[str], topics: Mapping[str, str]) -> None:
    seen = {topic.vehicle for topic in found}
    missing = [vehicle for vehicle in wanted if vehicle not in seen]
    if missing:
        known = sorted({topic.vehicle for name in topics if (topic := vehicle_topic(name))})
        raise RecordingError(f'no topics of {missing}; the recording holds vehicles {known}')
    kinds = {topic.kind for topic in found}
    if not kinds & (_SENSORS | {TopicKind.ODOMETRY}):
        raise RecordingError(
            'no topic of a vehicle: expected <vehicle>/odom and <vehicle>/scan, '
            f'<vehicle>/{TopicKind.COLOR.value} or <vehicle>/landmarks; '
            f'the recording holds {sorted(topics) or "no topics"}'
        )


def one_kind_of_vision(
    topics: list[VehicleTopic], vision: str | None, warnings: list[str]
) -> list[VehicleTopic]:
    """Leave out a vehicle's frames or its landmarks where both are there: they are the same sight.

    vision: 'agent' takes frames, 'vehicle' landmarks; None takes landmarks and says so.
    """
    kinds: dict[str, set[TopicKind]] = {}
    for topic in topics:
        kinds.setdefault(topic.vehicle, set()).add(topic.kind)
    both = {
        vehicle
        for vehicle, found in kinds.items()
        if TopicKind.LANDMARKS in found and found & _FRAMES
    }
    if both and vision is None:
        warnings.append(f'{sorted(both)}: both frames and landmarks recorded: landmarks are used')
    unused = {TopicKind.LANDMARKS} if vision == 'agent' else _FRAMES
    return [topic for topic in topics if topic.vehicle not in both or topic.kind not in unused]
