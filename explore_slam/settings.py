"""Settings: dataclass fields that carry unit, range, meaning and tier.

ROS parameters, YAML files and command-line options derive from the same tree. Sections nest; the
names of their leaves are unique in the whole tree, so that a setting is known by its leaf name.
"""

import dataclasses
import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import yaml

from explore_slam.errors import ConfigError
from explore_slam.files import read_yaml, write_text

Tier = Literal['basic', 'advanced']
Value = bool | int | float | str | tuple[Any, ...]
_IN_WORDS: Mapping[type, str] = {
    bool: 'true or false', int: 'a whole number', float: 'a number', str: 'text', tuple: 'a list',
}  # fmt: skip


_LISTS_IN_WORDS: Mapping[type, str] = {
    float: 'a list of numbers', int: 'a list of whole numbers', str: 'a list of texts',
}  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """The declaration of one setting; low and high are inclusive."""

    name: str
    default: Value
    doc: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    tier: Tier

    def check(self, value: Any) -> Value:
        """Return the value in the type of the default, or raise ConfigError."""
        checked = _as_type_of(self.default, value)
        if checked is None:
            raise ConfigError(
                f'{self.name} is {value!r}, expected {self._expected()}{self._hint(value)}'
            )
        if self.choices and checked not in self.choices:
            raise ConfigError(f'{self.name} is {value!r}, expected one of {list(self.choices)}')
        if isinstance(checked, int | float) and not isinstance(checked, bool):
            low, high = self.low, self.high
            if (
                math.isnan(checked)
                or (low is not None and checked < low)
                or (high is not None and checked > high)
            ):
                raise ConfigError(
                    f'{self.name} is {value!r}, '
                    f'expected {_range_text(low, high)} {self.unit}'.strip()
                )
        return checked

    def _expected(self) -> str:
        if self.choices:
            return f'one of {list(self.choices)}'
        if isinstance(self.default, tuple) and self.default:
            return _LISTS_IN_WORDS[type(self.default[0])]
        return _IN_WORDS[type(self.default)]

    def _hint(self, value: Any) -> str:
        """Return what is wrong with words that YAML reads as booleans: off, no, on, yes."""
        if not isinstance(value, bool) or not isinstance(self.default, str):
            return ''
        if 'none' in self.choices and not value:
            return f': YAML reads off and no as false; write {self.name}: none'
        return ': YAML reads on, off, yes and no as true or false; quote the text'


def _range_text(low: float | None, high: float | None) -> str:
    if low is None:
        return 'any number' if high is None else f'at most {high}'
    return f'at least {low}' if high is None else f'{low} to {high}'


def _as_type_of(default: Value, value: Any) -> Value | None:
    """Return the value in the type of the default, None where it does not fit."""
    if isinstance(default, tuple):
        if isinstance(value, str) or not hasattr(value, '__iter__'):
            return None
        items = [_as_type_of(default[0], item) if default else item for item in value]
        return None if None in items else tuple(items)
    if isinstance(default, bool) or isinstance(value, bool):
        return value if isinstance(value, type(default)) and isinstance(default, bool) else None
    if isinstance(default, float) and isinstance(value, int | float):
        return float(value)
    return value if isinstance(value, type(default)) else None


def setting(
    default: Any,
    doc: str,
    *,
    unit: str = '',
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    tier: Tier = 'advanced',
) -> Any:
    """Declare a setting as the field of a Section.

    doc: meaning, one sentence without a full stop.
    low, high: inclusive limits of a number.
    choices: the values that a text may take.
    tier: 'basic' for what depends on the vehicles, the site or the wish of the user, 'advanced'
    for what tunes an algorithm. Advanced is the default on purpose: a new setting tunes an
    algorithm unless its declaration says that users are expected to change it.
    """
    info = {
        'doc': doc,
        'unit': unit,
        'low': low,
        'high': high,
        'choices': choices,
        'tier': tier,
    }
    return field(default=default, metadata=info)


@dataclass(frozen=True)
class Section:
    """Base of all configuration dataclasses; checks the values at construction."""

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            if 'doc' in item.metadata:
                checked = _setting_of(item).check(getattr(self, item.name))
                object.__setattr__(self, item.name, checked)


def _setting_of(item: 'dataclasses.Field[Any]') -> Setting:
    default: Any = item.default
    return Setting(item.name, default, **item.metadata)


def section[S: Section](cls: type[S]) -> S:
    """Declare a nested section with its defaults as the field of another section."""
    made: S = field(default_factory=cls)
    return made


def settings_of(tree: Section) -> Iterator[tuple[Setting, Value]]:
    """Yield every leaf setting of the tree with its current value."""
    for item in dataclasses.fields(tree):
        value = getattr(tree, item.name)
        if isinstance(value, Section):
            yield from settings_of(value)
        elif 'doc' in item.metadata:
            yield _setting_of(item), value


def values_of(tree: Section) -> dict[str, Value]:
    """Return the values of the whole tree by leaf name."""
    return {info.name: value for info, value in settings_of(tree)}


def with_values[S: Section](tree: S, values: Mapping[str, Any]) -> S:
    """Return the tree with leaves replaced by name; ConfigError for an unknown name."""
    known = values_of(tree)
    for name in values:
        if name not in known:
            raise ConfigError(unknown_name(name, known))
    return _replace(tree, values)


def unknown_name(name: str, known: Iterable[str]) -> str:
    """Return the message for a setting that does not exist, with the most similar known name."""
    near = difflib.get_close_matches(name, list(known), n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ''
    return f"there is no setting '{name}'{hint}"


def _replace[S: Section](tree: S, values: Mapping[str, Any]) -> S:
    changes: dict[str, Any] = {}
    for item in dataclasses.fields(tree):
        value = getattr(tree, item.name)
        if isinstance(value, Section):
            changes[item.name] = _replace(value, values)
        elif item.name in values:
            changes[item.name] = values[item.name]
    return dataclasses.replace(tree, **changes)


def read_parameters(path: Path) -> dict[str, Any]:
    """Return the values of a ROS parameter file (`/**: ros__parameters: ...`) by name."""
    content = read_yaml(path, ConfigError)
    values: dict[str, Any] = {}
    if isinstance(content, Mapping):
        for node in content.values():
            parameters = node.get('ros__parameters') if isinstance(node, Mapping) else None
            if not isinstance(parameters, Mapping):
                raise ConfigError(f"{path}: expected '/**:' with 'ros__parameters:' below it")
            values.update(_flat(parameters))
    elif content is not None:
        raise ConfigError(f'{path}: expected a mapping, found {type(content).__name__}')
    return values


def _flat(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested parameters by the names that ROS gives them: {'robot1.vision': 'none'}."""
    values: dict[str, Any] = {}
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            values.update({f'{name}.{leaf}': item for leaf, item in _flat(value).items()})
        else:
            values[str(name)] = value
    return values


def load_settings[S: Section](tree: S, path: Path) -> S:
    """Return the tree with the values of a ROS parameter file; ConfigError for unknown names."""
    values = read_parameters(path)
    try:
        return with_values(tree, values)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from error


def settings_text(tree: Section, tier: Tier | None = None) -> str:
    """Return a ROS parameter file with meaning, unit and range as comments.

    tier: only the settings of this tier; None: all.
    """
    lines = ['/**:', '  ros__parameters:']
    for info, value in settings_of(tree):
        if tier is not None and info.tier != tier:
            continue
        bounds = '' if info.low is None and info.high is None else _range_text(info.low, info.high)
        notes = ', '.join(part for part in (info.unit, bounds, '|'.join(info.choices)) if part)
        lines.append(f'    # {info.doc}' + (f' ({notes})' if notes else ''))
        plain = list(value) if isinstance(value, tuple) else value
        lines.append(f'    {info.name}: {_yaml_value(plain)}')
    return '\n'.join(lines) + '\n'


def save_settings(tree: Section, path: Path) -> None:
    """Write the whole tree as a ROS parameter file; see settings_text."""
    write_text(path, settings_text(tree))


def _yaml_value(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6).strip()
    return text.removesuffix('\n...').strip()
