"""All settings of vision in one tree."""

from dataclasses import dataclass

from explore_slam.mounts import CameraMountConfig
from explore_slam.settings import Section, section, setting
from explore_slam.tags import TagConfig
from explore_slam.vision.detectors import DETECTORS
from explore_slam.vision.sections import (
    DepthConfig,
    FeatureConfig,
    KeyframeConfig,
    ObstacleConfig,
)


@dataclass(frozen=True)
class VisionConfig(Section):
    """Settings of the extraction of landmark observations from RGB-D frames."""

    feature_detector: str = setting(
        'sift',
        'Detector and descriptor of features; slam needs the same descriptor_kind',
        choices=tuple(DETECTORS),
    )
    features: FeatureConfig = section(FeatureConfig)
    depth: DepthConfig = section(DepthConfig)
    keyframes: KeyframeConfig = section(KeyframeConfig)
    obstacles: ObstacleConfig = section(ObstacleConfig)
    mount: CameraMountConfig = section(CameraMountConfig)
    tags: TagConfig = section(TagConfig)
