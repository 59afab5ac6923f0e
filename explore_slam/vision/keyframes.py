"""Which frames are worth a filter update: far enough, turned enough, or long enough ago."""

import logging
import math

from explore_slam.errors import VisionError
from explore_slam.geometry import Pose2
from explore_slam.vision.config import KeyframeConfig, VisionConfig

logger = logging.getLogger(__name__)


class KeyframeSelector:
    """Chooses the keyframes of one vehicle."""

    def __init__(self, config: VisionConfig | KeyframeConfig | None = None):
        chosen = config or KeyframeConfig()
        self.config = chosen.keyframes if isinstance(chosen, VisionConfig) else chosen
        self._last: tuple[float, Pose2] | None = None

    def wants(self, stamp: float, pose: Pose2) -> bool:
        """Tell whether a frame taken at this stamp (s) and pose becomes a keyframe.

        True makes it the keyframe that later frames are measured against. The pose is that of
        the odometry: only differences count. When time goes back, the choice starts anew.
        """
        if not (math.isfinite(stamp) and pose.is_finite()):
            raise VisionError(
                f'keyframe at stamp {stamp!r}, pose {tuple(pose)}: expected finite values'
            )
        if self._last is not None and stamp < self._last[0]:
            logger.warning(
                'time went back from %.3f s to %.3f s: keyframes start anew', self._last[0], stamp
            )
            self._last = None
        if self._last is None or self._is_due(stamp, pose, *self._last):
            self._last = (stamp, pose)
            return True
        return False

    def reset(self) -> None:
        """Forget the last keyframe: the next frame becomes one."""
        self._last = None

    def _is_due(self, stamp: float, pose: Pose2, last_stamp: float, last_pose: Pose2) -> bool:
        moved = last_pose.between(pose)
        return (
            math.hypot(moved.x, moved.y) >= self.config.minimum_travel_distance
            or abs(moved.theta) >= self.config.minimum_travel_heading
            or stamp - last_stamp >= self.config.maximum_keyframe_gap
        )
