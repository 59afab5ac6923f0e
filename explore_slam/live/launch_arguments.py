"""Arguments of the launch files: text in, values out, one sentence for what cannot be read."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from explore_slam.errors import ConfigError
from explore_slam.files import read_mapping
from explore_slam.mapping.map_files import is_map
from explore_slam.messages.topics import TopicKind
from explore_slam.settings import read_parameters, unknown_name

TRUE, FALSE = ('true', 'yes', 'on', '1'), ('false', 'no', 'off', '0')
# names of topics and namespaces; rcl would answer another one with an error in its own terms
_ROS_NAME = re.compile(r'/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*', re.ASCII)
# argument of the launch files -> topic in a vehicle's namespace that it stands for
TOPICS = {
    'scan_topic': TopicKind.SCAN.value,
    'odom_topic': TopicKind.ODOMETRY.value,
    'color_topic': TopicKind.COLOR.value,
    'depth_topic': TopicKind.DEPTH.value,
    'camera_info_topic': TopicKind.CAMERA_INFO.value,
}


def given_parameters(
    given: Mapping[str, str], readers: Mapping[str, tuple[str, Callable[[str, str], Any]]]
) -> dict[str, Any]:
    """Return parameter -> value of the arguments that were given.

    The others are left to the parameter file, and to the defaults of the node: a default of the
    launch file would override both.

    given: argument -> text, '' where it was not given.
    readers: argument -> parameter, and what reads its text.
    """
    return {
        parameter: reader(name, given[name])
        for name, (parameter, reader) in readers.items()
        if given[name]
    }


def text(_name: str, value: str) -> str:
    """Return a text as it is."""
    return value


def in_effect(parameters: Mapping[str, Any], file: str, name: str, default: Any) -> Any:
    """Return the value that a node has: as given, or in its parameter file, or its default."""
    if name in parameters:
        return parameters[name]
    return read_parameters(Path(file)).get(name, default)


def boolean(name: str, text: str) -> bool:
    """Return any YAML boolean (true, True, yes, on, 1 ...)."""
    word = text.strip().lower()
    if word in TRUE or word in FALSE:
        return word in TRUE
    raise ConfigError(f'{name} is {text!r}, expected true or false')


def names(name: str, text: str) -> list[str]:
    """Return names that are separated by commas."""
    found = [word.strip() for word in text.split(',') if word.strip()]
    if not found or len(set(found)) != len(found):
        raise ConfigError(f'{name} is {text!r}, expected different names, separated by commas')
    return found


def one_each(name: str, text: str, vehicles: Sequence[str], default: Sequence[str]) -> list[str]:
    """Return one text per vehicle, separated by commas; the default where there is none."""
    if not text.strip():
        return list(default)
    found = [word.strip() for word in text.split(',')]
    if len(found) != len(vehicles) or '' in found or len(set(found)) != len(found):
        raise ConfigError(
            f'{name} is {text!r}, expected {len(vehicles)} different texts, separated by commas: '
            f'one for each of {", ".join(vehicles)}'
        )
    return found


def numbers(name: str, text: str, count: int) -> list[float]:
    """Return a given number of numbers that are separated by commas."""
    try:
        found = [float(word) for word in text.strip('[] ').split(',')]
    except ValueError:
        raise ConfigError(f'{name} is {text!r}, expected numbers, separated by commas') from None
    if len(found) != count:
        raise ConfigError(
            f'{name} has {len(found)} numbers, expected {count}: x, y and heading of each vehicle'
        )
    return found


def whole_number(name: str, text: str, low: int, high: int | None = None) -> int:
    """Return a whole number within limits."""
    limits = f'from {low} on' if high is None else f'from {low} to {high}'
    try:
        found = int(text)
    except ValueError:
        raise ConfigError(f'{name} is {text!r}, expected a whole number {limits}') from None
    if found < low or (high is not None and found > high):
        raise ConfigError(f'{name} is {found}, expected a whole number {limits}')
    return found


def choice(name: str, word: str, choices: Sequence[str]) -> str:
    """Return one of several words."""
    if word not in choices:
        hint = ' (off is read as a boolean by YAML: write none)' if word in FALSE else ''
        raise ConfigError(f'{name} is {word!r}, expected one of {list(choices)}{hint}')
    return word


def ros_name(name: str, text: str) -> str:
    """Return the name of a topic or of a namespace."""
    if not _ROS_NAME.fullmatch(text):
        raise ConfigError(
            f'{name} is {text!r}, expected a name of ROS: letters, digits and underscores, parted '
            'by slashes, none beginning with a digit'
        )
    return text


def existing_file(name: str, text: str) -> str:
    """Return the path of a file that exists."""
    if not Path(text).expanduser().is_file():
        raise ConfigError(f'{name} is {text!r}, which does not exist')
    return str(Path(text).expanduser())


def remappings(given: Mapping[str, str], vehicles: Iterable[str] = ('',)) -> list[tuple[str, str]]:
    """Return remappings from topics of vehicles to those that the arguments name.

    given: argument -> topic, '' where nothing is remapped. A name without a leading slash lies in
    the namespace of each vehicle. vehicles: [''] in nodes that live in that namespace.
    """
    team = list(vehicles)
    found = []
    for argument, topic in given.items():
        if not topic:
            continue
        ros_name(argument, topic)
        if topic.startswith('/') and len(team) > 1:
            raise ConfigError(
                f'{argument} is {topic!r}: all vehicles would share one topic; expected a name '
                'without leading slash, in the namespace of each vehicle'
            )
        for vehicle in team:
            own = f'{vehicle}/{TOPICS[argument]}' if vehicle else TOPICS[argument]
            there = f'{vehicle}/{topic}' if vehicle and not topic.startswith('/') else topic
            found.append((own, there))
    return found


def start_poses_of(world: Path, count_text: str) -> dict[str, list[float]]:
    """Return vehicle -> start pose of the first vehicles of a world file or of a map."""
    starts: Any
    if is_map(world):
        from explore_slam.simulation import load_world

        starts = load_world(world).starts
    else:
        starts = read_mapping(world, ConfigError, 'a world').get('starts')
    if not isinstance(starts, dict) or not starts:
        raise ConfigError(f'{world}: starts is {starts!r}, expected a pose for each vehicle')
    count = whole_number('vehicles', count_text, 1, len(starts))
    return {name: [float(v) for v in starts[name]] for name in list(starts)[:count]}


def world_file(text: str, folder: Path) -> Path:
    """Return the file of a world, which is given by its name or its path."""
    path = Path(text)
    if not path.suffix:
        path = folder / f'{text}.yaml'
    if not path.is_file():
        known = [file.stem for file in sorted(folder.glob('*.yaml'))]
        hint = unknown_name(text, known).partition('; ')[2]
        raise ConfigError(
            f'world is {text!r}, expected a file or one of {known}' + (f'; {hint}' if hint else '')
        )
    return path


def misspelt(given: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return a sentence for every `name:=value` whose name is similar to a known argument.

    Arguments that resemble none belong to another launch file, which includes this one.
    """
    accepted, found = list(known), []
    for text in given:
        name, sign, _ = text.partition(':=')
        if sign and name not in accepted:
            message = unknown_name(name, accepted).replace('setting', 'launch argument')
            if 'did you mean' in message:
                found.append(message)
    return found
