"""Pairing of colour and depth images by stamp, with messages as rosbags makes them."""

import numpy as np
import pytest
from compressed_images import jpeg, png

from explore_slam import messages
from explore_slam.data import Intrinsics
from explore_slam.errors import DataError
from explore_slam.messages.frame_pairing import FramePairing
from explore_slam.messages.measurement import RefusedMessageError
from explore_slam.messages.sensor_mounts import SensorMounts
from explore_slam.messages.topics import TopicKind
from explore_slam.messages.transforms import TransformTree
from explore_slam.messages.vehicle_settings import VehicleConfig
from explore_slam.recording.rosbags_types import MESSAGES

CAMERA = Intrinsics(8, 6, 10.0, 10.0, 4.0, 3.0)
RGB = np.full((6, 8, 3), (10, 120, 240), np.uint8)
DEPTH = np.full((6, 8), 1500, np.uint16)


def color(stamp: float, image=RGB, encoding='rgb8'):
    return messages.image_message(MESSAGES, stamp, 'c', encoding, image)


def depth(stamp: float, image=DEPTH, encoding='16UC1'):
    return messages.image_message(MESSAGES, stamp, 'c', encoding, image)


def compressed(stamp: float, data: bytes):
    return MESSAGES.make(
        'sensor_msgs/CompressedImage',
        header=messages.header(MESSAGES, stamp, 'c'),
        format='',
        data=np.frombuffer(data, np.uint8),
    )


@pytest.fixture
def pairer() -> FramePairing:
    pairer = FramePairing()
    pairer.add_camera_info(messages.camera_info_message(MESSAGES, 1.0, 'c', CAMERA))
    return pairer


def test_pairs_in_either_order_and_takes_the_colour_stamp(pairer):
    assert pairer.add_color(color(1.0)) is None
    first = pairer.add_depth(depth(1.01))
    assert pairer.add_depth(depth(2.01)) is None
    second = pairer.add_color(color(2.0))
    assert (first.stamp, second.stamp) == (1.0, 2.0)
    np.testing.assert_array_equal(second.rgb, RGB)
    np.testing.assert_array_equal(second.depth, DEPTH)
    assert pairer.unpaired == 0


def test_bgr_and_metres_come_out_as_rgb_and_metres(pairer):
    pairer.add_color(color(1.0, RGB[:, :, ::-1], 'bgr8'))
    frame = pairer.add_depth(depth(1.0, DEPTH.astype(np.float32) / 1000, '32FC1'))
    np.testing.assert_array_equal(frame.rgb, RGB)
    assert frame.depth.dtype == np.float32
    assert frame.depth[0, 0] == np.float32(1.5)


def test_compressed_images_pair_like_plain_ones(pairer):
    pairer.add_color(compressed(1.0, jpeg(RGB, 100)))
    frame = pairer.add_depth(compressed(1.0, png(DEPTH)))
    np.testing.assert_array_equal(frame.depth, DEPTH)
    assert np.abs(frame.rgb.astype(int) - RGB).max() < 12


def test_a_colour_image_without_depth_is_dropped_and_counted(pairer):
    for index in range(10):
        assert pairer.add_color(color(1.0 + index)) is None
    assert pairer.unpaired == 4
    assert pairer.add_depth(depth(10.0)) is not None
    assert pairer.unpaired == 9


def test_too_far_apart_does_not_pair(pairer):
    pairer.add_color(color(1.0))
    assert pairer.add_depth(depth(1.05)) is None


def test_without_camera_info_there_is_no_frame():
    pairer = FramePairing()
    pairer.add_color(color(1.0))
    assert pairer.add_depth(depth(1.0)) is None
    assert pairer.without_camera_info == 1


def test_a_clock_that_jumps_back_starts_anew(pairer):
    pairer.add_color(color(100.0))
    assert pairer.add_color(color(1.0)) is None
    assert pairer.unpaired == 1
    assert pairer.add_depth(depth(1.0)).stamp == 1.0


def test_another_size_and_encoding_are_named(pairer):
    pairer.add_color(color(1.0, np.zeros((4, 4, 3), np.uint8)))
    with pytest.raises(DataError, match=r'\(4, 4, 3\)'):
        pairer.add_depth(depth(1.0))
    pairer.add_color(color(2.0, encoding='yuv422'))
    with pytest.raises(DataError, match='yuv422'):
        pairer.add_depth(depth(2.0))
    pairer.add_color(color(3.0))
    assert pairer.add_depth(depth(3.0)) is not None


def test_an_image_in_two_forms_gives_one_frame(pairer):
    frames = []
    for stamp in (1.0, 1.033, 1.066):
        frames += [pairer.add_color(color(stamp)), pairer.add_depth(depth(stamp + 0.004))]
        frames.append(pairer.read(TopicKind.COLOR_COMPRESSED, compressed(stamp, jpeg(RGB))))
        packed = compressed(stamp + 0.004, png(DEPTH))
        frames.append(pairer.read(TopicKind.DEPTH_COMPRESSED, packed))
    assert [frame.stamp for frame in frames if frame is not None] == [1.0, 1.033, 1.066]
    assert pairer.unpaired == 0


def test_the_tolerance_is_a_setting_and_is_named():
    config = VehicleConfig(pairing_tolerance=0.05)
    pairer = FramePairing(SensorMounts('robot1', TransformTree(), config))
    pairer.add_camera_info(messages.camera_info_message(MESSAGES, 1.0, 'c', CAMERA))
    pairer.add_color(color(1.0))
    assert pairer.add_depth(depth(1.04)) is not None
    assert '50 ms (pairing_tolerance)' in pairer.explanations()['unpaired_images']


def test_a_refusal_names_the_topic_of_the_malformed_image(pairer):
    pairer.read(TopicKind.DEPTH_COMPRESSED, compressed(1.0, b'no image'))
    with pytest.raises(RefusedMessageError) as caught:
        pairer.read(TopicKind.COLOR, color(1.0))
    assert caught.value.topic is TopicKind.DEPTH_COMPRESSED
    pairer.read(TopicKind.DEPTH, depth(2.0))
    with pytest.raises(RefusedMessageError) as caught:
        pairer.read(TopicKind.COLOR, color(2.0, encoding='yuv422'))
    assert caught.value.topic is TopicKind.COLOR


def test_depth_of_another_frame_is_named_once(caplog):
    pairer = FramePairing(SensorMounts('robot1', TransformTree()))
    pairer.add_camera_info(messages.camera_info_message(MESSAGES, 1.0, 'c', CAMERA))
    for stamp in (1.0, 2.0):
        pairer.add_color(color(stamp))
        late = depth(stamp)
        late.header.frame_id = 'depth_frame'
        assert pairer.add_depth(late) is not None
    assert caplog.text.count("depth images are in frame 'depth_frame'") == 1
