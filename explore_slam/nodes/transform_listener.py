"""Transforms of /tf_static and /tf for the vehicles of a node, where tf2_msgs is installed."""

from collections.abc import Iterable
from functools import partial
from typing import Any

from rclpy.node import Node

from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import GlobalTopic
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.mounts import ExplicitMounts, LaserMountConfig
from explore_slam.nodes.endpoints import qos_profile
from explore_slam.nodes.ros_types import message_class


class TransformListener:
    """Keeps a tree of transforms per vehicle: those of all, and those in its namespace.

    Mounts are static: /tf is read only after `listen_to_tf`, for a sensor whose frame /tf_static
    does not hold.

    available: whether tf2_msgs is installed.
    """

    def __init__(self, node: Node, vehicles: Iterable[str], namespaced: bool = True) -> None:
        """Subscribe to /tf_static.

        namespaced: also to <vehicle>/tf_static; false in nodes that live in a vehicle's namespace.
        """
        self._node = node
        self._vehicles = list(vehicles)
        self._namespaced = namespaced
        self._dynamic = False
        self.trees = {name: TransformTree() for name in self._vehicles}
        try:
            self._type = message_class(GlobalTopic.TF.message_type)
        except ImportError:
            self._type = None
            node.get_logger().info(
                'tf2_msgs is not installed: mounts of sensors come from parameters, and no '
                'transforms are published'
            )
        self._subscribe(GlobalTopic.TF_STATIC)

    @property
    def available(self) -> bool:
        """Whether transforms can be received."""
        return self._type is not None

    def listen_to_tf(self) -> None:
        """Read /tf as well, from now on."""
        if not self._dynamic:
            self._dynamic = True
            self._subscribe(GlobalTopic.TF)

    def _subscribe(self, topic: GlobalTopic) -> None:
        if self._type is None:
            return
        name, profile = topic.value, qos_profile(topic.requested)
        add = partial(self._add_to_all, topic is GlobalTopic.TF_STATIC)
        self._node.create_subscription(self._type, name, add, profile)
        for vehicle in self._vehicles:
            tree = self.trees[vehicle]
            own = f'{vehicle}{name}' if self._namespaced else name.lstrip('/')
            if self._node.resolve_topic_name(own) != name:
                self._node.create_subscription(self._type, own, tree.add, profile)

    def _add_to_all(self, static: bool, message: Any) -> None:
        for tree in self.trees.values():
            tree.add(message, shared=True, static=static)


def own_mounts(
    node: Node, vehicle: str, laser: LaserMountConfig, config: VehicleConfig | None = None
) -> SensorMounts:
    """Return the mounts of the vehicle in whose namespace a node lives, from its transforms.

    laser: mount in the settings of the node, which applies without transforms.
    config: mounts and frames in the settings of the vehicle, which go before it.
    """
    transforms = TransformListener(node, [vehicle], namespaced=False)
    given = ExplicitMounts(laser.pose if laser != LaserMountConfig() else None)
    return SensorMounts(vehicle, transforms.trees[vehicle], config, given, mapping=False)
