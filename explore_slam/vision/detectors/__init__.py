"""Feature detectors by name; a new one is a module and a line here."""

from collections.abc import Callable

from explore_slam.vision.detectors.detector import Detector, Features
from explore_slam.vision.detectors.sift import Sift
from explore_slam.vision.sections import FeatureConfig

__all__ = ['DETECTORS', 'Detector', 'Features']

DETECTORS: dict[str, Callable[[FeatureConfig], Detector]] = {'sift': Sift}
