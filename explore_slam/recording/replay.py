"""A recording through the agent, offline: the calls that a live node makes, as fast as they go.

Nothing depends on the wall clock or on threads: the same bag gives the same result, bit for bit.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from explore_slam import messages
from explore_slam.data import (
    OdometryReading,
    RgbdFrame,
)
from explore_slam.errors import ExploreSlamError, RecordingError
from explore_slam.geometry import Array, Pose2
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.messages.topics import (
    TopicKind,
    VehicleTopic,
    one_kind_of_vision,
    vehicle_topics,
)
from explore_slam.recording.bag import BagReader
from explore_slam.recording.events import Event
from explore_slam.recording.ordering import StampOrder
from explore_slam.recording.salvage import RawMessage

logger = logging.getLogger(__name__)

TICK = 0.1
START_KINDS = (TopicKind.INITIAL_POSE, TopicKind.GROUND_TRUTH)
_COLOR = (TopicKind.COLOR, TopicKind.COLOR_COMPRESSED)
_DEPTH = (TopicKind.DEPTH, TopicKind.DEPTH_COMPRESSED, TopicKind.DEPTH_COMPRESSED_DEPTH)


class Listener(Protocol):
    """What a recording is fed to; the agent is one."""

    def add(self, vehicle: str, record: Any) -> None:
        """Add odometry or a measurement of a vehicle."""

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Put a vehicle where a person says it is."""

    def advance(self, stamp: float) -> None:
        """Tell the time (s)."""


@dataclass
class Tally:
    """What became of the messages: fed per topic kind, and what was left out and why."""

    fed: dict[str, int] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    first_refusals: dict[str, str] = field(default_factory=dict)

    def feed(self, name: str) -> None:
        """Count a record that was used."""
        self.fed[name] = self.fed.get(name, 0) + 1

    def refuse(self, name: str, reason: str) -> None:
        """Count a message that cannot be used; the first of each topic is logged."""
        self.refused[name] = self.refused.get(name, 0) + 1
        if name not in self.first_refusals:
            self.first_refusals[name] = reason
            logger.info('%s: %s; it is left out, and so are others like it', name, reason)


class Replay:
    """One bag, the vehicles in it, and where they start."""

    def __init__(
        self,
        bag: BagReader,
        vehicles: Iterable[str] = (),
        starts: Mapping[str, Pose2] | None = None,
        recorded_starts: Mapping[str, Pose2] | None = None,
        vision: str | None = None,
    ) -> None:
        self.bag = bag
        found, warnings = vehicle_topics(bag.topics, vehicles)
        self._topics = one_kind_of_vision(found, vision, warnings)
        self.warnings = list(bag.warnings) + warnings
        self._by_name = {topic.name: topic for topic in self._topics}
        self.vehicles = sorted({topic.vehicle for topic in self._topics})
        self.tally = Tally()
        self._order = StampOrder()
        self._pairers = {vehicle: FramePairing() for vehicle in self.vehicles}
        given = dict(starts or {})
        unknown = sorted(set(given) - set(self.vehicles))
        if unknown:
            raise RecordingError(
                f'start poses for unknown vehicles {unknown}, expected some of {self.vehicles}'
            )
        known = {**(recorded_starts or {}), **given}
        self._given = {name: pose for name, pose in known.items() if name in self.vehicles}

    def kinds(self, vehicle: str) -> set[TopicKind]:
        """Tell what the recording holds of a vehicle."""
        return {topic.kind for topic in self._topics if topic.vehicle == vehicle}

    def start_poses(self) -> dict[str, Pose2]:
        """Return where each vehicle starts: as given or recorded, initialpose, or the truth."""
        found = dict(self._given)
        names = [topic.name for topic in self._topics if topic.kind in START_KINDS]
        truths: dict[str, Pose2] = {}
        waiting = set(self.vehicles) - set(found)
        for message in self.bag.messages(names) if waiting and names else ():
            topic = self._by_name[message.topic]
            pose = self._start_in(topic, message)
            if pose is None:
                continue
            if topic.kind is TopicKind.INITIAL_POSE:
                found.setdefault(topic.vehicle, pose)
            else:
                truths.setdefault(topic.vehicle, pose)
            if all(
                vehicle in found or self._truth_is_start(vehicle, truths) for vehicle in waiting
            ):
                break
        for vehicle in sorted(waiting - set(found)):
            if vehicle in truths:
                found[vehicle] = truths[vehicle]
                self._note(f'start pose of {vehicle} is taken from its ground truth')
        return self._with_defaults(found)

    def _truth_is_start(self, vehicle: str, truths: dict[str, Pose2]) -> bool:
        return vehicle in truths and TopicKind.INITIAL_POSE not in self.kinds(vehicle)

    def _with_defaults(self, found: dict[str, Pose2]) -> dict[str, Pose2]:
        missing = [vehicle for vehicle in self.vehicles if vehicle not in found]
        if missing and len(self.vehicles) > 1:
            raise RecordingError(
                f'no start pose of {missing}: expected <vehicle>/initialpose, '
                '<vehicle>/ground_truth, or --start VEHICLE=X,Y,THETA'
            )
        if missing:
            self._note(f'start pose of {missing[0]} is not recorded: (0, 0, 0) is taken')
            found[missing[0]] = Pose2(0.0, 0.0, 0.0)
        return {vehicle: found[vehicle] for vehicle in self.vehicles}

    def _start_in(self, topic: VehicleTopic, message: RawMessage) -> Pose2 | None:
        try:
            return messages.planar_pose(self.bag.decode(message).pose.pose)
        except ExploreSlamError as error:
            self.tally.refuse(topic.name, str(error))
            return None

    def events(self, progress: Callable[[float], None] | None = None) -> Iterator[Event]:
        """Yield what the bag holds in the order of stamps; progress is told the share read."""
        span = max(self.bag.end - self.bag.start, 1)
        for stamp, message in self._order.sort(self.bag.messages(set(self._by_name))):
            if progress is not None:
                progress((message.log_time - self.bag.start) / span)
            topic = self._by_name[message.topic]
            try:
                event = self._event(topic, stamp * 1e-9, self.bag.decode(message))
            except ExploreSlamError as error:
                self.tally.refuse(topic.name, str(error))
                continue
            if event is not None:
                yield event
        self._report_losses()

    def feed(
        self,
        listener: Listener,
        *,
        also: Callable[[Event], None] | None = None,
        tick: Callable[[float], None] | None = None,
        progress: Callable[[float], None] | None = None,
        until: float | None = None,
    ) -> Tally:
        """Feed the recording to an agent; `also` sees every event, `tick` each 0.1 s of its time.

        until: seconds from the start of the recording after which it is left off.
        """
        begin: float | None = None
        next_tick = 0.0
        for event in self.events(progress):
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
        return self.tally

    @staticmethod
    def _feed_one(listener: Listener, event: Event, first: bool) -> None:
        vehicle, record = event.vehicle, event.record
        if event.kind not in START_KINDS:
            listener.add(vehicle, record)
        elif (
            event.kind is TopicKind.INITIAL_POSE
            and isinstance(record, OdometryReading)
            and record.covariance is not None
            and not first
        ):
            # the first one is where the vehicle starts, which the agent knows already
            listener.set_pose(vehicle, record.pose, record.covariance)

    def _event(self, topic: VehicleTopic, stamp: float, message: Any) -> Event | None:
        kind, vehicle = topic.kind, topic.vehicle
        if kind in (TopicKind.ODOMETRY, TopicKind.GROUND_TRUTH, TopicKind.INITIAL_POSE):
            return Event(stamp, vehicle, kind, messages.odometry_record(message))
        if kind is TopicKind.SCAN:
            return Event(stamp, vehicle, kind, messages.scan_record(message))
        if kind is TopicKind.LANDMARKS:
            return Event(stamp, vehicle, kind, messages.landmarks_record(message))
        if kind is TopicKind.SIGHTINGS:
            return Event(stamp, vehicle, kind, messages.sighting_record(message))
        pairer = self._pairers[vehicle]
        frame: RgbdFrame | None = None
        if kind in _COLOR:
            frame = pairer.add_color(message)
        elif kind in _DEPTH:
            frame = pairer.add_depth(message)
        else:
            pairer.add_camera_info(message)
        return None if frame is None else Event(stamp, vehicle, TopicKind.COLOR, frame)

    def _report_losses(self) -> None:
        for topic, count in sorted(self._order.malformed.items()):
            self._note(f'{count} messages on {topic} are too short for their header: left out')
        for topic, count in sorted(self._order.late.items()):
            self._note(f'{count} messages on {topic} came more than 2 s out of order: left out')
        for before, after in self._order.clock_jumps:
            self._note(f'the recorded clock jumps back from {before:.3f} s to {after:.3f} s')
        for vehicle, pairer in sorted(self._pairers.items()):
            lost = {
                'images without their partner (colour or depth)': pairer.unpaired,
                'frames before any camera_info': pairer.without_camera_info,
            }
            for what, count in lost.items():
                if count:
                    self._note(f'{vehicle}: {count} {what}: left out')
        for topic, count in sorted(self.tally.refused.items()):
            self._note(f'{count} messages on {topic} refused; {self.tally.first_refusals[topic]}')

    def _note(self, text: str) -> None:
        logger.info('%s', text)
        self.warnings.append(text)
