"""The records that travel between packages: immutable, and checked at construction.

Stamps are seconds (float, ROS time). Vehicle frame: x forward, y left, z up (REP-103).
A malformed record raises a DataError that names the field and the value.
"""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.errors import DataError
from explore_slam.geometry import Array, Pose2, Pose3

DESCRIPTOR_LENGTH = 128  # numbers of a SIFT descriptor
UNKNOWN_HEADING = 1.0  # rad²: variance from which the heading of a tag counts as unknown


def _check_stamp(record: object, stamp: float) -> None:
    if not math.isfinite(stamp) or stamp < 0.0:
        raise DataError(
            f'{type(record).__name__}: stamp is {stamp!r}, expected finite seconds >= 0'
        )


def _check_shape(record: object, name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise DataError(
            f'{type(record).__name__}: {name} has shape {array.shape}, expected {shape}'
        )


def _check_finite(record: object, name: str, array: NDArray[Any]) -> None:
    if not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise DataError(
            f'{type(record).__name__}: {name} contains {bad} values that are not finite'
        )


# m; of the body for which planning_radius and vehicle_separation are meant. It is what the agent
# assumes of a vehicle. The bodies that collide in the simulators are declared there on their own:
# simulated_radius, 0.26 m, and disc_radius, 0.22 m, both less than planning_radius, 0.3 m.
STANDARD_RADIUS = 0.25
STANDARD_CLEARANCE = 0.02  # m beside that body, which the path follower keeps free


class VehicleBody(NamedTuple):
    """Size, speed and view of a vehicle.

    radius: of the circle around the vehicle origin that contains the body (m).
    speed: at which it follows its plans (m/s).
    side_clearance: that it keeps beside its body (m).
    sensor_range: that its laser is expected to cover (m); None: as usual in the team.
    field_of_view: of its laser, symmetric about the direction of travel (rad).
    """

    radius: float = STANDARD_RADIUS
    speed: float = 0.4
    side_clearance: float = STANDARD_CLEARANCE
    sensor_range: float | None = None
    field_of_view: float = math.pi

    @property
    def envelope(self) -> float:
        """Radius (m) of the circle that the path follower keeps free of obstacles."""
        return self.radius + self.side_clearance

    @property
    def extra_radius(self) -> float:
        """How much larger the envelope is than that of a standard body (m); negative: smaller."""
        return self.envelope - (STANDARD_RADIUS + STANDARD_CLEARANCE)

    def side_range(self, usual: float) -> float:
        """Return how far to either side of its path it sees as it drives (m).

        usual: sensor range (m) of a vehicle that states none. From 180 degrees on, a wider field
        of view adds nothing to the width of the strip that is seen.
        """
        reach = usual if self.sensor_range is None else self.sensor_range
        return reach * math.sin(0.5 * min(self.field_of_view, math.pi))


@dataclass(frozen=True)
class OdometryReading:
    """Pose of the vehicle in its odometry frame; covariance (3, 3) if the base reports one.

    number: of the message at its publisher, which counts those that are lost and begins anew when
    the publisher is restarted; None where it is unknown.
    """

    stamp: float
    pose: Pose2
    covariance: Array | None = None
    number: int | None = None

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        if not self.pose.is_finite():
            raise DataError(f'OdometryReading: pose is {tuple(self.pose)}, expected finite values')
        if self.covariance is not None:
            _check_shape(self, 'covariance', self.covariance, (3, 3))


@dataclass(frozen=True)
class ImuReading:
    """Angular velocity (rad/s) of the vehicle about x, y, z of its frame, by a gyroscope."""

    stamp: float
    angular_velocity: tuple[float, float, float]

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        if not all(map(math.isfinite, self.angular_velocity)):
            raise DataError(
                f'ImuReading: angular_velocity is {self.angular_velocity}, expected finite rad/s'
            )

    @property
    def yaw_rate(self) -> float:
        """Turn rate (rad/s) to the left."""
        return self.angular_velocity[2]


class SweepTiming(NamedTuple):
    """What is known of when a laser measures its beams, apart from its messages.

    duration: from the first beam to the last one (s); 0: all at one moment; None: not known.
    direction: forward, in the order of the ranges; backward; or auto, not known.
    stamp: which beam is measured at the stamp, by time: the first, the last, or auto, not known.
    """

    duration: float | None = None
    direction: str = 'auto'
    stamp: str = 'auto'


_UNKNOWN_TIMING = SweepTiming()


@dataclass(frozen=True)
class LaserScan:
    """One sweep: ranges (B,) m; beam i points to angle_min + i * angle_increment (rad).

    Angles are in the laser frame. REP-117: -inf is too close, NaN invalid, +inf no return; values
    outside [range_min, range_max] are no measurements.

    mount: pose of the laser in the vehicle frame; None: that of the settings.
    time_increment: s from beam to beam, and scan_time: s from scan to scan, as the laser states
    them (0: not stated, or all beams at one moment). They may be wrong: sweeps.py judges them.
    timing: what is known apart from that.
    bearings (B,) rad in the laser frame: where the beams point if not to equal steps, because the
    motion within the sweep has been undone; None: equal steps.
    sensor: which laser of the vehicle it is from; '' where there is one only. Of lasers that share
    a topic, its name and the frame, 'scan, rear_laser'.
    """

    stamp: float
    angle_min: float
    angle_increment: float
    ranges: NDArray[np.float32]
    range_min: float
    range_max: float
    mount: Pose2 | None = None
    time_increment: float = 0.0
    scan_time: float = 0.0
    timing: SweepTiming = _UNKNOWN_TIMING
    bearings: NDArray[np.float32] | None = None
    sensor: str = ''

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        if self.ranges.ndim != 1 or self.ranges.size == 0:
            raise DataError(
                f'LaserScan: ranges has shape {self.ranges.shape}, expected at least one beam'
            )
        if not (math.isfinite(self.angle_min) and math.isfinite(self.angle_increment)):
            raise DataError(
                f'LaserScan: angle_min {self.angle_min} or angle_increment '
                f'{self.angle_increment} is not finite'
            )
        if self.angle_increment == 0.0 and self.ranges.size > 1:
            raise DataError('LaserScan: angle_increment is 0')
        if not 0.0 <= self.range_min < self.range_max:
            raise DataError(
                f'LaserScan: range_min {self.range_min} and range_max {self.range_max}, '
                'expected 0 <= range_min < range_max'
            )
        if self.mount is not None and not self.mount.is_finite():
            raise DataError(f'LaserScan: mount is {tuple(self.mount)}, expected finite values')
        if self.bearings is not None:
            _check_shape(self, 'bearings', self.bearings, self.ranges.shape)
            _check_finite(self, 'bearings', self.bearings)

    @property
    def undone_sweep(self) -> float:
        """Time (s) of the sweep whose motion has been undone; 0 for a scan as it was measured.

        The stamp is that of its middle.
        """
        return 0.0 if self.bearings is None else self.time_increment * (self.ranges.size - 1)

    @property
    def angles(self) -> Array:
        """Beam angles (B,) rad in the laser frame."""
        if self.bearings is not None:
            return self.bearings.astype(np.float64)
        steps = np.arange(self.ranges.size, dtype=np.float64)
        return self.angle_min + self.angle_increment * steps


# numbers of coefficients of the models of lens distortion: plumb_bob k1, k2, p1, p2, k3 (Brown);
# rational_polynomial k1, k2, p1, p2, k3 to k6; equidistant k1 to k4 of the angle (Kannala and
# Brandt, 2006); inverse_brown_conrady the polynomial of plumb_bob, from distorted to ideal points
DISTORTION_LENGTHS = {
    'plumb_bob': (4, 5, 8),
    'rational_polynomial': (8,),
    'equidistant': (4,),
    'inverse_brown_conrady': (5,),
}


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera: image size (pixels), focal lengths and principal point (pixels).

    distortion: coefficients of the model for an unrectified image, () if it is rectified.
    distortion_model: one of DISTORTION_LENGTHS; as in sensor_msgs and librealsense.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    distortion_model: str = 'plumb_bob'

    def __post_init__(self) -> None:
        if self.distortion_model not in DISTORTION_LENGTHS:
            raise DataError(
                f'Intrinsics: distortion_model is {self.distortion_model!r}, '
                f'expected one of {list(DISTORTION_LENGTHS)}'
            )
        lengths = (0, *DISTORTION_LENGTHS[self.distortion_model])
        if len(self.distortion) not in lengths or not all(map(math.isfinite, self.distortion)):
            raise DataError(
                f'Intrinsics: distortion is {self.distortion}, expected {lengths} finite values '
                f'of the model {self.distortion_model}'
            )
        if self.width <= 0 or self.height <= 0:
            raise DataError(f'Intrinsics: image size is {self.width} x {self.height}')
        values = (self.fx, self.fy, self.cx, self.cy)
        if not all(map(math.isfinite, values)) or self.fx <= 0.0 or self.fy <= 0.0:
            raise DataError(
                f'Intrinsics: fx, fy, cx, cy are {values}, expected finite, fx, fy > 0'
            )


@dataclass(frozen=True)
class RgbdFrame:
    """Colour image (H, W, 3) RGB uint8, or (H, W) grey, with registered depth (H, W).

    Depth is uint16 in mm (0 is no data) or float32 in m (NaN or 0 is no data), REP-118.

    mount: pose of the optical frame (x right, y down, z forward) in the vehicle frame; None: that
    of the settings.
    sensor: which camera of the vehicle it is from; '' where there is one only.
    """

    stamp: float
    rgb: NDArray[np.uint8]
    depth: NDArray[np.uint16] | NDArray[np.float32]
    intrinsics: Intrinsics
    mount: Pose3 | None = None
    sensor: str = ''

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        size = (self.intrinsics.height, self.intrinsics.width)
        if self.rgb.dtype != np.uint8:
            raise DataError(f'RgbdFrame: rgb is of type {self.rgb.dtype}, expected uint8')
        if self.rgb.shape not in (size, (*size, 3)):
            raise DataError(f'RgbdFrame: rgb has shape {self.rgb.shape}, expected {(*size, 3)}')
        if self.depth.dtype not in (np.uint16, np.float32):
            raise DataError(
                f'RgbdFrame: depth is of type {self.depth.dtype}, '
                'expected uint16 (mm) or float32 (m)'
            )
        _check_shape(self, 'depth', self.depth, size)
        if self.mount is not None and not _is_finite(self.mount):
            raise DataError(f'RgbdFrame: mount is {self.mount}, expected finite values')


def _is_finite(pose: Pose3) -> bool:
    return all(map(math.isfinite, (*pose.position, *pose.quaternion)))


OBSTACLE_CELL = 0.05  # m, side of the cells of an ObstacleView; as that of the default grid
SLICE_HEIGHT = 0.1  # m, of a slice of height
HOLE_BIT = 15  # of the floor being lower; the bits below are slices of height, upwards from 0


@dataclass(frozen=True)
class ObstacleView:
    """What a depth camera sees above the floor, in cells of the vehicle frame at the stamp.

    cells (N, 2) int16: columns along x and rows along y of squares with the side OBSTACLE_CELL.
    occupied, free (N,) uint16: slices of height in which something was seen, and through which the
    camera looked, as bits; HOLE_BIT: the floor is lower there, or it was seen where it should be.
    sensor: which camera of the vehicle it is from; '' where there is one only or it is not known.
    """

    stamp: float
    cells: NDArray[np.int16]
    occupied: NDArray[np.uint16]
    free: NDArray[np.uint16]
    sensor: str = ''

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        count = len(self.cells)
        _check_shape(self, 'cells', self.cells, (count, 2))
        for name in ('occupied', 'free'):
            _check_shape(self, name, getattr(self, name), (count,))
        for name, dtype in (('cells', np.int16), ('occupied', np.uint16), ('free', np.uint16)):
            if getattr(self, name).dtype != dtype:
                raise DataError(
                    f'ObstacleView: {name} is of type {getattr(self, name).dtype}, '
                    f'expected {np.dtype(dtype)}'
                )

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def points(self) -> Array:
        """Centres (N, 2) m of the cells."""
        centers: Array = (self.cells.astype(np.float64) + 0.5) * OBSTACLE_CELL
        return centers


@dataclass(frozen=True)
class LandmarkObservations:
    """K landmarks observed at once, in the vehicle frame at the stamp.

    positions (K, 3) m, covariances (K, 3, 3) m², descriptors (K, D): SIFT (K, 128) float32 of unit
    length; other kinds as in slam.descriptors.kinds.
    delays (K,) s: from the stamp to when each was measured, as in the rows of a rolling shutter;
    its position is then that in the vehicle frame at that time. None: not known.
    """

    stamp: float
    positions: Array
    covariances: Array
    descriptors: NDArray[Any]
    delays: Array | None = None

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        count = len(self.positions)
        _check_shape(self, 'positions', self.positions, (count, 3))
        _check_shape(self, 'covariances', self.covariances, (count, 3, 3))
        if self.descriptors.ndim != 2 or len(self.descriptors) != count:
            raise DataError(
                f'LandmarkObservations: descriptors has shape {self.descriptors.shape}, '
                f'expected ({count}, length)'
            )
        for name in ('positions', 'covariances', 'descriptors'):
            _check_finite(self, name, getattr(self, name))
        if self.delays is not None:
            _check_shape(self, 'delays', self.delays, (count,))
            _check_finite(self, 'delays', self.delays)

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def empty(cls, stamp: float) -> 'LandmarkObservations':
        """Return a record without any landmark."""
        return cls(
            stamp,
            np.empty((0, 3)),
            np.empty((0, 3, 3)),
            np.empty((0, DESCRIPTOR_LENGTH), np.float32),
        )


@dataclass(frozen=True)
class TagObservations:
    """K tags seen in one image, in the vehicle frame at the stamp.

    ids (K,): numbers of the tags, each once. poses (K, 3): centre (m), and where the tag faces
    (rad). covariances (K, 3, 3): theirs. The heading of a tag that is seen from ahead is not
    known: its variance is then UNKNOWN_HEADING or more.
    """

    stamp: float
    ids: NDArray[np.int64]
    poses: Array
    covariances: Array

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        count = len(self.ids)
        _check_shape(self, 'ids', self.ids, (count,))
        _check_shape(self, 'poses', self.poses, (count, 3))
        _check_shape(self, 'covariances', self.covariances, (count, 3, 3))
        for name in ('poses', 'covariances'):
            _check_finite(self, name, getattr(self, name))
        if len(np.unique(self.ids)) < count:
            raise DataError(f'TagObservations: ids are {self.ids.tolist()}, expected each once')
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        if (variances <= 0.0).any():
            raise DataError(
                f'TagObservations: variances are {variances.tolist()}, expected more than 0'
            )

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class InterRobotObservation:
    """Position of one vehicle measured by another, in the frame of the observing vehicle.

    vehicle: name of the observed vehicle; position (2,) m; covariance (2, 2) m².
    """

    stamp: float
    vehicle: str
    position: Array
    covariance: Array

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        _check_shape(self, 'position', self.position, (2,))
        _check_shape(self, 'covariance', self.covariance, (2, 2))
        _check_finite(self, 'position', self.position)
        _check_finite(self, 'covariance', self.covariance)


@dataclass(frozen=True)
class Plan:
    """Path of one vehicle in the map frame: waypoints (W, 2) m, the last of which is the goal."""

    stamp: float
    vehicle: str
    goal: Pose2
    waypoints: Array

    def __post_init__(self) -> None:
        _check_stamp(self, self.stamp)
        _check_shape(self, 'waypoints', self.waypoints, (len(self.waypoints), 2))
        _check_finite(self, 'waypoints', self.waypoints)


class FollowerState(Enum):
    """What drives a vehicle along its plan is doing."""

    WAITING = 'waiting'
    DRIVING = 'driving'
    ARRIVED = 'arrived'
    BLOCKED = 'blocked'
    TELEOPERATED = 'teleoperated'


@dataclass(frozen=True)
class FollowerReport:
    """State of a navigator, its reason, and since when it holds (s; NaN: unknown)."""

    state: FollowerState
    reason: str = ''
    since: float = math.nan


class BatteryReading(NamedTuple):
    """What a vehicle reports of its battery; NaN where it does not measure it.

    voltage: V. share: charge as a share of the full one, 0 to 1. charging: fed by a charger.
    """

    voltage: float = math.nan
    share: float = math.nan
    charging: bool = False


class BatteryLevel(Enum):
    """How much is left in a vehicle's battery: enough, for the way home only, or nothing."""

    OK = 'ok'
    LOW = 'low'
    CRITICAL = 'critical'


class VehicleState(Enum):
    """Activity of a vehicle as known to the agent.

    UNLOCALIZED: its start pose is unknown, and its pose in the map is not known yet.
    BATTERY_CRITICAL: it has stopped because its battery is nearly empty.
    """

    WAITING = 'waiting'
    DRIVING = 'driving'
    BLOCKED = 'blocked'
    TELEOPERATED = 'teleoperated'
    BATTERY_CRITICAL = 'battery_critical'
    LOST = 'lost'
    UNLOCALIZED = 'unlocalized'
    SILENT = 'silent'
    RETURNING = 'returning'
    HOME = 'home'
    DONE = 'done'


@dataclass(frozen=True)
class VehicleStatus:
    """State of one vehicle: pose and covariance (3, 3) in the map, activity, goal.

    The pose of an unlocalized vehicle is in a frame of its own, where it started at the origin.
    """

    stamp: float
    vehicle: str
    state: VehicleState
    pose: Pose2
    covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    goal: Pose2 | None = None
