"""The kinds of measurements that the agent uses; another one is a line here."""

from explore_slam.messages.frame_pairing import FRAME
from explore_slam.messages.imu import IMU
from explore_slam.messages.inter_robot import INTER_ROBOT
from explore_slam.messages.landmarks import LANDMARKS
from explore_slam.messages.measurement import MeasurementKind
from explore_slam.messages.obstacles import OBSTACLES
from explore_slam.messages.odometry import ODOMETRY
from explore_slam.messages.scans import SCAN
from explore_slam.messages.tags import TAGS
from explore_slam.messages.topics import TopicKind

MEASUREMENT_KINDS: tuple[MeasurementKind, ...] = (
    ODOMETRY, IMU, SCAN, FRAME, LANDMARKS, TAGS, OBSTACLES, INTER_ROBOT,
)  # fmt: skip

KIND_OF_TOPIC: dict[TopicKind, MeasurementKind] = {
    topic: kind for kind in MEASUREMENT_KINDS for topic in kind.topics
}
