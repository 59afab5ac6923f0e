"""Settings given as options: named ones, and `--set NAME=VALUE` for all others."""

import argparse
from collections.abc import Iterable
from typing import Any


def named_settings(arguments: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Return setting name -> value of the named options that were given, and of every --set."""
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
            raise ConfigError(f'--set {name}: {value!r} is not a value') from error
    return options
