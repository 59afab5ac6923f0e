"""Vision: RGB-D frames to landmark observations, tags, keyframe selection, compressed images."""

from explore_slam.vision.camera_mount import CameraMount
from explore_slam.vision.compression import decode_compressed
from explore_slam.vision.config import VisionConfig
from explore_slam.vision.detectors import DETECTORS, Features
from explore_slam.vision.features import FeatureExtractor
from explore_slam.vision.keyframes import KeyframeSelector
from explore_slam.vision.tags import TagDetector, tags_available

__all__ = [
    'DETECTORS',
    'CameraMount',
    'FeatureExtractor',
    'Features',
    'KeyframeSelector',
    'TagDetector',
    'VisionConfig',
    'decode_compressed',
    'tags_available',
]
