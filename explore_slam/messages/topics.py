"""Topics: names, message types and quality of service. The single source for nodes and recordings.

Names are relative: topics of a vehicle lie below its namespace, those of the team below the
agent's. A new topic is one line here.
"""

from enum import Enum
from typing import NamedTuple, Self


class Qos(NamedTuple):
    """Quality of service (REP-2003), free of rclpy; latched is durability transient local."""

    depth: int
    reliable: bool = True
    latched: bool = False


RELIABLE = Qos(10)
LATCHED = Qos(1, latched=True)
AREAS = Qos(10, latched=True)  # several keep-out areas, which late subscribers must know
NEWEST = Qos(1)  # an older command must not be carried out after a newer one was sent
SENSOR_DATA = Qos(5, reliable=False)  # rclpy's qos_profile_sensor_data
# odometry comes at up to 100 Hz: a burst must not push out readings that have not been taken yet
SENSOR_BURST = Qos(50, reliable=False)
BEST_EFFORT = Qos(1, reliable=False)
TRANSFORMS = Qos(100)  # tf2_ros's depth for /tf
TF_SUBSCRIPTION = Qos(100, reliable=False)
# every broadcaster of static transforms has one latched message of its own; tf2_ros's depth again
STATIC_TRANSFORMS = Qos(100, latched=True)


class Topic(Enum):
    """Base of the topic tables; a member's value is its relative name.

    message_type: e.g. 'sensor_msgs/msg/LaserScan'.
    offered, requested: quality of service of publishers and of subscriptions of this package.
    """

    message_type: str
    offered: Qos
    requested: Qos

    def __new__(
        cls, name: str, message_type: str, offered: Qos = RELIABLE, requested: Qos = SENSOR_DATA
    ) -> Self:
        """Make a member."""
        member = object.__new__(cls)
        member._value_ = name
        member.message_type = message_type
        member.offered = offered
        member.requested = requested
        return member


_IMAGE = 'sensor_msgs/msg/Image'
_COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
_POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
_POLYGON = 'geometry_msgs/msg/PolygonStamped'
_ODOMETRY = 'nav_msgs/msg/Odometry'
# of cmd_vel, which carries either type: nodes.velocity_topic
STAMPED_VELOCITY = 'geometry_msgs/msg/TwistStamped'


class TopicKind(Topic):
    """What a vehicle measures, its ground truth and its start pose: what recordings hold."""

    SCAN = 'scan', 'sensor_msgs/msg/LaserScan'
    # of a 3-D lidar; only where the settings name it, never by this name
    CLOUD = 'points', 'sensor_msgs/msg/PointCloud2'
    ODOMETRY = 'odom', _ODOMETRY, RELIABLE, SENSOR_BURST
    IMU = 'imu', 'sensor_msgs/msg/Imu', RELIABLE, SENSOR_BURST
    COLOR = 'camera/rgb/image_raw', _IMAGE
    COLOR_COMPRESSED = 'camera/rgb/image_raw/compressed', _COMPRESSED_IMAGE
    DEPTH = 'camera/depth_registered/image_raw', _IMAGE
    DEPTH_COMPRESSED = 'camera/depth_registered/image_raw/compressed', _COMPRESSED_IMAGE
    DEPTH_COMPRESSED_DEPTH = (
        'camera/depth_registered/image_raw/compressedDepth',
        _COMPRESSED_IMAGE,
    )
    CAMERA_INFO = 'camera/rgb/camera_info', 'sensor_msgs/msg/CameraInfo'
    LANDMARKS = 'landmarks', 'sensor_msgs/msg/PointCloud2', RELIABLE, RELIABLE
    TAGS = 'tags', 'sensor_msgs/msg/PointCloud2', RELIABLE, SENSOR_BURST
    # of depth cameras; by the agent where it has the images
    OBSTACLES = 'obstacles', 'sensor_msgs/msg/PointCloud2', SENSOR_DATA, SENSOR_DATA
    INTER_ROBOT = 'inter_robot_observations', _POSE, RELIABLE, RELIABLE
    GROUND_TRUTH = 'ground_truth', _ODOMETRY, RELIABLE, RELIABLE
    INITIAL_POSE = 'initialpose', _POSE, LATCHED, RELIABLE


class VehicleTopic(Topic):
    """What else lies in a vehicle's namespace: the agent's results for it, commands, status."""

    POSE = 'pose', _POSE, RELIABLE, RELIABLE
    # subscribed to without latching as well: endpoints.LatchedOrNotSubscription
    PLAN = 'plan', 'nav_msgs/msg/Path', LATCHED, LATCHED
    TRAJECTORY = 'trajectory', 'nav_msgs/msg/Path', RELIABLE, RELIABLE
    PARTICLES = 'particles', 'geometry_msgs/msg/PoseArray', BEST_EFFORT
    # odometry by scans, of a vehicle whose setting odometry is scan
    SCAN_ODOMETRY = 'scan_odom', _ODOMETRY, RELIABLE, SENSOR_BURST
    AGENT_ALIVE = 'agent_alive', 'std_msgs/msg/Empty', BEST_EFFORT, BEST_EFFORT
    VELOCITY_COMMAND = 'cmd_vel', 'geometry_msgs/msg/Twist', NEWEST, NEWEST
    TELEOP_COMMAND = 'cmd_vel_teleop', 'geometry_msgs/msg/Twist', NEWEST, NEWEST
    GOAL_POSE = 'goal_pose', 'geometry_msgs/msg/PoseStamped', RELIABLE, RELIABLE
    FOLLOWER_STATUS = 'follower_status', 'diagnostic_msgs/msg/DiagnosticStatus', RELIABLE, RELIABLE
    SWEEPS = 'sweeps', 'diagnostic_msgs/msg/DiagnosticStatus', LATCHED, LATCHED
    BATTERY = 'battery', 'sensor_msgs/msg/BatteryState'
    MOTORS_ON = 'motors_on', 'std_msgs/msg/Bool'
    SONAR = 'sonar', 'sensor_msgs/msg/PointCloud2'


class TeamTopic(Topic):
    """What the agent publishes for the whole team, and commands of the operator to it."""

    MAP = 'map', 'nav_msgs/msg/OccupancyGrid', LATCHED, LATCHED
    MAP_PROBABILITY = 'map_probability', 'nav_msgs/msg/OccupancyGrid', LATCHED, LATCHED
    MAP_UPDATES = 'map_updates', 'map_msgs/msg/OccupancyGridUpdate', RELIABLE, RELIABLE
    MAP_LANDMARKS = 'map_landmarks', 'sensor_msgs/msg/PointCloud2', LATCHED, LATCHED
    FRONTIERS = 'explore/frontiers', 'visualization_msgs/msg/MarkerArray', RELIABLE, RELIABLE
    STATUS = 'explore/status', 'std_msgs/msg/String', LATCHED, LATCHED
    # subscribed to without latching as well: endpoints.LatchedOrNotSubscription
    AREA = 'explore/area', _POLYGON, AREAS, AREAS
    KEEP_OUT = 'explore/keepout', _POLYGON, AREAS, AREAS
    RESUME = 'explore/resume', 'std_msgs/msg/Bool', RELIABLE, RELIABLE


class GlobalTopic(Topic):
    """Topics with absolute names, which all nodes share.

    RViz sends poses without a namespace: they go to the vehicle that the operator has selected.
    """

    CLOCK = '/clock', 'rosgraph_msgs/msg/Clock'
    DIAGNOSTICS = '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', RELIABLE, RELIABLE
    SELECTED_GOAL_POSE = '/goal_pose', 'geometry_msgs/msg/PoseStamped', RELIABLE, RELIABLE
    SELECTED_INITIAL_POSE = '/initialpose', _POSE, RELIABLE, RELIABLE
    TF = '/tf', 'tf2_msgs/msg/TFMessage', TRANSFORMS, TF_SUBSCRIPTION
    TF_STATIC = '/tf_static', 'tf2_msgs/msg/TFMessage', LATCHED, STATIC_TRANSFORMS


COLOR_TOPICS = (TopicKind.COLOR, TopicKind.COLOR_COMPRESSED)
DEPTH_TOPICS = (TopicKind.DEPTH, TopicKind.DEPTH_COMPRESSED, TopicKind.DEPTH_COMPRESSED_DEPTH)
# longest first: 'camera/rgb/image_raw/compressed' must not be taken for anything shorter
_BY_LENGTH = sorted(set(TopicKind) - {TopicKind.CLOUD}, key=lambda kind: -len(kind.value))
_CAMERA = 'camera'  # first part of the names of a camera's topics
_CAMERA_TOPICS = (*COLOR_TOPICS, *DEPTH_TOPICS, TopicKind.CAMERA_INFO)


class SensorTopic(NamedTuple):
    """A topic of a vehicle: kind, name below its namespace, and which of its sensors it is of.

    sensor: the name of a laser's topic, or of a camera; '' where the vehicle has one only.
    """

    kind: TopicKind
    name: str
    sensor: str = ''


class RecordedTopic(NamedTuple):
    """A topic that a recording may hold: full name, vehicle, kind; sensor as of SensorTopic."""

    name: str
    vehicle: str
    kind: TopicKind
    sensor: str = ''


def sensor_topic(kind: TopicKind, sensor: str) -> SensorTopic:
    """Return the topic of one of several lasers, or of one of several cameras.

    The topics of a camera begin with its name instead of `camera`.
    """
    if kind in _CAMERA_TOPICS:
        return SensorTopic(kind, sensor + str(kind.value).removeprefix(_CAMERA), sensor)
    return SensorTopic(kind, sensor, sensor)


def topic_name(vehicle: str, topic: Topic, sensor: str = '') -> str:
    """Return the full name of a vehicle's topic, e.g. '/robot1/scan' for ('robot1', SCAN)."""
    if sensor and isinstance(topic, TopicKind):
        return f'/{vehicle}/{sensor_topic(topic, sensor).name}'
    return f'/{vehicle}/{topic.value}'


def vehicle_topic(name: str) -> RecordedTopic | None:
    """Return vehicle and kind of a topic by its full name; None if it is of no TopicKind."""
    for kind in _BY_LENGTH:
        vehicle = name.removesuffix('/' + kind.value).strip('/')
        if name.endswith('/' + kind.value) and vehicle:
            return RecordedTopic(name, vehicle, kind)
    return None
