"""Selection of the topics of a recording: by name, by type, or as given; frames or landmarks.

Topics that are named as in the package belong to the vehicle in whose namespace they lie. The rest
is found by type: a recording without namespaces is one vehicle, `robot1`. Where two topics of one
type would do, no choice is made: they are listed with their rates, and `--topic` decides.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from explore_slam.errors import RecordingError
from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.topics import (
    COLOR_TOPICS,
    DEPTH_TOPICS,
    RecordedTopic,
    TopicKind,
    vehicle_topic,
)

SINGLE_VEHICLE = 'robot1'  # name of the vehicle of a recording without namespaces
# what is extracted from frames on the vehicle
_EXTRACTED = (TopicKind.LANDMARKS, TopicKind.TAGS, TopicKind.OBSTACLES)
# one of these makes a recording of a vehicle useful
_SENSORS = {TopicKind.ODOMETRY, TopicKind.SCAN, *COLOR_TOPICS, TopicKind.LANDMARKS}
# words in the names of topics that are no odometry, no colour image, and a registered depth image
_TRUTH = ('truth', 'groundtruth', '/gt')
_NO_COLOR = ('depth', 'disparity', 'infra', '/ir/', 'mask', 'label', 'confidence', 'thermal')
_REGISTERED = ('registered', 'aligned')
# types whose topics are named where they are declared and hold no message
_NAMED_IF_SILENT = {TopicKind.ODOMETRY.message_type, TopicKind.SCAN.message_type}
_COMPRESSED = ('compressed', 'compressedDepth')  # last parts of the names of compressed images


@dataclass(frozen=True)
class TopicChoice:
    """A topic that the user has chosen: `robot1.scan=/front/scan`."""

    vehicle: str
    kind: TopicKind
    name: str


def topic_choices(texts: Iterable[str]) -> list[TopicChoice]:
    """Return what `VEHICLE.KIND=/TOPIC` means; RecordingError for anything else."""
    kinds = {kind.name.lower(): kind for kind in TopicKind}
    kinds |= {kind.value: kind for kind in TopicKind}
    found = []
    for text in texts:
        target, equals, name = text.partition('=')
        vehicle, dot, word = target.partition('.')
        if not (equals and dot and vehicle and name.startswith('/') and word in kinds):
            known = ', '.join(sorted(kind.name.lower() for kind in TopicKind))
            raise RecordingError(
                f'--topic is {text!r}, expected VEHICLE.KIND=/TOPIC with a KIND of {known}'
            )
        found.append(TopicChoice(vehicle, kinds[word], name))
    return found


@dataclass
class _Selection:
    """What has been decided so far."""

    topics: Mapping[str, str]
    rates: Mapping[str, float]
    found: list[RecordedTopic] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def kinds(self, vehicle: str) -> set[TopicKind]:
        return {topic.kind for topic in self.found if topic.vehicle == vehicle}

    def add(self, name: str, vehicle: str, kind: TopicKind, reason: str = '') -> None:
        self.found.append(RecordedTopic(name, vehicle, kind))
        if reason:
            self.warnings.append(f'{vehicle}.{kind.name.lower()} is {name} ({reason})')

    def listed(self, names: Iterable[str]) -> str:
        """Return names with the rates of their messages."""
        return ', '.join(
            f'{name} ({self.rates[name]:.1f} Hz)' if name in self.rates else name for name in names
        )


def vehicle_topics(
    topics: Mapping[str, str],
    vehicles: Iterable[str] = (),
    choices: Iterable[TopicChoice] = (),
    rates: Mapping[str, float] | None = None,
) -> tuple[list[RecordedTopic], list[str]]:
    """Return the topics of vehicles among {name: message type}, and notes about the others.

    vehicles: those asked for; all if empty.
    choices: what the user has chosen; it comes before names and types.
    rates: messages per second by topic; topics with 0 count only if they are chosen.
    RecordingError if a vehicle asked for has no topic, if two topics would do for odometry or
    scans, and for a recording without odometry or any sensor.
    """
    rates = rates or {}
    chosen = list(choices)
    kept = {choice.name for choice in chosen}
    silent = sorted(name for name in topics if rates.get(name) == 0.0 and name not in kept)
    selection = _Selection({n: kind for n, kind in topics.items() if n not in silent}, rates)
    selection.warnings += [
        f'{name} holds no message' for name in silent if topics[name] in _NAMED_IF_SILENT
    ]
    _take_choices(selection, chosen)
    _take_named(selection)
    _take_by_type(selection, [choice.vehicle for choice in chosen])
    _take_one_form_of_images(selection, {choice.name for choice in chosen})
    wanted = list(vehicles)
    others = {topic.vehicle for topic in selection.found} - set(wanted) if wanted else set()
    found = [topic for topic in selection.found if topic.vehicle not in others]
    if others:
        selection.warnings.append(f'unknown vehicles {sorted(others)} in the recording: unused')
    known = sorted({topic.vehicle for topic in selection.found})
    _check_needed(found, wanted, known, topics, silent)
    return sorted(found, key=lambda topic: topic.name), selection.warnings


def _take_choices(selection: _Selection, choices: list[TopicChoice]) -> None:
    for choice in choices:
        kind, actual = choice.kind, selection.topics.get(choice.name)
        if actual is None:
            raise RecordingError(
                f'--topic {choice.vehicle}.{kind.name.lower()}={choice.name}: no such topic; the '
                f'recording holds {sorted(selection.topics)}'
            )
        suffix = choice.name.rsplit('/', 1)[-1]
        if suffix in _COMPRESSED and kind in (TopicKind.COLOR, TopicKind.DEPTH):
            kind = _compressed_kind(kind, suffix)
        if actual != kind.message_type:
            raise RecordingError(
                f'--topic {choice.vehicle}.{kind.name.lower()}={choice.name}: it is of type '
                f'{actual}, expected {kind.message_type}'
            )
        selection.add(choice.name, choice.vehicle, kind)


def _compressed_kind(kind: TopicKind, suffix: str) -> TopicKind:
    if kind is TopicKind.COLOR:
        return TopicKind.COLOR_COMPRESSED
    if suffix == 'compressedDepth':
        return TopicKind.DEPTH_COMPRESSED_DEPTH
    return TopicKind.DEPTH_COMPRESSED


def _take_named(selection: _Selection) -> None:
    """Take the topics that are named as in this package, of vehicles that have odometry.

    Without odometry in any namespace a name says nothing: `/front/scan` beside `/odom` belongs to
    the one vehicle of the recording, not to a vehicle `front`.
    """
    taken = {topic.name for topic in selection.found}
    named = [vehicle_topic(name) for name in sorted(selection.topics) if name not in taken]
    odometry = set(_odometry_names(selection, selection.topics))
    found = [
        topic
        for topic in named
        if topic is not None
        and (topic.kind is not TopicKind.ODOMETRY or not _is_truth(topic.name))
    ]
    owners = {topic.vehicle for topic in found if topic.kind is TopicKind.ODOMETRY}
    if not owners and odometry:
        return
    for topic in found:
        expected, actual = topic.kind.message_type, selection.topics[topic.name]
        if actual != expected:
            selection.warnings.append(
                f'topic {topic.name} is of type {actual}, expected {expected}: unused'
            )
        elif topic.kind not in selection.kinds(topic.vehicle):
            selection.add(*topic)


def _odometry_names(selection: _Selection, names: Iterable[str]) -> list[str]:
    kind = TopicKind.ODOMETRY.message_type
    return [
        name for name in sorted(names) if selection.topics[name] == kind and not _is_truth(name)
    ]


def _is_truth(name: str) -> bool:
    return any(word in name for word in _TRUTH)


def _take_by_type(selection: _Selection, chosen: list[str]) -> None:
    """Find by type what the vehicles lack; without any vehicle, find the vehicles first."""
    taken = {topic.name for topic in selection.found}
    free = {name for name in selection.topics if name not in taken}
    vehicles = list(dict.fromkeys([*chosen, *(topic.vehicle for topic in selection.found)]))
    spaces = {name: {t for t in free if t.startswith(f'/{name}/')} for name in vehicles}
    if not vehicles:
        spaces = _namespaces(selection, free)
    elif len(vehicles) == 1 and not spaces[vehicles[0]]:
        spaces = {vehicles[0]: free}  # named by the user; the recording has no namespaces
    for vehicle, names in spaces.items():
        _take_one(selection, vehicle, TopicKind.ODOMETRY, _odometry_names(selection, names))
        scans = [n for n in sorted(names) if selection.topics[n] == TopicKind.SCAN.message_type]
        _take_one(selection, vehicle, TopicKind.SCAN, scans)
        _take_imu(selection, vehicle, names)
        _take_camera(selection, vehicle, names)


def _namespaces(selection: _Selection, names: set[str]) -> dict[str, set[str]]:
    """Return vehicle -> topics: the namespaces that hold odometry and a scan or an image."""
    sensors = {TopicKind.SCAN.message_type, *(kind.message_type for kind in COLOR_TOPICS)}
    found = {}
    for odometry in _odometry_names(selection, names):
        space = odometry.split('/')[1]
        inside = {name for name in names if name.startswith(f'/{space}/')}
        if any(selection.topics[name] in sensors for name in inside):
            found[space] = inside
    return found or {SINGLE_VEHICLE: names}


def _take_one(selection: _Selection, vehicle: str, kind: TopicKind, names: list[str]) -> None:
    """Take the only topic of a type; refuse to choose among several."""
    if not names:
        return
    if kind in selection.kinds(vehicle):  # by its name, or chosen by the user
        selection.warnings.append(
            f'{vehicle}.{kind.name.lower()}: also recorded: {selection.listed(names)}; --topic '
            'chooses'
        )
    elif len(names) == 1:
        selection.add(names[0], vehicle, kind, 'found by its type')
    else:
        example = f'--topic {vehicle}.{kind.name.lower()}={names[0]}'
        raise RecordingError(
            f'{len(names)} topics may be {vehicle}.{kind.name.lower()}: '
            f'{selection.listed(names)}; choose one, e.g. {example}'
        )


def _take_imu(selection: _Selection, vehicle: str, names: set[str]) -> None:
    """Take the only IMU; of several none, since most vehicles need none."""
    found = [n for n in sorted(names) if selection.topics[n] == TopicKind.IMU.message_type]
    if TopicKind.IMU in selection.kinds(vehicle) or not found:
        return
    if len(found) == 1:
        selection.add(found[0], vehicle, TopicKind.IMU, 'found by its type')
    else:
        selection.warnings.append(
            f'{vehicle}: several IMUs {selection.listed(found)}: unused; choose with --topic '
            f'{vehicle}.imu=...'
        )


def _take_camera(selection: _Selection, vehicle: str, names: set[str]) -> None:
    """Find colour image, registered depth image and camera_info; raw ones before compressed."""
    if selection.kinds(vehicle).intersection((*COLOR_TOPICS, TopicKind.LANDMARKS)):
        return
    image, compressed = TopicKind.COLOR.message_type, TopicKind.COLOR_COMPRESSED.message_type
    kinds = (image, compressed)
    images = sorted(name for name in names if selection.topics[name] in kinds)
    colors = _by_base(n for n in images if not any(word in n for word in _NO_COLOR))
    depths = _by_base(n for n in images if 'depth' in n)
    registered = {base: n for base, n in depths.items() if any(w in base for w in _REGISTERED)}
    depths = registered or depths
    infos = [
        name
        for name in sorted(names)
        if selection.topics[name] == TopicKind.CAMERA_INFO.message_type
    ]
    if len(colors) > 1 or len(depths) > 1:
        listed = selection.listed([*colors.values(), *depths.values()])
        selection.warnings.append(
            f'{vehicle}: several images {listed}: unused; choose with --topic '
            f'{vehicle}.color=..., {vehicle}.depth=... and {vehicle}.camera_info=...'
        )
        return
    if not colors or not depths:
        return
    ((base, color),) = colors.items()
    ((_, depth),) = depths.items()
    beside = [name for name in infos if name.rsplit('/', 1)[0] == base.rsplit('/', 1)[0]]
    if len(beside or infos) != 1:
        return
    reason = 'found by its type'
    suffix = color.rsplit('/', 1)[-1]
    kind = TopicKind.COLOR_COMPRESSED if suffix in _COMPRESSED else TopicKind.COLOR
    selection.add(color, vehicle, kind, reason)
    suffix = depth.rsplit('/', 1)[-1]
    kind = _compressed_kind(TopicKind.DEPTH, suffix) if suffix in _COMPRESSED else TopicKind.DEPTH
    guess = reason if registered else f'{reason}; taken as registered to the colour image'
    selection.add(depth, vehicle, kind, guess)
    selection.add((beside or infos)[0], vehicle, TopicKind.CAMERA_INFO, reason)


def _take_one_form_of_images(selection: _Selection, chosen: Collection[str]) -> None:
    """Keep one form of each image that was recorded raw and compressed.

    It is the one that was chosen, else the raw one, unless it has far fewer messages.
    """
    for vehicle in {topic.vehicle for topic in selection.found}:
        for kinds in (COLOR_TOPICS, DEPTH_TOPICS):
            forms = [t for t in selection.found if t.vehicle == vehicle and t.kind in kinds]
            most = max((selection.rates.get(form.name, 0.0) for form in forms), default=0.0)
            forms.sort(
                key=lambda form: (
                    form.name not in chosen,
                    2.0 * selection.rates.get(form.name, 0.0) < most,
                    kinds.index(form.kind),
                )
            )
            for other in forms[1:]:
                selection.found.remove(other)
                selection.warnings.append(
                    f'{other.name} is left out: {forms[0].name} is the same image'
                )


def _by_base(names: Iterable[str]) -> dict[str, str]:
    """Return image -> topic that carries it, raw before compressed."""
    found: dict[str, str] = {}
    for name in names:  # sorted: a raw image comes before its compressed forms
        base, _, suffix = name.rpartition('/')
        found.setdefault(base if suffix in _COMPRESSED else name, name)
    return found


def _check_needed(
    found: list[RecordedTopic],
    wanted: list[str],
    known: list[str],
    topics: Mapping[str, str],
    silent: list[str],
) -> None:
    seen = {topic.vehicle for topic in found}
    missing = [vehicle for vehicle in wanted if vehicle not in seen]
    if missing:
        raise RecordingError(f'no topics of {missing}; the recording holds vehicles {known}')
    if not {topic.kind for topic in found} & _SENSORS:
        raise RecordingError(
            f'no topic of a vehicle: expected <vehicle>/{TopicKind.ODOMETRY.value} and '
            f'<vehicle>/{TopicKind.SCAN.value}, <vehicle>/{TopicKind.COLOR.value} or '
            f'<vehicle>/{TopicKind.LANDMARKS.value}, or topics of their types; '
            f'the recording holds {sorted(topics) or "no topics"}'
            + (f', and no message on {", ".join(silent)}' if silent else '')
        )


def frames_or_landmarks(
    topics: list[RecordedTopic], vision: str | None, warnings: list[str]
) -> list[RecordedTopic]:
    """Omit the RGB-D frames or the landmarks of a vehicle that has both.

    The landmarks were extracted from the same frames: using both would count each observation
    twice. vision: 'agent' keeps frames, 'vehicle' landmarks, 'none' neither; None keeps landmarks
    and adds a warning. Obstacles are of the frames as well: they are kept with the landmarks.
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
    if vision == 'none':
        return [t for t in topics if t.kind not in (*FRAME.topics, *_EXTRACTED)]
    unused = _EXTRACTED if vision == 'agent' else FRAME.topics
    kept = [topic for topic in topics if topic.vehicle not in both or topic.kind not in unused]
    framed = {topic.vehicle for topic in kept if topic.kind in FRAME.topics}
    return [t for t in kept if t.kind is not TopicKind.OBSTACLES or t.vehicle not in framed]
