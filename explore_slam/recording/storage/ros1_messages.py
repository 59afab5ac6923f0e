"""Messages of ROS 1 as those of ROS 2: the conversion of rosbags, by the recorded definitions."""

from collections.abc import Callable
from typing import Any

from rosbags.convert.converter import (
    STATIC_MSGTYPE_RENAMES,
    is_same_wireformat,
    migrate_bytes,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from explore_slam.recording.rosbags_types import full_name, typestore

type Conversion = Callable[[bytes], bytes]


def ros2_name(ros1: str) -> str:
    """Return the type of ROS 2 that a type of ROS 1 ('sensor_msgs/LaserScan') becomes."""
    name = full_name(ros1)
    return STATIC_MSGTYPE_RENAMES.get(name, name)


def conversion(ros1: str, definition: str) -> Conversion:
    """Return the function from data of ROS 1 to CDR.

    definition: of the message as recorded, with those of its parts; '' for that of ROS Noetic.
    Raises what rosbags raises for a definition that it cannot read, or a type without one.
    """
    name, target = full_name(ros1), ros2_name(ros1)
    source = get_typestore(Stores.EMPTY if definition else Stores.ROS1_NOETIC)
    if definition:
        source.register(get_types_from_msg(definition, name))
    source.get_msgdef(name)
    known = typestore()
    if target not in known.fielddefs:
        return lambda data: bytes(source.ros1_to_cdr(data, name))
    if is_same_wireformat(source, known, name, target):
        return lambda data: bytes(known.ros1_to_cdr(data, target))
    cache: dict[str, Any] = {}
    return lambda data: bytes(
        migrate_bytes(source, known, name, target, cache, data, src_is2=False, dst_is2=True)
    )
