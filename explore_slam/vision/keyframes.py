"""Keyframe selection: a filter update per distance travelled, change of heading, or time."""

import logging
import math

from explore_slam.errors import VisionError
from explore_slam.geometry import Pose2, moved_enough
from explore_slam.vision.config import VisionConfig
from explore_slam.vision.sections import KeyframeConfig

logger = logging.getLogger(__name__)


class KeyframeSelector:
    """Selects the keyframes of one vehicle."""

    def __init__(self, config: VisionConfig | KeyframeConfig | None = None):
        chosen = config or KeyframeConfig()
        self.config = chosen.keyframes if isinstance(chosen, VisionConfig) else chosen
        self._last: tuple[float, Pose2] | None = None

    def select(self, stamp: float, pose: Pose2) -> bool:
        """Return whether a frame becomes a keyframe; if so, later frames are compared with it.

        stamp: of the frame (s); when it goes back, the selection starts again.
        pose: of the vehicle in the odometry frame, since only differences count.
        """
        if not (math.isfinite(stamp) and pose.is_finite()):
            raise VisionError(
                f'keyframe at stamp {stamp!r}, pose {tuple(pose)}: expected finite values'
            )
        if self._last is not None and stamp < self._last[0]:
            logger.warning(
                'time went back from %.3f s to %.3f s: keyframe selection starts again',
                self._last[0],
                stamp,
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
        config = self.config
        moved = last_pose.between(pose)
        return (
            moved_enough(moved, config.minimum_travel_distance, config.minimum_travel_heading)
            or stamp - last_stamp >= config.maximum_keyframe_gap
        )
