"""Values of options that several commands have: settings, and lists of numbers."""

import argparse
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from explore_slam.settings import Section
    from explore_slam.studies.parallel import Workers


def named_settings(arguments: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Return the settings given by options of these names, and by `--set NAME=VALUE`."""
    import yaml

    from explore_slam.errors import ConfigError

    options = {
        name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None
    }
    for text in arguments.set:
        name, equals, value = text.partition('=')
        if not equals:
            raise ConfigError(f'--set is {text!r}, expected NAME=VALUE')
        try:
            options[name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigError(f'--set {name}: {value!r} is not a YAML value') from error
    return options


def add_set_option(parser: argparse.ArgumentParser) -> None:
    """Declare `--set`, which `named_settings` reads."""
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='value of a setting; may be repeated',
    )


def add_seeds_option(parser: argparse.ArgumentParser, default: range) -> None:
    """Declare `--seeds`, one run each."""
    parser.add_argument(
        '--seeds',
        type=whole_numbers,
        default=list(default),
        help=f'such as 0..9 or 3,5; one run each (default {default.start}..{default.stop - 1})',
    )


def add_topic_option(parser: argparse.ArgumentParser) -> None:
    """Declare `--topic`, which says what a topic of a recording or of other nodes is."""
    parser.add_argument(
        '--topic',
        action='append',
        default=[],
        metavar='VEHICLE.KIND=/TOPIC',
        help='topic of a vehicle that has another name, e.g. robot1.scan=/front/scan; may be '
        'repeated; kinds: scan, odometry, imu, color, depth, camera_info, landmarks, tags, '
        'inter_robot, ground_truth, initial_pose',
    )


def add_section_options(parser: argparse._ActionsContainer, section: 'Section') -> None:
    """Declare an option for each setting of a section, with its default and meaning.

    A setting that is a list of texts may be given repeatedly, one each.
    """
    from explore_slam.settings import settings_of

    for info, value in settings_of(section):
        flag = '--' + info.name.replace('_', '-')
        unit = f' ({info.unit})' if info.unit else ''
        if isinstance(value, tuple):
            parser.add_argument(
                flag, action='append', default=[], metavar='VALUE', help=f'{info.doc}{unit}'
            )
        else:
            parser.add_argument(
                flag,
                type=type(value),
                default=value,
                choices=info.choices or None,
                help=f'{info.doc}{unit} (default: %(default)s)',
            )


def section_of[S: 'Section'](arguments: argparse.Namespace, section: S) -> S:
    """Return the section with the values that the options of `add_section_options` have."""
    from explore_slam.settings import values_of, with_values

    return with_values(section, {name: getattr(arguments, name) for name in values_of(section)})


def whole_numbers(text: str) -> list[int]:
    """Return the numbers of '1..8', '1,2,4' or a mixture (an argparse type)."""
    numbers: list[int] = []
    for part in text.split(','):
        low, dots, high = part.partition('..')
        try:
            first, last = int(low), int(high if dots else low)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f'{text!r}, expected e.g. 1..8 or 1,2,4') from error
        if not 0 <= first <= last <= 10**6:
            raise argparse.ArgumentTypeError(f'{text!r}, expected ascending numbers from 0')
        numbers.extend(range(first, last + 1))
    return list(dict.fromkeys(numbers))


def add_workers_options(parser: argparse._ActionsContainer, default: int = 2) -> None:
    """Declare `--workers` and `--cluster`, which `workers_of` reads."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--workers',
        type=int,
        default=default,
        help=f'number of parallel processes on this machine (default {default})',
    )
    where.add_argument(
        '--cluster',
        default='',
        metavar='ADDRESS',
        help='make the runs on an existing Dask cluster: address of its scheduler, such as '
        'tcp://host:8786',
    )


def workers_of(arguments: argparse.Namespace) -> 'Workers':
    """Return where runs are made, as the options say."""
    from explore_slam.studies.parallel import Workers

    return Workers(arguments.workers, arguments.cluster)
