"""Offline replay of a recording through the agent: the calls of the live node, without waiting.

Nothing depends on the wall clock or on threads: the same bag gives the same result, bit for bit.
"""

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from explore_slam.data import OdometryReading
from explore_slam.errors import ExploreSlamError, RecordingError
from explore_slam.geometry import Array, Pose2, moved_enough
from explore_slam.messages.base import planar_pose, time_message
from explore_slam.messages.frame_pairing import UNPAIRED, WITHOUT_CAMERA_INFO
from explore_slam.messages.measurement import (
    MeasurementSink,
    RefusedMessageError,
    VehicleReader,
)
from explore_slam.messages.measurement_kinds import KIND_OF_TOPIC, MEASUREMENT_KINDS
from explore_slam.messages.odometry import odometry_record
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import (
    COLOR_TOPICS,
    DEPTH_TOPICS,
    RecordedTopic,
    TopicKind,
    vehicle_topic,
)
from explore_slam.messages.vehicle_settings import VehicleConfig, settings_of_vehicles
from explore_slam.mounts import ExplicitMounts
from explore_slam.recording.bag import BagReader
from explore_slam.recording.events import Event
from explore_slam.recording.ordering import StampOrder, StampStatistics, header_stamp
from explore_slam.recording.recorded_transforms import recorded_transforms
from explore_slam.recording.rosbags_types import MESSAGES, full_name
from explore_slam.recording.sensor_topics import choices_of_settings, with_sensors
from explore_slam.recording.storage.storage import RawMessage
from explore_slam.recording.topic_selection import (
    TopicChoice,
    frames_or_landmarks,
    vehicle_topics,
)

logger = logging.getLogger(__name__)

TICK = 0.1  # s of recorded time between calls of `advance`
# m, rad from the start pose of a live run to the truth where its recording begins: a vehicle that
# has not moved yet stands there to a millimetre
START_TOLERANCE = (0.05, 0.05)
# topics of poses in the map frame; from the first of each the start poses are taken
POSE_KINDS = (TopicKind.INITIAL_POSE, TopicKind.GROUND_TRUTH)

_SCANS = {TopicKind.SCAN, TopicKind.CLOUD}
# kinds of which several messages may have one stamp: one for each vehicle, or one for each camera
_SEVERAL_AT_ONCE = (
    TopicKind.INTER_ROBOT,
    TopicKind.LANDMARKS,
    TopicKind.TAGS,
    TopicKind.CAMERA_INFO,
)


class Listener(MeasurementSink, Protocol):
    """Receiver of a recording; the agent is one."""

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array, /) -> None:
        """Set the pose of a vehicle in the map, with its covariance (3, 3)."""

    def advance(self, stamp: float, /) -> None:
        """Advance the clock to a time (s)."""


@dataclass
class Tally:
    """Counts of records that were fed, and of messages that were refused, with the reasons."""

    fed: dict[str, int] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    first_refusals: dict[str, str] = field(default_factory=dict)

    def feed(self, name: str) -> None:
        """Count a record that was used."""
        self.fed[name] = self.fed.get(name, 0) + 1

    def refuse(self, name: str, reason: str) -> None:
        """Count a message that cannot be used; log the first of each topic."""
        self.refused[name] = self.refused.get(name, 0) + 1
        if name not in self.first_refusals:
            self.first_refusals[name] = reason
            logger.info('%s: %s; this message and similar ones are omitted', name, reason)


class Replay:
    """One bag, the vehicles in it, and their start poses.

    starts, recorded_starts: start poses in the map by vehicle, None: unknown, although the bag
    may hold one; the former take precedence.
    vision: 'agent' or 'vehicle', see topic_selection.frames_or_landmarks.
    choices: topics that the user has chosen by hand.
    settings: of the team and of single vehicles by name (messages.vehicle_settings); scans, clouds
    and cameras among them choose topics, too.
    team_mounts: mounts of the sensors that the settings of the team give explicitly.

    sources: vehicle -> what its odometry is taken from, as in the settings; without odometry in
    the bag, scan.
    """

    def __init__(
        self,
        bag: BagReader,
        vehicles: Iterable[str] = (),
        starts: Mapping[str, Pose2 | None] | None = None,
        recorded_starts: Mapping[str, Pose2 | None] | None = None,
        vision: str | None = None,
        choices: Iterable[TopicChoice] = (),
        settings: Mapping[str, Any] | None = None,
        team_mounts: ExplicitMounts | None = None,
    ) -> None:
        self.bag = bag
        wanted, notes = choices_of_settings(bag.topics, vehicles, settings or {})
        found, warnings = vehicle_topics(bag.topics, vehicles, [*choices, *wanted], bag.rates)
        self._topics = with_sensors(frames_or_landmarks(found, vision, warnings))
        self._notes = [*warnings, *notes]
        self._is_complete = False  # all messages have been read
        self._by_name = {topic.name: topic for topic in self._topics}
        self.vehicles = sorted({topic.vehicle for topic in self._topics})
        self.tally = Tally()
        configs = settings_of_vehicles(settings or {}, self.vehicles)
        self.bodies = {name: config.body.record for name, config in configs.items()}
        self.camera_scans = [name for name, one in configs.items() if one.has_camera_scans]
        self.sources = {name: self._source(name, config) for name, config in configs.items()}
        trees = recorded_transforms(bag, self.vehicles)
        self.mounts = {
            name: SensorMounts(name, trees[name], configs[name], team_mounts)
            for name in self.vehicles
        }
        offsets = {topic.name: self._offset(topic, configs) for topic in self._topics}
        self._order = StampOrder(offsets=offsets)
        self._readers = {
            name: VehicleReader(MEASUREMENT_KINDS, mounts) for name, mounts in self.mounts.items()
        }
        self._find_base_frames()
        self._find_camera_infos()
        given = dict(starts or {})
        unknown = sorted(set(given) - set(self.vehicles))
        if unknown:
            raise RecordingError(
                f'start poses for unknown vehicles {unknown}, expected some of {self.vehicles}'
            )
        self._given = given
        self._recorded = {
            name: pose for name, pose in (recorded_starts or {}).items() if name in self.vehicles
        }

    def _source(self, vehicle: str, config: VehicleConfig) -> str:
        """Return what the odometry of a vehicle is taken from: scans where there is no other."""
        kinds = self.kinds(vehicle)
        if TopicKind.ODOMETRY in kinds or not kinds & _SCANS or config.odometry == 'scan':
            return config.odometry
        self.note(f'{vehicle} has no odometry: its scans are taken for it (odometry: scan)')
        return 'scan'

    @staticmethod
    def _offset(topic: RecordedTopic, configs: Mapping[str, VehicleConfig]) -> int:
        """Return what is added to the stamps of a topic (ns)."""
        if topic.kind not in KIND_OF_TOPIC:
            return 0
        return round(float(getattr(configs[topic.vehicle], KIND_OF_TOPIC[topic.kind].clock)) * 1e9)

    def _find_base_frames(self) -> None:
        """Let the first odometry message of each vehicle name its base frame."""
        waiting = {t.name: t for t in self._topics if t.kind is TopicKind.ODOMETRY}
        for message in self.bag.messages(list(waiting)):
            topic = waiting.pop(message.topic, None)
            if topic is not None:
                try:
                    self.mounts[topic.vehicle].add_odometry(self.bag.decode(message))
                except RecordingError:  # counted and named when the events are read
                    waiting[message.topic] = topic
            if not waiting:
                break

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the recording, and what was chosen without being asked for."""
        return [*self.bag.warnings, *self._notes]

    def topic_of(self, vehicle: str, kind: TopicKind) -> str | None:
        """Return the name of a vehicle's topic of a kind in the recording."""
        names = [t.name for t in self._topics if t.vehicle == vehicle and t.kind is kind]
        return names[0] if names else None

    def kinds(self, vehicle: str) -> set[TopicKind]:
        """Return the kinds of topics that the recording holds of a vehicle."""
        return {topic.kind for topic in self._topics if topic.vehicle == vehicle}

    def start_poses(self) -> dict[str, Pose2 | None]:
        """Return the start pose of each vehicle: as given, of the live run, or from the bag.

        In the bag the first initialpose counts, else the first ground truth. The start pose of a
        live run does not count where the ground truth differs: the recording began after the
        vehicle had moved. RecordingError if one of several vehicles has none; a single vehicle
        starts at the origin.
        """
        first = self._first_poses(set(self.vehicles) - set(self._given))
        found: dict[str, Pose2 | None] = dict(self._given)
        for vehicle in sorted(set(self.vehicles) - set(found)):
            if vehicle in self._recorded and self._recorded[vehicle] is None:
                found[vehicle] = None
                continue
            truth = first.get((vehicle, TopicKind.GROUND_TRUTH))
            initial = first.get((vehicle, TopicKind.INITIAL_POSE))
            recorded = self._recorded.get(vehicle)
            if (
                recorded is not None
                and truth is not None
                and moved_enough(recorded.between(truth), *START_TOLERANCE)
            ):
                self.note(
                    f'the recording of {vehicle} begins after it had moved: its start pose is '
                    'taken from its ground truth'
                )
                found[vehicle] = truth
            elif recorded is not None:
                found[vehicle] = recorded
            elif initial is not None:
                found[vehicle] = initial
            elif truth is not None:
                found[vehicle] = truth
                self.note(f'start pose of {vehicle} is taken from its ground truth')
        return self._with_defaults(found)

    def _first_poses(self, vehicles: set[str]) -> dict[tuple[str, TopicKind], Pose2]:
        """Return the first usable pose of each topic of POSE_KINDS of some vehicles."""
        topics = {
            topic.name: topic
            for topic in self._topics
            if topic.kind in POSE_KINDS and topic.vehicle in vehicles
        }
        first: dict[tuple[str, TopicKind], Pose2] = {}
        for message in self.bag.messages(list(topics)) if topics else ():
            topic = topics[message.topic]
            key = (topic.vehicle, topic.kind)
            if key in first:
                continue
            pose = self._pose_in(topic, message)
            if pose is not None:
                first[key] = pose
            if len(first) == len(topics):
                break
        return first

    def _with_defaults(self, found: dict[str, Pose2 | None]) -> dict[str, Pose2 | None]:
        missing = [vehicle for vehicle in self.vehicles if vehicle not in found]
        if missing and len(self.vehicles) > 1:
            topics = ', '.join(f'<vehicle>/{kind.value}' for kind in POSE_KINDS)
            raise RecordingError(
                f'no start pose of {missing}: expected {topics}, or --start VEHICLE=X,Y,THETA '
                'or --start VEHICLE=unknown'
            )
        if missing:
            self.note(f'start pose of {missing[0]} is not recorded: (0, 0, 0) is used')
            found[missing[0]] = Pose2(0.0, 0.0, 0.0)
        return {vehicle: found[vehicle] for vehicle in self.vehicles}

    def _pose_in(self, topic: RecordedTopic, message: RawMessage) -> Pose2 | None:
        try:
            return planar_pose(self.bag.decode(message).pose.pose)
        except ExploreSlamError as error:
            self.tally.refuse(topic.name, str(error))
            return None

    def events(self, progress: Callable[[float], None] | None = None) -> Generator[Event]:
        """Yield the records of the bag in the order of stamps.

        The first pose that was set of a vehicle is its start, and left out where this is given as
        unknown; of a live run with an unknown start, it was set by the operator.
        progress: called with the fraction of the bag that has been read.
        """
        unknown = {vehicle for vehicle, pose in self._given.items() if pose is None}
        self._is_complete = False
        try:
            for event in self._all_events(progress):
                if event.kind is TopicKind.INITIAL_POSE and event.vehicle in unknown:
                    unknown.remove(event.vehicle)
                    continue
                yield event
            self._is_complete = True
        finally:
            self._report_losses()

    def _all_events(self, progress: Callable[[float], None] | None) -> Iterator[Event]:
        span = max(self.bag.end - self.bag.start, 1)
        for stamp, message in self._order.sort(self.bag.messages(set(self._by_name))):
            if progress is not None:
                progress((message.log_time - self.bag.start) / span)
            topic = self._by_name[message.topic]
            try:
                decoded = self.bag.decode(message)
                if stamp and header_stamp(message.data) == 0:
                    decoded.header.stamp = time_message(MESSAGES, stamp * 1e-9)
                event = self._event(topic, stamp * 1e-9, decoded)
            except RefusedMessageError as error:
                refused = self.topic_of(topic.vehicle, error.topic)
                self.tally.refuse(refused or topic.name, str(error))
            except ExploreSlamError as error:
                self.tally.refuse(topic.name, str(error))
            else:
                if event is not None:
                    yield event

    def feed(
        self,
        listener: Listener,
        *,
        also: Callable[[Event], None] | None = None,
        tick: Callable[[float], None] | None = None,
        progress: Callable[[float], None] | None = None,
        until: float | None = None,
    ) -> Tally:
        """Feed the recording to an agent.

        also: called with every event before it is fed.
        tick: called with the recorded time (s), ten times a second of it.
        until: seconds after the start of the recording at which the replay ends.
        """
        begin: float | None = None
        next_tick = 0.0
        events = self.events(progress)
        for event in events:
            if begin is None or event.stamp < next_tick - 2 * TICK:
                begin, next_tick = event.stamp if begin is None else begin, event.stamp
            if until is not None and event.stamp > begin + until:
                break
            if event.stamp >= next_tick:
                listener.advance(event.stamp)
                if tick is not None:
                    tick(event.stamp)
                next_tick = event.stamp + TICK
            if also is not None:
                also(event)
            try:
                self._feed_one(listener, event, event.stamp == begin)
            except ExploreSlamError as error:
                self.tally.refuse(f'{event.vehicle}/{event.kind.value}', str(error))
            else:
                self.tally.feed(f'{event.vehicle}/{event.kind.value}')
        events.close()
        return self.tally

    @staticmethod
    def _feed_one(listener: Listener, event: Event, first: bool) -> None:
        if event.kind in KIND_OF_TOPIC:
            listener.add(event.vehicle, event.record)
        elif (
            event.kind is TopicKind.INITIAL_POSE
            and isinstance(event.record, OdometryReading)
            and event.record.covariance is not None
            and not first
        ):
            # the first one is the start pose, which the agent knows already
            listener.set_pose(event.vehicle, event.record.pose, event.record.covariance)

    def _event(self, topic: RecordedTopic, stamp: float, message: Any) -> Event | None:
        if topic.kind in POSE_KINDS:
            return Event(stamp, topic.vehicle, topic.kind, odometry_record(message))
        found = self._readers[topic.vehicle].read(topic.kind, message, topic.sensor)
        if found is None:
            return None
        kind, record = found
        return Event(stamp, topic.vehicle, kind.topics[0], record)

    def _report_losses(self) -> None:
        for text in self._order.notes():
            self.note(text)
        for vehicle, reader in sorted(self._readers.items()):
            for what, count in reader.losses().items():
                if count:
                    self.note(f'{vehicle}: {count} {reader.explanations()[what]}: omitted')
        for topic, count in sorted(self.tally.refused.items()):
            self.note(f'{count} messages on {topic} refused; {self.tally.first_refusals[topic]}')

    def unusable(self) -> list[str]:
        """Return the topics of which more than half of the messages could not be used, and why.

        Ground truth and initial poses are not needed: they are left out here.
        """
        found = [
            f'no message on {name} can be used: {reason}'
            for name, (kind, reason) in sorted(self.bag.unusable.items())
            if self._is_needed(name, kind)
        ]
        for topic in self._topics:
            if topic.kind not in KIND_OF_TOPIC:
                continue
            known = self._order.statistics.get(topic.name, StampStatistics())
            expected = self.bag.expected.get(topic.name, 0) if self._is_complete else 0
            named = (topic.name, f'{topic.vehicle}/{topic.kind.value}')  # as read, as fed
            refused = sum(self.tally.refused.get(name, 0) for name in named)
            first = next(filter(None, map(self.tally.first_refusals.get, named)), '')
            frozen = 0 if topic.kind in _SEVERAL_AT_ONCE else known.repeated
            backwards = known.backwards if known.is_reversed else 0
            reasons = {
                f'{backwards} have an earlier stamp than the one before': backwards,
                f'{frozen} have the stamp of the one before': frozen,
                f'{max(expected - known.count, 0)} cannot be read, see the notes': max(
                    expected - known.count, 0
                ),
                f'{known.late} came out of order': known.late,
                f'{known.malformed} are too short': known.malformed,
                f'{refused} refused: {first}': refused,
            }
            lost, count = sum(reasons.values()), max(known.count, expected)
            if 2 * lost > count:
                why = '; '.join(text for text, number in reasons.items() if number)
                found.append(f'{lost} of {count} messages on {topic.name} unusable: {why}')
        return found + self._lost_images()

    def _lost_images(self) -> list[str]:
        """Return the vehicles of which most images gave no frame, and why."""
        found = []
        for vehicle, reader in sorted(self._readers.items()):
            numbers = [
                self._order.statistics[topic.name].count
                for topic in self._topics
                if topic.vehicle == vehicle
                and topic.kind in (*COLOR_TOPICS, *DEPTH_TOPICS)
                and topic.name in self._order.statistics
            ]
            losses = reader.losses()
            frames_lost = losses.get(WITHOUT_CAMERA_INFO, 0)
            lost = losses.get(UNPAIRED, 0) + 2 * frames_lost
            if 2 * lost > sum(numbers) > 0:
                why = '; '.join(
                    f'{count} {reader.explanations()[what]}'
                    for what, count in losses.items()
                    if count
                )
                found.append(f'most of {sum(numbers)} images of {vehicle} unusable: {why}')
        return found

    def _find_camera_infos(self) -> None:
        """Let each camera have its first camera_info before its first image.

        It may have been published once, or recorded later than the images.
        """
        waiting = {t.name: t for t in self._topics if t.kind is TopicKind.CAMERA_INFO}
        for message in self.bag.messages(list(waiting)) if waiting else ():
            topic = waiting.pop(message.topic, None)
            if topic is not None:
                try:
                    reader = self._readers[topic.vehicle]
                    reader.read(topic.kind, self.bag.decode(message), topic.sensor)
                except ExploreSlamError:  # counted and named when the events are read
                    waiting[message.topic] = topic
            if not waiting:
                break

    def _is_needed(self, name: str, kind: str) -> bool:
        """Return whether a topic that cannot be used seems to be a measurement of a vehicle."""
        types = {topic.message_type for topic in KIND_OF_TOPIC}
        missing = any(not self.kinds(v) & {TopicKind.SCAN, *COLOR_TOPICS} for v in self.vehicles)
        return missing and (full_name(kind) in types or vehicle_topic('/x' + name) is not None)

    def note(self, text: str) -> None:
        """Add a warning."""
        logger.info('%s', text)
        self._notes.append(text)
