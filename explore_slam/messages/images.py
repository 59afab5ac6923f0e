"""Colour images, depth images (REP-118) and camera intrinsics."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import DISTORTION_LENGTHS, Intrinsics
from explore_slam.errors import DataError
from explore_slam.messages.base import MessageFactory, header

COLOR_CHANNELS = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1, '8UC1': 1, '8UC3': 3}
DEPTH_TYPES: dict[str, type] = {'16UC1': np.uint16, 'mono16': np.uint16, '32FC1': np.float32}
# names of sensor_msgs and of librealsense -> model of the record
DISTORTION_MODELS = {
    'plumb_bob': 'plumb_bob',
    'brown_conrady': 'plumb_bob',
    'rational_polynomial': 'rational_polynomial',
    'equidistant': 'equidistant',
    'kannala_brandt4': 'equidistant',
    'inverse_brown_conrady': 'inverse_brown_conrady',
}


def _image_rows(message: Any, item_size: int, channels: int) -> NDArray[np.uint8]:
    """Return the bytes of an image (height, width * channels * item_size) without padding."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * item_size
    data = np.frombuffer(message.data, np.uint8)
    if step < row or data.size < step * height or height == 0 or width == 0:
        raise DataError(
            f'image {width} x {height} {message.encoding}: step {step} and {data.size} bytes, '
            f'expected a step of at least {row} and step x height bytes'
        )
    return data[: step * height].reshape(height, step)[:, :row]


def color_array(message: Any) -> NDArray[np.uint8]:
    """Return the pixels of a sensor_msgs/Image: RGB (H, W, 3) or grey (H, W)."""
    channels = COLOR_CHANNELS.get(message.encoding)
    if channels is None:
        raise DataError(
            f'colour image: encoding {message.encoding!r}, '
            f'expected one of {sorted(COLOR_CHANNELS)}'
        )
    rows = _image_rows(message, 1, channels)
    if channels == 1:
        return rows
    image = rows.reshape(rows.shape[0], -1, channels)[:, :, :3]
    return image[:, :, ::-1] if message.encoding.startswith('bgr') else image


def depth_array(message: Any) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Return the depth (H, W) in a sensor_msgs/Image (REP-118): uint16 in mm or float32 in m."""
    kind = DEPTH_TYPES.get(message.encoding)
    if kind is None:
        raise DataError(
            f'depth image: encoding {message.encoding!r}, expected one of {sorted(DEPTH_TYPES)}'
        )
    dtype = np.dtype(kind)
    rows = _image_rows(message, dtype.itemsize, 1)
    order = dtype.newbyteorder('>' if message.is_bigendian else '<')
    depth: NDArray[Any] = np.ascontiguousarray(rows).view(order).astype(dtype, copy=False)
    return depth


def image_message(
    factory: MessageFactory, stamp: float, frame: str, encoding: str, image: NDArray[Any]
) -> Any:
    """Return a sensor_msgs/Image of an array (H, W) or (H, W, C)."""
    packed = np.ascontiguousarray(image)
    height, width = packed.shape[:2]
    raw = packed.view(np.uint8).reshape(-1)
    return factory.make(
        'sensor_msgs/Image',
        header=header(factory, stamp, frame),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=raw.size // height,
        data=factory.sequence(raw),
    )


def intrinsics_record(message: Any) -> Intrinsics:
    """Return the intrinsics in a sensor_msgs/CameraInfo: its matrix K and distortion D."""
    k, distortion = message.k, tuple(map(float, message.d))
    model = 'plumb_bob'
    if not any(distortion):  # rectified, or a lens without distortion: the model does not matter
        distortion = ()
    else:
        model, distortion = _distortion(message.distortion_model.lower(), distortion)
    size = (int(message.width), int(message.height))
    return Intrinsics(*size, float(k[0]), float(k[4]), float(k[2]), float(k[5]), distortion, model)


def _distortion(name: str, values: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients of a record; DataError for a model that cannot be undone."""
    if name == 'modified_brown_conrady' and len(values) >= 4 and values[2] == values[3] == 0.0:
        name = 'plumb_bob'  # they differ in the tangential part alone
    model = DISTORTION_MODELS.get(name)
    if model is None:
        raise DataError(
            f'camera info: distortion model {name!r} cannot be undone, expected one of '
            f'{sorted(DISTORTION_MODELS)}; publish rectified images (image_proc) instead'
        )
    if model == 'equidistant':
        values = values[:4]  # librealsense fills up with a zero
    longest = DISTORTION_LENGTHS[model][-1]
    if any(values[longest:]):
        raise DataError(
            f'camera info: {len(values)} coefficients of {name!r} (thin prism, tilted sensor) '
            f'cannot be undone, expected at most {longest}; publish rectified images '
            '(image_proc) instead'
        )
    values = values[:longest]
    return model, values


def camera_info_message(
    factory: MessageFactory, stamp: float, frame: str, camera: Intrinsics
) -> Any:
    """Return a sensor_msgs/CameraInfo; D is five zeros for a rectified image."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    return factory.make(
        'sensor_msgs/CameraInfo',
        header=header(factory, stamp, frame),
        height=camera.height,
        width=camera.width,
        distortion_model=(
            'rational_polynomial' if len(camera.distortion) == 8 else camera.distortion_model
        ),
        d=factory.sequence(np.array(camera.distortion or [0.0] * 5)),
        k=np.array(k),
        r=np.eye(3).reshape(9),
        p=np.array(p),
        binning_x=0,
        binning_y=0,
        roi=factory.make(
            'sensor_msgs/RegionOfInterest',
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )
