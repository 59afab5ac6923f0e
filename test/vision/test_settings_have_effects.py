"""Every setting of vision changes what is observed; a new one without a test fails here."""

import cv2
import numpy as np
import pytest
from vision.depth_scenes import TABLE, cast
from vision.depth_scenes import frame as depth_frame

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import ConfigError
from explore_slam.geometry import Pose2
from explore_slam.settings import settings_of, with_values
from explore_slam.vision import (
    DETECTORS,
    FeatureExtractor,
    KeyframeSelector,
    ObstacleDetector,
    VisionConfig,
)
from explore_slam.vision.detectors.sift import Sift

CAMERA = Intrinsics(320, 240, 260.0, 262.0, 158.0, 121.0)


def frame():
    """A frame with plenty of features of many sizes, and a step of depth."""
    random = np.random.default_rng(0)
    image = sum(
        cv2.GaussianBlur(random.standard_normal((240, 320)), (0, 0), scale) * scale
        for scale in (2, 4, 8)
    )
    grey = ((image - image.min()) / np.ptp(image) * 255).astype(np.uint8)
    depth = np.full((240, 320), 2.0, np.float32)
    depth[:, 150:] = 2.6
    return RgbdFrame(0.0, grey, depth, CAMERA)


def observations(config):
    found = FeatureExtractor(config).extract(frame())
    return tuple(x.tobytes() for x in (found.positions, found.covariances, found.descriptors))


def keyframes(config):
    """Return which frames become keyframes: on the way, turning on the spot, and at rest."""
    selector = KeyframeSelector(config.keyframes)
    poses = [Pose2(0.05 * k, 0.0, 0.0) for k in range(20)]
    poses += [Pose2(0.95, 0.0, 0.05 * k) for k in range(20)] + [Pose2(0.95, 0.0, 0.95)] * 80
    return [selector.select(0.1 * k, pose) for k, pose in enumerate(poses)]


def obstacles(config):
    """Return what is seen of a table, of a thing on the floor and of a step; and the scan."""
    things = [TABLE, (1.3, 1.5, -0.2, 0.2, 0.08), (1.3, 1.5, 0.3, 0.4, 0.8)]
    depth = cast(tables=things, pit=(2.2, 0.1), noise=0.003, limit=3.5)
    detector, scene = ObstacleDetector(config), depth_frame(depth)
    view = detector.detect(scene)
    scan = detector.scan(scene)
    return view.cells.tobytes(), view.occupied.tobytes(), scan.ranges.tobytes()


class Blind(Sift):
    """A detector that finds nothing."""

    def find(self, _grey, _mask):
        return []


EFFECTS = {
    'feature_budget': (10, observations),
    'feature_grid_rows': (1, observations),
    'feature_grid_columns': (1, observations),
    'sift_contrast_threshold': (0.2, observations),
    'sift_edge_threshold': (2.0, observations),
    'minimum_feature_size': (6.0, observations),
    'feature_orientation': ('all', observations),
    'root_sift': (True, observations),
    'min_depth': (2.5, observations),
    'max_depth': (2.5, observations),
    'pixel_noise': (3.0, observations),
    'depth_noise': (0.1, observations),
    'depth_edge_ratio': (0.5, observations),
    'depth_edges': ('widen', observations),
    'minimum_travel_distance': (0.5, keyframes),
    'minimum_travel_heading': (0.4, keyframes),
    'maximum_keyframe_gap': (1.0, keyframes),
    'obstacle_lowest': (0.15, obstacles),
    'obstacle_highest': (0.7, obstacles),
    'step_depth': (0.3, obstacles),
    'obstacle_range': (2.0, obstacles),
    'camera_scan_lowest': (0.04, obstacles),
    'camera_scan_highest': (0.9, obstacles),
    'camera_x': (0.3, observations),
    'camera_y': (0.1, observations),
    'camera_z': (0.8, observations),
    'camera_roll': (0.1, observations),
    'camera_pitch': (0.1, observations),
    'camera_yaw': (0.1, observations),
}


USUAL = with_values(VisionConfig(), {'feature_budget': 100})


@pytest.fixture(scope='module')
def usual():
    """Outcomes with usual settings, which effects are compared with."""
    return {experiment: experiment(USUAL) for _, experiment in EFFECTS.values()}


@pytest.mark.parametrize('name', EFFECTS)
def test_every_setting_changes_what_is_observed(name, usual):
    value, experiment = EFFECTS[name]
    assert experiment(with_values(USUAL, {name: value})) != usual[experiment]


@pytest.mark.parametrize('experiment', [observations, keyframes])
def test_the_same_settings_give_the_same(experiment, usual):
    assert experiment(USUAL) == usual[experiment]


def test_the_detector_is_the_one_of_the_setting(monkeypatch):
    """Only one detector is built in; the setting chooses among those registered."""
    with pytest.raises(ConfigError, match='feature_detector'):
        VisionConfig(feature_detector='none')
    monkeypatch.setitem(DETECTORS, 'sift', Blind)
    assert len(FeatureExtractor(VisionConfig(feature_detector='sift')).extract(frame())) == 0


def test_no_setting_is_left_out():
    # depth_obstacles is the agent's: test/agent/measurements/test_obstacles.py
    elsewhere = {'feature_detector', 'depth_obstacles'}
    assert {info.name for info, _ in settings_of(VisionConfig())} == {*EFFECTS, *elsewhere}
