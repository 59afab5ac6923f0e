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
    VisionConfig,
    tags_available,
)
from explore_slam.vision.detectors.sift import Sift
from explore_slam.vision.obstacles import ObstacleDetector
from explore_slam.vision.rolling_shutter import at_the_stamp
from explore_slam.vision.tag_images import TagInView, draw_view

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


def in_motion(config):
    """Return covariances of what a vehicle observes that turns."""
    found = FeatureExtractor(config).extract(frame())
    velocity = np.array([0.2, 0.0, 0.5])
    readout = config.depth.camera_readout_time
    return at_the_stamp(found, velocity, readout).covariances.tobytes()


def keyframes(config):
    """Return which frames become keyframes: on the way, turning on the spot, and at rest."""
    selector = KeyframeSelector(config.keyframes)
    poses = [Pose2(0.05 * k, 0.0, 0.0) for k in range(20)]
    poses += [Pose2(0.95, 0.0, 0.05 * k) for k in range(20)] + [Pose2(0.95, 0.0, 0.95)] * 80
    return [selector.select(0.1 * k, pose) for k, pose in enumerate(poses)]


def tags(config):
    """Return where a tag is seen, and how well; a setting of no file sees none."""
    if not tags_available():
        return None
    random, turn = np.random.default_rng(0), np.diag([1.0, -1.0, -1.0])
    view = TagInView(7, 0.2, turn, np.array([0.1, 0.0, 1.5]))
    image = draw_view('tag36h11', [view], CAMERA, random)
    depth = np.zeros((240, 320), np.float32)
    found = FeatureExtractor(config).observe_tags(RgbdFrame(0.0, image, depth, CAMERA))
    return found and (found.poses.tobytes(), found.covariances.tobytes())


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
    'camera_readout_time': (0.05, in_motion),
    'depth_edge_ratio': (0.5, observations),
    'depth_edges': ('widen', observations),
    'minimum_travel_distance': (0.5, keyframes),
    'minimum_travel_heading': (0.4, keyframes),
    'maximum_keyframe_gap': (1.0, keyframes),
    'tags_file': ('', tags),
    'tag_corner_noise': (1.0, tags),
    'tag_scale_error': (0.05, tags),
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


# used by the agent: test_tag_mapping
ELSEWHERE = {'tag_survey_deviation', 'tag_survey_heading'}


@pytest.fixture(scope='module')
def settings(tmp_path_factory):
    """Settings that effects are compared with: fewer features, and a tag."""
    path = tmp_path_factory.mktemp('site') / 'tags.yaml'
    path.write_text('size: 0.2\n')
    return with_values(VisionConfig(), {'feature_budget': 100, 'tags_file': str(path)})


@pytest.fixture(scope='module')
def usual(settings):
    """Outcomes with these settings."""
    return {experiment: experiment(settings) for _, experiment in EFFECTS.values()}


@pytest.mark.parametrize('name', EFFECTS)
def test_every_setting_changes_what_is_observed(name, settings, usual):
    value, experiment = EFFECTS[name]
    if experiment is tags and not tags_available():
        pytest.skip('this OpenCV finds no tags')
    assert experiment(with_values(settings, {name: value})) != usual[experiment]


@pytest.mark.parametrize('experiment', [observations, keyframes, tags])
def test_the_same_settings_give_the_same(experiment, settings, usual):
    assert experiment(settings) == usual[experiment]


def test_the_detector_is_the_one_of_the_setting(monkeypatch):
    """Only one detector is built in; the setting chooses among those registered."""
    with pytest.raises(ConfigError, match='feature_detector'):
        VisionConfig(feature_detector='none')
    monkeypatch.setitem(DETECTORS, 'sift', Blind)
    assert len(FeatureExtractor(VisionConfig(feature_detector='sift')).extract(frame())) == 0


def test_no_setting_is_left_out():
    # depth_obstacles is the agent's: test/agent/measurements/test_obstacles.py
    elsewhere = {*ELSEWHERE, 'feature_detector', 'depth_obstacles'}
    assert {info.name for info, _ in settings_of(VisionConfig())} == {*EFFECTS, *elsewhere}
