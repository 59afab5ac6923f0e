"""SIFT features of RGB-D frames: geometry, covariance, budget, depth encodings, determinism."""

import math

import cv2
import numpy as np
import pytest

from explore_slam.data import Intrinsics, RgbdFrame
from explore_slam.errors import ConfigError, VisionError
from explore_slam.geometry import rotation_matrix
from explore_slam.settings import settings_of, with_values
from explore_slam.vision import CameraMount, FeatureExtractor, VisionConfig
from explore_slam.vision.detectors.sift import normalise
from explore_slam.vision.features import _nearest_pixels, spread_over_image

CAMERA = Intrinsics(320, 240, 260.0, 262.0, 158.0, 121.0)


def texture(seed=0, size=(240, 320)):
    """Blobs of many sizes: plenty of SIFT features all over the image."""
    rng = np.random.default_rng(seed)
    image = np.zeros(size)
    for scale in (2, 4, 8):
        noise = rng.standard_normal(size)
        image += cv2.GaussianBlur(noise, (0, 0), scale) * scale
    image -= image.min()
    return (image / image.max() * 255).astype(np.uint8)


def frame(depth=2.0, seed=0, dtype=np.float32):
    values = np.full((240, 320), depth, np.float32)
    if dtype == np.uint16:
        values = np.rint(values * 1000).astype(np.uint16)
    return RgbdFrame(1.5, np.dstack([texture(seed)] * 3), values, CAMERA)


def extractor(mount=None, **values):
    return FeatureExtractor(with_values(VisionConfig(), values), mount or CameraMount())


def test_wall_ahead_lies_in_a_plane_of_the_vehicle_frame():
    observations, features = extractor().extract_with_pixels(frame(2.0))
    assert len(observations) > 50
    assert observations.stamp == 1.5
    np.testing.assert_allclose(observations.positions[:, 0], 2.0, rtol=1e-6)
    expected_y = -(features.pixels[:, 0] - CAMERA.cx) / CAMERA.fx * 2.0
    expected_z = -(features.pixels[:, 1] - CAMERA.cy) / CAMERA.fy * 2.0
    np.testing.assert_allclose(observations.positions[:, 1], expected_y, atol=1e-6)
    np.testing.assert_allclose(observations.positions[:, 2], expected_z, atol=1e-6)


def test_descriptors_have_unit_length_and_type():
    for root in (False, True):
        found = extractor(root_sift=root).extract(frame())
        assert found.descriptors.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1.0, atol=1e-5)


def test_root_sift_is_the_hellinger_kernel():
    raw = np.random.default_rng(1).integers(0, 255, (5, 128)).astype(np.float32)
    unit = normalise(raw, root=True)
    share = raw / raw.sum(axis=1, keepdims=True)
    kernel = np.sqrt(share[0] * share[1]).sum()
    assert float(unit[0] @ unit[1]) == pytest.approx(kernel, abs=1e-5)


def test_mount_moves_and_turns_what_is_seen():
    mount = CameraMount(0.2, -0.1, 0.5, 0.05, 0.3, 1.1)
    plain = extractor().extract(frame())
    moved = extractor(mount).extract(frame())
    turn = rotation_matrix(0.05, 0.3, 1.1)
    np.testing.assert_allclose(moved.positions, plain.positions @ turn.T + [0.2, -0.1, 0.5])
    np.testing.assert_allclose(moved.covariances, turn @ plain.covariances @ turn.T, atol=1e-15)


def test_mount_comes_from_the_settings_when_none_is_given():
    config = with_values(VisionConfig(), {'camera_x': 0.3, 'camera_pitch': 0.1})
    assert FeatureExtractor(config).mount == CameraMount(0.3, 0.0, 0.4, 0.0, 0.1, 0.0)


def test_covariance_is_that_of_sampled_noise():
    maker = extractor(pixel_noise=1.5, depth_noise=0.004)
    observations, features = maker.extract_with_pixels(frame(2.5))
    row = int(np.argmax(np.abs(features.pixels[:, 0] - CAMERA.cx)))
    rng = np.random.default_rng(3)
    u, v = features.pixels[row][:, None] + rng.normal(0, 1.5, (2, 200_000))
    z = 2.5 + rng.normal(0, 0.004 * 2.5**2, 200_000)
    points = np.stack([z, -(u - CAMERA.cx) / CAMERA.fx * z, -(v - CAMERA.cy) / CAMERA.fy * z])
    np.testing.assert_allclose(observations.covariances[row], np.cov(points), rtol=0.03, atol=2e-6)


def test_lens_distortion_is_undone():
    lens = (0.26, -0.95, -0.005, 0.003, 1.16)
    bent = Intrinsics(320, 240, 260.0, 262.0, 158.0, 121.0, lens)
    whole = frame(2.0)
    observations, features = extractor().extract_with_pixels(
        RgbdFrame(0.0, whole.rgb, whole.depth, bent)
    )
    matrix = np.array([[260.0, 0.0, 158.0], [0.0, 262.0, 121.0], [0.0, 0.0, 1.0]])
    optical = np.stack(
        [
            -observations.positions[:, 1],
            -observations.positions[:, 2],
            observations.positions[:, 0],
        ],
        axis=1,
    )
    pixels = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), matrix, np.array(lens))[0]
    np.testing.assert_allclose(pixels.reshape(-1, 2), features.pixels, atol=0.05)
    straight = extractor().extract(whole).positions
    assert np.abs(observations.positions - straight).max() > 0.01


def test_depth_noise_grows_with_the_square_of_depth():
    near = extractor(max_depth=4.0).extract(frame(1.0)).covariances[:, 0, 0].mean()
    far = extractor(max_depth=4.0).extract(frame(3.0)).covariances[:, 0, 0].mean()
    assert math.sqrt(far / near) == pytest.approx(9.0, rel=1e-4)


def test_covariances_are_symmetric_and_positive_definite():
    found = extractor(CameraMount(roll=0.3, pitch=-0.2, yaw=2.0)).extract(frame(3.0))
    np.testing.assert_allclose(found.covariances, found.covariances.transpose(0, 2, 1), atol=1e-18)
    assert np.linalg.eigvalsh(found.covariances).min() > 0.0


def test_both_depth_encodings_agree():
    metres = extractor().extract(frame(1.234))
    millimetres = extractor().extract(frame(1.234, dtype=np.uint16))
    np.testing.assert_allclose(metres.positions, millimetres.positions, atol=1e-6)
    np.testing.assert_array_equal(metres.descriptors, millimetres.descriptors)


def test_grey_images_are_taken_too():
    colour = frame()
    grey = RgbdFrame(colour.stamp, texture(), colour.depth, CAMERA)
    np.testing.assert_allclose(
        extractor().extract(grey).positions, extractor().extract(colour).positions
    )


@pytest.mark.parametrize('value', [0.0, math.nan, math.inf, -1.0, 0.5, 3.6])
def test_invalid_depth_gives_no_observation(value):
    assert len(extractor().extract(frame(value))) == 0


def test_only_the_valid_part_of_a_frame_is_observed():
    whole = frame()
    depth = np.array(whole.depth)
    depth[:, :160] = np.nan
    found, features = extractor().extract_with_pixels(RgbdFrame(0.0, whole.rgb, depth, CAMERA))
    assert len(found) > 20
    assert features.pixels[:, 0].min() > 159


def test_features_on_an_edge_of_depth_are_dropped_or_widened():
    whole = frame(3.0)
    depth = np.array(whole.depth)
    depth[:, 100:200] = 1.5
    step = RgbdFrame(0.0, whole.rgb, depth, CAMERA)
    away = extractor().extract_with_pixels(step)[1].pixels[:, 0]
    distance = np.minimum(np.abs(away - 99.5), np.abs(away - 199.5))
    assert distance.min() > 1.5
    widened, features = extractor(
        depth_edges='widen', feature_budget=5000, feature_orientation='all'
    ).extract_with_pixels(step)
    distance = np.minimum(abs(features.pixels[:, 0] - 99.5), abs(features.pixels[:, 0] - 199.5))
    noise = np.sqrt(widened.covariances[:, 0, 0])
    assert (distance < 1.4).any()
    assert noise[distance < 1.4].min() == pytest.approx(1.5, rel=0.1)
    assert noise[distance > 4.0].max() < 0.1


def test_single_wild_depths_are_taken_out():
    whole = frame(2.0)
    depth = np.array(whole.depth)
    depth[10::20, 10::20] = 2.09  # below the edge threshold, speckle all the same
    found = extractor().extract(RgbdFrame(0.0, whole.rgb, depth, CAMERA))
    np.testing.assert_allclose(found.positions[:, 0], 2.0, rtol=1e-6)


def test_budget_is_kept_and_spread_over_the_image():
    rgb = texture()
    rgb[:, 160:] = rgb[:, 160:] // 4 + 96  # weak contrast on the right
    picture = RgbdFrame(0.0, rgb, np.full((240, 320), 2.0, np.float32), CAMERA)
    spread, features = extractor(
        feature_budget=60, sift_contrast_threshold=0.01
    ).extract_with_pixels(picture)
    assert len(spread) == 60
    assert (features.pixels[:, 0] > 160).sum() >= 20
    greedy = extractor(
        feature_budget=60,
        sift_contrast_threshold=0.01,
        feature_grid_rows=1,
        feature_grid_columns=1,
    ).extract_with_pixels(picture)[1]
    assert (greedy.pixels[:, 0] > 160).sum() < 10


def test_spread_takes_the_best_of_each_cell_first():
    config = with_values(
        VisionConfig(), {'feature_budget': 3, 'feature_grid_rows': 1, 'feature_grid_columns': 2}
    ).features
    pixels = np.array([[1.0, 1.0], [2.0, 1.0], [3.0, 1.0], [90.0, 1.0]])
    rows = spread_over_image(pixels, np.array([5.0, 9.0, 7.0, 1.0]), (100, 10), config)
    assert rows.tolist() == [1, 3, 2]


def test_spread_divides_the_image_into_rows_and_columns():
    config = with_values(
        VisionConfig(), {'feature_budget': 4, 'feature_grid_rows': 2, 'feature_grid_columns': 2}
    ).features
    corners = np.array([[10.0, 10.0], [90.0, 10.0], [10.0, 190.0], [90.0, 190.0]])
    pixels = np.vstack([corners, corners + [5.0, -5.0]])
    weak_first = np.array([1.0, 2.0, 3.0, 4.0, 9.0, 8.0, 7.0, 6.0])
    rows = spread_over_image(pixels, weak_first, (100, 200), config)
    assert rows.tolist() == [4, 5, 6, 7]
    clustered = np.array([[49.0, 99.0], [51.0, 99.0], [49.0, 101.0], [51.0, 101.0], [1.0, 1.0]])
    rows = spread_over_image(clustered, np.array([5.0, 4.0, 3.0, 2.0, 6.0]), (100, 200), config)
    assert rows.tolist() == [4, 1, 2, 3]


def test_same_result_whatever_the_number_of_threads():
    before = cv2.getNumThreads()
    results = []
    try:
        for threads in (1, 2, 7):
            cv2.setNumThreads(threads)
            results.append(extractor().extract(frame(seed=4)))
    finally:
        cv2.setNumThreads(before)
    for other in results[1:]:
        assert np.array_equal(results[0].positions, other.positions)
        assert np.array_equal(results[0].descriptors, other.descriptors)


@pytest.mark.parametrize('orientation', ['single', 'all', 'upright'])
def test_orientations(orientation):
    _, features = extractor(
        feature_orientation=orientation, feature_budget=5000
    ).extract_with_pixels(frame())
    places = {
        (*pixel, size)
        for pixel, size in zip(features.pixels.tolist(), features.sizes, strict=True)
    }
    assert len(features.pixels) > 50
    if orientation == 'all':
        assert len(places) < len(features.pixels)
    else:
        assert len(places) == len(features.pixels)


def test_features_are_found_again_in_a_shifted_image():
    rgb = texture()
    depth = np.full((240, 320), 2.0, np.float32)
    first, at_first = extractor().extract_with_pixels(RgbdFrame(0.0, rgb, depth, CAMERA))
    second, at_second = extractor().extract_with_pixels(
        RgbdFrame(1.0, np.roll(rgb, 12, axis=1), depth, CAMERA)
    )
    distance = 2.0 - 2.0 * first.descriptors @ second.descriptors.T
    rows, columns = np.nonzero(distance < 0.1)
    shift = at_second.pixels[columns] - at_first.pixels[rows]
    assert len(rows) > 30
    assert (np.abs(shift - [12.0, 0.0]).max(axis=1) < 0.5).mean() > 0.9


def test_blank_image_gives_no_observation():
    blank = RgbdFrame(
        2.0, np.full((240, 320, 3), 90, np.uint8), np.full((240, 320), 2.0, np.float32), CAMERA
    )
    for orientation in ('single', 'all', 'upright'):
        found = extractor(feature_orientation=orientation).extract(blank)
        assert len(found) == 0
        assert found.stamp == 2.0


def test_unusable_settings_are_refused():
    with pytest.raises(VisionError, match=r'min_depth is 4\.0'):
        extractor(min_depth=4.0)
    with pytest.raises(VisionError, match='camera mount'):
        FeatureExtractor(mount=CameraMount(x=math.nan))
    with pytest.raises(ConfigError, match='feature_orientation'):
        extractor(feature_orientation='sideways')


def test_setting_names_are_unique():
    names = [info.name for info, _ in settings_of(VisionConfig())]
    assert len(names) == len(set(names))


def test_the_nearest_pixel_is_inside_the_image():
    places = np.array([[3.2, 4.6], [-0.6, 0.4], [0.2, -3.0], [319.7, 239.8]])
    columns, rows = _nearest_pixels(places, (240, 320))
    assert list(zip(columns.tolist(), rows.tolist(), strict=True)) == [
        (3, 5), (0, 0), (0, 0), (319, 239),
    ]  # fmt: skip
