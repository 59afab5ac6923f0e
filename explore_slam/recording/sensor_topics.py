"""Topics of several lasers or cameras of one vehicle in a recording."""

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.imu import IMU
from explore_slam.messages.scans import SCAN
from explore_slam.messages.topics import COLOR_TOPICS, RecordedTopic, TopicKind
from explore_slam.messages.vehicle_settings import VehicleConfig, settings_of_vehicles
from explore_slam.recording.topic_selection import SINGLE_VEHICLE, TopicChoice

_LASER_TOPICS, _CAMERA_TOPICS = SCAN.topics, FRAME.topics
_COMPRESSED = ('/compressed', '/compressedDepth')


def choices_of_settings(
    topics: Mapping[str, str], vehicles: Iterable[str], settings: Mapping[str, Any]
) -> tuple[list[TopicChoice], list[str]]:
    """Return the topics that scans, clouds and cameras in settings name, and notes about them.

    topics: message types by name. vehicles: those asked for; if empty, those in whose namespace
    is odometry, or the one of a recording without namespaces.
    """
    names = list(vehicles) or _vehicles_with_odometry(topics) or [SINGLE_VEHICLE]
    found: list[TopicChoice] = []
    notes: list[str] = []
    plain = VehicleConfig()
    for vehicle, config in settings_of_vehicles(settings, names).items():
        wanted = []
        if (config.scans, config.clouds) != (plain.scans, plain.clouds):
            wanted += config.laser_topics
        if config.cameras != plain.cameras:
            wanted += config.camera_topics(_CAMERA_TOPICS)
        if config.imu != plain.imu:
            wanted += IMU.topics_of(config)
        missing = []
        for topic in wanted:
            names_there = (f'/{vehicle}/{topic.name}', f'/{topic.name}')
            full = next((name for name in names_there if name in topics), '')
            if full and topics[full] == topic.kind.message_type:
                found.append(TopicChoice(vehicle, topic.kind, full))
            elif topic.kind in (*_LASER_TOPICS, TopicKind.IMU):
                missing.append(f'{topic.name} ({topic.kind.message_type})')
        if missing:
            notes.append(f'{vehicle}: the recording does not hold {", ".join(missing)}')
    return found, notes


def _vehicles_with_odometry(topics: Mapping[str, str]) -> list[str]:
    ending = f'/{TopicKind.ODOMETRY.value}'
    own = (name.removesuffix(ending).strip('/') for name in sorted(topics) if ending in name)
    return [name for name in own if name and '/' not in name]


def with_sensors(topics: Iterable[RecordedTopic]) -> list[RecordedTopic]:
    """Return the topics of a recording with their sensors, where a vehicle has several.

    A laser is named as its topic, a camera as the beginning of the names of its topics.
    """
    found = list(topics)
    for vehicle in {topic.vehicle for topic in found}:
        own = [topic for topic in found if topic.vehicle == vehicle]
        lasers = [topic for topic in own if topic.kind in _LASER_TOPICS]
        named: dict[str, str] = {}  # full name of a topic -> sensor
        if len(lasers) > 1:
            named = {topic.name: _relative(topic) for topic in lasers}
        cameras = sorted({_camera(topic) for topic in own if topic.kind in COLOR_TOPICS})
        if len(cameras) > 1:
            for topic in own:
                if topic.kind in _CAMERA_TOPICS:
                    name = _relative(topic)
                    named[topic.name] = _nearest(name, cameras)
        found = [
            topic._replace(sensor=named[topic.name])
            if topic.vehicle == vehicle and topic.name in named
            else topic
            for topic in found
        ]
    return found


def _nearest(name: str, cameras: list[str]) -> str:
    """Return the camera whose name begins most like that of a topic."""

    def alike(camera: str) -> int:
        pairs = zip(camera, name, strict=False)
        return sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], pairs))

    return max(cameras, key=alike)


def _relative(topic: RecordedTopic) -> str:
    """Return the name of a topic below the namespace of its vehicle."""
    return topic.name.removeprefix(f'/{topic.vehicle}/').strip('/')


def _camera(topic: RecordedTopic) -> str:
    """Return the camera of a colour image: its name without what all cameras have in common."""
    name = _relative(topic)
    for ending in _COMPRESSED:
        name = name.removesuffix(ending)
    usual = str(TopicKind.COLOR.value).removeprefix('camera')
    return name.removesuffix(usual)
