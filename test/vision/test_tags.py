"""Tags in drawn images: found by OpenCV, placed by their corners, with covariances that hold."""

import logging
import math

import cv2
import numpy as np
import pytest

from explore_slam.data import UNKNOWN_HEADING, Intrinsics, RgbdFrame
from explore_slam.geometry import wrap_angle
from explore_slam.tags import FAMILIES, TagConfig
from explore_slam.vision import CameraMount, FeatureExtractor, VisionConfig, tags_available
from explore_slam.vision.tag_images import TagInView, corners_in_view, draw_tag, draw_view
from explore_slam.vision.tags import TagDetector, pose_of_tag

pytestmark = pytest.mark.skipif(not tags_available(), reason='this OpenCV finds no tags')

CAMERA = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
MOUNT = CameraMount(0.1, 0.0, 0.4)
SIZE = 0.2


def view(tag, x, y, yaw, z=0.5, size=SIZE):
    """Return a tag at (x, y, z) m of the vehicle frame that faces yaw (rad)."""
    normal, up = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    rotation = np.stack([np.cross(up, normal), up, normal], axis=1)
    turn = MOUNT.rotation.T
    return TagInView(tag, size, turn @ rotation, turn @ (np.array([x, y, z]) - MOUNT.translation))


@pytest.fixture
def detector(tmp_path):
    """Make a detector of tags of a family, from a file."""

    def make(text=f'size: {SIZE}\n'):
        path = tmp_path / 'tags.yaml'
        path.write_text(text)
        return TagDetector(TagConfig(tags_file=str(path)), MOUNT)

    return make


def draw(tags, seed=0, family='tag36h11'):
    return draw_view(family, tags, CAMERA, np.random.default_rng(seed))


@pytest.mark.parametrize('family', FAMILIES)
def test_tags_of_every_family_are_found_with_their_numbers(detector, family):
    found = detector(f'family: {family}\nsize: {SIZE}\n').detect(
        draw([view(11, 1.5, 0.3, math.pi), view(23, 1.4, -0.3, 2.8)], family=family)
    )
    assert [item.tag for item in found] == [11, 23]
    true = corners_in_view(view(11, 1.5, 0.3, math.pi), CAMERA)
    assert np.abs(found[0].corners - true).max() < 0.2  # OpenCV's are 0.3 px inward on average
    assert draw_tag(family, 11).shape == (8 * (FAMILIES[family][0] + 2),) * 2


def test_poses_are_within_their_covariances(detector):
    random, finder, distances, known = np.random.default_rng(1), detector(), [], 0
    for _ in range(60):
        x, yaw = random.uniform(0.8, 4.0), math.pi + random.uniform(-1.0, 1.0)
        true = np.array([x, x * random.uniform(-0.3, 0.3), wrap_angle(yaw)])
        image = draw([view(5, *true)], seed=int(random.integers(1 << 30)))
        found = finder.observe_image(image, CAMERA, 1.5)
        if not len(found):
            continue
        off = found.poses[0] - true
        off[2] = wrap_angle(float(off[2]))
        distances.append(off @ np.linalg.solve(found.covariances[0], off))
        known += found.covariances[0, 2, 2] < UNKNOWN_HEADING
    assert len(distances) > 50
    assert known > 25
    # 3 is expected; the setting of the noise is for real cameras, with errors of their calibration
    assert np.mean(distances) < 3.0
    assert np.max(distances) < 20.0


def test_a_heading_that_could_be_mirrored_is_not_believed():
    """Noise of the corners of a small tag makes both poses of the square fit alike."""
    random, config = np.random.default_rng(2), TagConfig()
    true = view(3, 3.5, 0.0, math.pi - 0.5, size=0.1)
    corners = corners_in_view(true, CAMERA)
    for _ in range(100):
        noisy = corners + config.tag_corner_noise * random.standard_normal((4, 2))
        pose, covariance = pose_of_tag(noisy, 0.1, CAMERA, MOUNT, config)
        off = wrap_angle(float(pose[2]) - (math.pi - 0.5))
        assert abs(off) < 4.0 * math.sqrt(covariance[2, 2])
        assert math.dist(pose[:2], (3.5, 0.0)) < 5.0 * math.sqrt(covariance[:2, :2].trace())


def test_a_tag_on_the_floor_has_a_position_and_no_heading(detector):
    up, ahead = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    turn = MOUNT.rotation.T
    rotation = turn @ np.stack([np.cross(ahead, up), ahead, up], axis=1)
    lying = TagInView(4, SIZE, rotation, turn @ (np.array([1.2, 0.1, 0.0]) - MOUNT.translation))
    found = detector().observe_image(draw([lying]), CAMERA, 0.0)
    assert found.ids.tolist() == [4]
    assert math.dist(found.poses[0, :2], (1.2, 0.1)) < 0.05
    assert found.covariances[0, 2, 2] >= UNKNOWN_HEADING


def test_numbers_without_a_size_are_ignored(detector):
    image = draw([view(1, 1.5, 0.3, math.pi), view(2, 1.5, -0.3, math.pi)])
    found = detector(f'tags: [{{id: 2, size: {SIZE}}}]\n').observe_image(image, CAMERA, 0.0)
    assert found.ids.tolist() == [2]


def test_a_tag_twice_in_one_image_is_named_once_and_left_out(detector, caplog):
    twice = [view(6, 1.5, 0.4, math.pi), view(6, 1.5, -0.4, math.pi), view(8, 1.5, 0.0, math.pi)]
    finder = detector()
    with caplog.at_level(logging.WARNING):
        for seed in range(3):
            found = finder.observe_image(draw(twice, seed), CAMERA, 0.0)
            assert found.ids.tolist() == [8]
    (record,) = caplog.records
    assert record.getMessage().startswith('tag 6 is seen 2 times in one image, at the pixels (')


def test_frames_carry_tags_beside_features(tmp_path):
    path = tmp_path / 'tags.yaml'
    path.write_text(f'size: {SIZE}\n')
    config = VisionConfig(tags=TagConfig(tags_file=str(path)))
    grey = draw([view(9, 1.5, 0.1, math.pi)])
    depth = np.full(grey.shape, 1.4, np.float32)
    colour = RgbdFrame(2.0, np.dstack([grey] * 3), depth, CAMERA, MOUNT.optical_pose)
    extractor = FeatureExtractor(config, CameraMount(5.0, 0.0, 0.0))
    found = extractor.observe_tags(colour)
    assert (found.stamp, found.ids.tolist()) == (2.0, [9])
    assert math.dist(found.poses[0, :2], (1.5, 0.1)) < 0.05
    assert len(extractor.extract(colour)) > 5
    assert extractor.observe_tags(RgbdFrame(2.0, np.zeros_like(grey), depth, CAMERA)) is None
    assert FeatureExtractor().observe_tags(colour) is None


def test_an_older_opencv_without_tags_is_named(monkeypatch, detector, caplog):
    monkeypatch.delattr(cv2, 'aruco')
    with caplog.at_level(logging.WARNING):
        finder = detector('size: 0.17\n')
    assert not finder.is_active
    assert finder.detect(np.zeros((480, 640), np.uint8)) == []
    assert 'expected 4.7 or newer: tags are not used' in caplog.records[-1].getMessage()
