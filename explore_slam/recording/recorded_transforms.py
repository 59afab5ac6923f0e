"""The transforms of a recording: /tf_static, and the frames that only /tf holds."""

import itertools
from collections.abc import Iterable
from typing import Any

from explore_slam.errors import RecordingError
from explore_slam.messages.topics import GlobalTopic
from explore_slam.messages.transforms import TransformTree
from explore_slam.recording.bag import BagReader

# messages of /tf that are read: several seconds of all broadcasters
_DYNAMIC = 500


def recorded_transforms(bag: BagReader, vehicles: Iterable[str]) -> dict[str, TransformTree]:
    """Return vehicle -> transforms: those of all, and those on topics in its namespace.

    A frame that is both in /tf and in /tf_static has its static parent.
    """
    return {name: _tree(bag, name) for name in vehicles}


def _tree(bag: BagReader, vehicle: str) -> TransformTree:
    tree = TransformTree()
    for topic, most in ((GlobalTopic.TF, _DYNAMIC), (GlobalTopic.TF_STATIC, None)):
        names = [
            name
            for name in (topic.value, f'/{vehicle}{topic.value}')
            if bag.topics.get(name) == topic.message_type
        ]
        for message in itertools.islice(bag.messages(names) if names else (), most):
            try:
                tree.add(
                    bag.decode(message),
                    shared=message.topic == topic.value,
                    static=topic is GlobalTopic.TF_STATIC,
                )
            except RecordingError as error:
                bag.warn(str(error))
    return tree


def static_transforms(bag: BagReader) -> dict[str, list[Any]]:
    """Return topic -> transforms (geometry_msgs/TransformStamped) of all its static broadcasters.

    Each broadcaster has a latched message of its own in a running system; one publisher can hold
    but one, so that a player publishes them together.
    """
    found: dict[str, dict[str, Any]] = {}
    names = [
        name
        for name, kind in bag.topics.items()
        if name.endswith(GlobalTopic.TF_STATIC.value) and kind == GlobalTopic.TF.message_type
    ]
    for message in bag.messages(names) if names else ():
        try:
            for stamped in bag.decode(message).transforms:
                found.setdefault(message.topic, {})[stamped.child_frame_id] = stamped
        except RecordingError as error:
            bag.warn(str(error))
    return {topic: list(frames.values()) for topic, frames in found.items()}
