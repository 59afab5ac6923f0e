"""Selection of the topics of a recording: vehicles, and frames or landmarks."""

from collections.abc import Iterable, Mapping

from explore_slam.errors import RecordingError
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.topics import COLOR_TOPICS, RecordedTopic, TopicKind, vehicle_topic

# one of these makes a recording of a vehicle useful
_SENSORS = {TopicKind.ODOMETRY, TopicKind.SCAN, *COLOR_TOPICS, TopicKind.LANDMARKS}


def vehicle_topics(
    topics: Mapping[str, str], vehicles: Iterable[str] = ()
) -> tuple[list[RecordedTopic], list[str]]:
    """Return the topics of vehicles among {name: message type}, and warnings about the others.

    vehicles: those asked for; all if empty. RecordingError if one of them has no topic, and for
    a recording without odometry or any sensor.
    """
    wanted = list(vehicles)
    found: list[RecordedTopic] = []
    warnings: list[str] = []
    others: set[str] = set()
    for name in sorted(topics):
        topic = vehicle_topic(name)
        if topic is None:
            continue
        expected = topic.kind.message_type
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


def _check_needed(
    found: list[RecordedTopic], wanted: list[str], topics: Mapping[str, str]
) -> None:
    seen = {topic.vehicle for topic in found}
    missing = [vehicle for vehicle in wanted if vehicle not in seen]
    if missing:
        known = sorted({topic.vehicle for name in topics if (topic := vehicle_topic(name))})
        raise RecordingError(f'no topics of {missing}; the recording holds vehicles {known}')
    if not {topic.kind for topic in found} & _SENSORS:
        raise RecordingError(
            f'no topic of a vehicle: expected <vehicle>/{TopicKind.ODOMETRY.value} and '
            f'<vehicle>/{TopicKind.SCAN.value}, <vehicle>/{TopicKind.COLOR.value} or '
            f'<vehicle>/{TopicKind.LANDMARKS.value}; '
            f'the recording holds {sorted(topics) or "no topics"}'
        )


def frames_or_landmarks(
    topics: list[RecordedTopic], vision: str | None, warnings: list[str]
) -> list[RecordedTopic]:
    """Omit the RGB-D frames or the landmarks of a vehicle that has both.

    The landmarks were extracted from the same frames: using both would count each observation
    twice. vision: 'agent' keeps frames, 'vehicle' landmarks; None keeps landmarks and adds a
    warning.
    """
    kinds: dict[str, set[TopicKind]] = {}
    for topic in topics:
        kinds.setdefault(topic.vehicle, set()).add(topic.kind)
    both = {
        vehicle
        for vehicle, found in kinds.items()
        if TopicKind.LANDMARKS in found and found.intersection(FRAME.topics)
    }
    if both and vision is None:
        warnings.append(f'{sorted(both)}: both frames and landmarks recorded: landmarks are used')
    unused = (TopicKind.LANDMARKS,) if vision == 'agent' else FRAME.topics
    return [topic for topic in topics if topic.vehicle not in both or topic.kind not in unused]
