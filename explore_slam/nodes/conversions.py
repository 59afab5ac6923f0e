"""Messages to records and back, in one place; duck-typed, so that no ROS is imported here.

Reading works on any object with the field names of common_interfaces (rclpy's or rosbags').
Writing goes through a MessageFactory, which knows the classes and the sequence type to use.
"""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from explore_slam.data import (
    DESCRIPTOR_LENGTH,
    Intrinsics,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    Plan,
    RgbdFrame,
    VehicleSighting,
)
from explore_slam.errors import DataError
from explore_slam.geometry import Array, Pose2

FLOAT32, UINT8 = 7, 2
DESCRIPTOR_SCALE = 512.0
COLOR_CHANNELS = {'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4, 'mono8': 1, '8UC1': 1, '8UC3': 3}
DEPTH_TYPES: dict[str, type] = {'16UC1': np.uint16, 'mono16': np.uint16, '32FC1': np.float32}
# rows and columns of x, y and yaw in a 6 x 6 covariance (x, y, z, roll, pitch, yaw)
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
TRIANGLE = np.triu_indices(3)


class MessageFactory(Protocol):
    """Makes messages of one middleware (rclpy or rosbags)."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message of the type, e.g. 'sensor_msgs/LaserScan', with all its fields."""

    def sequence(self, values: NDArray[Any]) -> Any:
        """Return a numeric sequence as this middleware wants it."""


# -- time, poses --------------------------------------------------------------------------------


def seconds(stamp: Any) -> float:
    """Return a builtin_interfaces/Time as seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def time_message(factory: MessageFactory, stamp: float) -> Any:
    """Return seconds as a builtin_interfaces/Time, rounded to the nanosecond."""
    nanoseconds = round(stamp * 1e9)
    return factory.make(
        'builtin_interfaces/Time', sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )


def header(factory: MessageFactory, stamp: float, frame: str) -> Any:
    """Return a std_msgs/Header."""
    return factory.make('std_msgs/Header', stamp=time_message(factory, stamp), frame_id=frame)


def planar_pose(pose: Any) -> Pose2:
    """Return a geometry_msgs/Pose seen from above; the quaternion need not be of unit length."""
    q = pose.orientation
    if not all(map(math.isfinite, (q.x, q.y, q.z, q.w))) or q.x**2 + q.y**2 + q.z**2 + q.w**2 == 0:
        raise DataError(f'pose: orientation ({q.x}, {q.y}, {q.z}, {q.w}) is no rotation')
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2)
    return Pose2(float(pose.position.x), float(pose.position.y), yaw)


def pose_message(factory: MessageFactory, pose: Pose2, z: float = 0.0) -> Any:
    """Return a geometry_msgs/Pose."""
    half = 0.5 * float(pose.theta)
    return factory.make(
        'geometry_msgs/Pose',
        position=factory.make('geometry_msgs/Point', x=float(pose.x), y=float(pose.y), z=float(z)),
        orientation=factory.make(
            'geometry_msgs/Quaternion', x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
        ),
    )


def planar_covariance(values: Any) -> Array:
    """Return the (3, 3) covariance of x, y, yaw of a 36 element covariance."""
    planar: Array = np.asarray(values, dtype=np.float64).reshape(6, 6)[PLANAR]
    return planar


def covariance_message(covariance: Array | None) -> Array:
    """Return a (3, 3) covariance of x, y, yaw as 36 values; None gives zeros (unknown)."""
    full = np.zeros((6, 6))
    if covariance is not None:
        full[PLANAR] = covariance
    return full.reshape(36)


# -- odometry, scans, paths ---------------------------------------------------------------------


def odometry_record(message: Any) -> OdometryReading:
    """Return a nav_msgs/Odometry as a record; an all-zero covariance counts as none."""
    covariance = planar_covariance(message.pose.covariance)
    return OdometryReading(
        seconds(message.header.stamp),
        planar_pose(message.pose.pose),
        covariance if covariance.any() else None,
    )


def odometry_message(
    factory: MessageFactory,
    reading: OdometryReading,
    frame: str,
    child_frame: str,
    velocity: tuple[float, float] = (0.0, 0.0),
) -> Any:
    """Return a nav_msgs/Odometry; velocity is (m/s forward, rad/s)."""
    return factory.make(
        'nav_msgs/Odometry',
        header=header(factory, reading.stamp, frame),
        child_frame_id=child_frame,
        pose=factory.make(
            'geometry_msgs/PoseWithCovariance',
            pose=pose_message(factory, reading.pose),
            covariance=covariance_message(reading.covariance),
        ),
        twist=factory.make(
            'geometry_msgs/TwistWithCovariance',
            twist=twist_message(factory, *velocity),
            covariance=np.zeros(36),
        ),
    )


def twist_message(factory: MessageFactory, linear: float, angular: float) -> Any:
    """Return a geometry_msgs/Twist: m/s forward, rad/s to the left."""
    return factory.make(
        'geometry_msgs/Twist',
        linear=factory.make('geometry_msgs/Vector3', x=float(linear), y=0.0, z=0.0),
        angular=factory.make('geometry_msgs/Vector3', x=0.0, y=0.0, z=float(angular)),
    )


def scan_record(message: Any) -> LaserScan:
    """Return a sensor_msgs/LaserScan as a record."""
    return LaserScan(
        seconds(message.header.stamp),
        float(message.angle_min),
        float(message.angle_increment),
        np.array(message.ranges, dtype=np.float32),
        float(message.range_min),
        float(message.range_max),
    )


def scan_message(
    factory: MessageFactory, scan: LaserScan, frame: str, scan_time: float = 0.0
) -> Any:
    """Return a sensor_msgs/LaserScan (REP-117 values are kept as they are)."""
    count = scan.ranges.size
    return factory.make(
        'sensor_msgs/LaserScan',
        header=header(factory, scan.stamp, frame),
        angle_min=float(scan.angle_min),
        angle_max=float(scan.angle_min + scan.angle_increment * (count - 1)),
        angle_increment=float(scan.angle_increment),
        time_increment=0.0,
        scan_time=float(scan_time),
        range_min=float(scan.range_min),
        range_max=float(scan.range_max),
        ranges=factory.sequence(scan.ranges.astype(np.float32, copy=False)),
        intensities=factory.sequence(np.empty(0, np.float32)),
    )


def plan_record(message: Any, vehicle: str) -> Plan:
    """Return a nav_msgs/Path as the plan of a vehicle; an empty path means stop."""
    poses = [planar_pose(stamped.pose) for stamped in message.poses]
    points = np.array([[pose.x, pose.y] for pose in poses], dtype=np.float64).reshape(-1, 2)
    goal = poses[-1] if poses else Pose2(math.nan, math.nan, 0.0)
    return Plan(seconds(message.header.stamp), vehicle, goal, points)


def path_message(factory: MessageFactory, stamp: float, frame: str, poses: Array) -> Any:
    """Return a nav_msgs/Path along poses (W, 2) or (W, 3); headings are made where absent."""
    points = np.asarray(poses, dtype=np.float64)
    if points.shape[-1] == 2:
        steps = np.diff(points, axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        last = headings[-1:] if len(headings) else np.zeros(min(1, len(points)))
        points = np.column_stack([points, np.concatenate([headings, last])])
    top = header(factory, stamp, frame)
    stamped = [
        factory.make(
            'geometry_msgs/PoseStamped', header=top, pose=pose_message(factory, Pose2(*row))
        )
        for row in points.tolist()
    ]
    return factory.make('nav_msgs/Path', header=top, poses=stamped)


def estimate_message(
    factory: MessageFactory, stamp: float, frame: str, pose: Pose2, covariance: Array
) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped."""
    return factory.make(
        'geometry_msgs/PoseWithCovarianceStamped',
        header=header(factory, stamp, frame),
        pose=factory.make(
            'geometry_msgs/PoseWithCovariance',
            pose=pose_message(factory, pose),
            covariance=covariance_message(covariance),
        ),
    )


def pose_array_message(factory: MessageFactory, stamp: float, frame: str, poses: Array) -> Any:
    """Return a geometry_msgs/PoseArray of poses (M, 3)."""
    return factory.make(
        'geometry_msgs/PoseArray',
        header=header(factory, stamp, frame),
        poses=[pose_message(factory, Pose2(*row)) for row in np.asarray(poses).tolist()],
    )


# -- images -------------------------------------------------------------------------------------


def _image_rows(message: Any, item: int, channels: int) -> NDArray[np.uint8]:
    """Return the bytes of an image as (height, width * channels * item), padding cut off."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * item
    data = np.frombuffer(message.data, np.uint8)
    if step < row or data.size < step * height or height == 0 or width == 0:
        raise DataError(
            f'image {width} x {height} {message.encoding}: step {step} and {data.size} bytes, '
            f'expected a step of at least {row} and step x height bytes'
        )
    return data[: step * height].reshape(height, step)[:, :row]


def color_array(message: Any) -> NDArray[np.uint8]:
    """Return a sensor_msgs/Image as RGB (H, W, 3) or grey (H, W)."""
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
    """Return a depth sensor_msgs/Image (REP-118) as uint16 mm or float32 m."""
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
    """Return a sensor_msgs/CameraInfo as intrinsics (its matrix K)."""
    k = message.k
    return Intrinsics(
        int(message.width), int(message.height), float(k[0]), float(k[4]), float(k[2]), float(k[5])
    )


def camera_info_message(
    factory: MessageFactory, stamp: float, frame: str, camera: Intrinsics
) -> Any:
    """Return a sensor_msgs/CameraInfo without distortion."""
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    return factory.make(
        'sensor_msgs/CameraInfo',
        header=header(factory, stamp, frame),
        height=camera.height,
        width=camera.width,
        distortion_model='plumb_bob',
        d=factory.sequence(np.zeros(5)),
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


def frame_record(color: Any, depth: Any, camera_info: Any) -> RgbdFrame:
    """Return an RGB-D frame of two images and the camera's description."""
    return RgbdFrame(
        seconds(color.header.stamp),
        color_array(color),
        depth_array(depth),
        intrinsics_record(camera_info),
    )


# -- landmarks, sightings -----------------------------------------------------------------------


def cloud_message(
    factory: MessageFactory,
    stamp: float,
    frame: str,
    columns: list[tuple[str, NDArray[Any]]],
) -> Any:
    """Return a sensor_msgs/PointCloud2 of named columns (N,) or (N, C), float32 or uint8."""
    count = len(columns[0][1])
    fields, parts, offset = [], [], 0
    for name, values in columns:
        width = int(np.prod(np.shape(values)[1:]))
        block = np.ascontiguousarray(values).reshape(count, width)
        kind = UINT8 if block.dtype == np.uint8 else FLOAT32
        if kind == FLOAT32:
            block = block.astype('<f4')
        fields.append(
            factory.make(
                'sensor_msgs/PointField',
                name=name,
                offset=offset,
                datatype=kind,
                count=block.shape[1],
            )
        )
        parts.append(block.view(np.uint8).reshape(count, block.itemsize * block.shape[1]))
        offset += block.itemsize * block.shape[1]
    data = np.concatenate(parts, axis=1) if count else np.empty(0, np.uint8)
    return factory.make(
        'sensor_msgs/PointCloud2',
        header=header(factory, stamp, frame),
        height=1,
        width=count,
        fields=fields,
        is_bigendian=False,
        point_step=offset,
        row_step=offset * count,
        data=factory.sequence(data.reshape(-1)),
        is_dense=True,
    )


def cloud_columns(message: Any) -> dict[str, NDArray[Any]]:
    """Return the float32 and uint8 fields of a PointCloud2, each as (N, count)."""
    count, step = int(message.width) * int(message.height), int(message.point_step)
    data = np.frombuffer(message.data, np.uint8)
    if data.size < count * step:
        raise DataError(f'point cloud: {data.size} bytes, expected {count} points of {step} bytes')
    rows = data[: count * step].reshape(count, step)
    order = '>' if message.is_bigendian else '<'
    columns: dict[str, NDArray[Any]] = {}
    for item in message.fields:
        dtype = {FLOAT32: np.dtype(order + 'f4'), UINT8: np.dtype('u1')}.get(int(item.datatype))
        if dtype is None:
            continue
        size = dtype.itemsize * int(item.count)
        block = np.ascontiguousarray(rows[:, item.offset : item.offset + size])
        if block.shape[1] != size:
            raise DataError(f'point cloud: field {item.name!r} lies outside of the point step')
        columns[item.name] = block.view(dtype).reshape(count, int(item.count))
    return columns


def landmarks_message(
    factory: MessageFactory, observations: LandmarkObservations, frame: str, compact: bool = False
) -> Any:
    """Return observations as a PointCloud2; compact sends descriptors as 128 bytes."""
    descriptors: NDArray[Any] = observations.descriptors
    if compact:
        scaled = np.rint(descriptors * DESCRIPTOR_SCALE)
        descriptors = np.clip(scaled, 0, 255).astype(np.uint8)
    rows, columns = TRIANGLE
    axes = [(name, observations.positions[:, axis]) for axis, name in enumerate('xyz')]
    covariance = ('covariance', observations.covariances[:, rows, columns])
    return cloud_message(
        factory, observations.stamp, frame, [*axes, covariance, ('descriptor', descriptors)]
    )


def landmarks_record(message: Any) -> LandmarkObservations:
    """Return a PointCloud2 with x, y, z, covariance (6), descriptor (128) as observations."""
    columns = cloud_columns(message)
    wanted = {'x': 1, 'y': 1, 'z': 1, 'covariance': 6, 'descriptor': DESCRIPTOR_LENGTH}
    for name, length in wanted.items():
        found = columns[name].shape[1] if name in columns else 0
        if found != length:
            raise DataError(f'landmarks: field {name!r} has {found} values, expected {length}')
    count = len(columns['x'])
    covariances = np.zeros((count, 3, 3))
    rows, cols = TRIANGLE
    covariances[:, rows, cols] = columns['covariance']
    covariances[:, cols, rows] = columns['covariance']
    descriptors = columns['descriptor'].astype(np.float32)
    norms = np.linalg.norm(descriptors, axis=1, keepdims=True)
    if (norms == 0).any():
        raise DataError('landmarks: a descriptor is all zero, expected unit length')
    positions = np.concatenate([columns[axis] for axis in 'xyz'], axis=1).astype(np.float64)
    return LandmarkObservations(
        seconds(message.header.stamp), positions, covariances, descriptors / norms
    )


def sighting_record(message: Any) -> VehicleSighting:
    """Return a PoseWithCovarianceStamped whose frame names the vehicle seen, '<seen>/base_link'.

    The pose is that of the seen vehicle in the frame of the vehicle that sees (its namespace).
    """
    position = message.pose.pose.position
    covariance = np.asarray(message.pose.covariance, dtype=np.float64).reshape(6, 6)[:2, :2]
    return VehicleSighting(
        seconds(message.header.stamp),
        message.header.frame_id.split('/')[0],
        np.array([position.x, position.y], dtype=np.float64),
        covariance.copy(),
    )


def sighting_message(factory: MessageFactory, sighting: VehicleSighting) -> Any:
    """Return a sighting as a PoseWithCovarianceStamped; see sighting_record."""
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = sighting.covariance
    pose = Pose2(float(sighting.position[0]), float(sighting.position[1]), 0.0)
    frame = f'{sighting.vehicle}/base_link'
    return estimate_message(factory, sighting.stamp, frame, pose, covariance)
