"""Message types of rosbags: those of ROS 2 Jazzy, without ROS; and their serialization."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def full_name(name: str) -> str:
    """Return 'sensor_msgs/msg/LaserScan' for 'sensor_msgs/LaserScan'."""
    package, _, message = name.rpartition('/')
    return f'{package}/{message}' if package.endswith('/msg') else f'{package}/msg/{message}'


@cache
def _message_class(name: str) -> Any:
    return typestore().types[full_name(name)]


class RosbagsMessages:
    """MessageFactory of rosbags."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message with all its fields set."""
        return _message_class(name)(**fields)

    def sequence(self, values: NDArray[Any]) -> Any:
        """Return the values as the contiguous array that rosbags serializes."""
        return np.ascontiguousarray(values)


MESSAGES = RosbagsMessages()


def serialize(name: str, message: Any) -> bytes:
    """Return a message as CDR."""
    return bytes(typestore().serialize_cdr(message, full_name(name)))


def deserialize(name: str, data: bytes) -> Any:
    """Return the message in CDR data."""
    return typestore().deserialize_cdr(data, full_name(name))
