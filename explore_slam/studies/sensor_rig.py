"""A vehicle with lasers as people have them, on a floor of three rooms with exact walls.

The vehicle turns on the spot and drives straight. Its wheel odometry turns too far. A laser
measures its beams one after the other while the vehicle moves, or all at one moment; it looks all
around, or there are two that look ahead and back.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from explore_slam.data import ImuReading, LaserScan, OdometryReading, SweepTiming
from explore_slam.geometry import IDENTITY, Array, Pose2, wrap_angle
from explore_slam.simulation.worlds.walls import box, distances_along, line

SPEED = 0.4  # m/s
ACCELERATION, TURN_ACCELERATION = 0.5, 2.0  # m/s², rad/s²
ODOMETRY_RATE = 20.0  # Hz
TRUTH_RATE = 200.0  # Hz; in between, poses are interpolated
BEAMS, RANGE = 360, 12.0  # number, m: an RPLIDAR A1 or an LDS-01
RANGE_DEVIATION = 0.01  # m
LASER = Pose2(0.1, 0.0, 0.0)  # on the vehicle
# Noise of wheel odometry beside the error of its turns: deviations (m, m, rad) of a reading.
WHEEL_DEVIATIONS = np.array([3e-4, 1e-4, 5e-4])
REST = 1.0  # s at the start pose
# A MEMS gyroscope as in small robots (MPU-6050, specification PS-MPU-6000A-00, section 6.1): noise
# of 0.05 °/s RMS, ten times as much on a vehicle that shakes; scale right to 3 % (two deviations);
# a bias of several °/s, which drifts by 0.8 °/s in ten minutes.
IMU_RATE = 100.0  # Hz
RATE_DEVIATION = 0.009  # rad/s
SCALE_DEVIATION = 0.015
BIAS_DEVIATION = 0.05  # rad/s
BIAS_WALK = 6e-4  # rad/s/√s

# 14 m x 9 m: a room in the west, two in the east, furniture
FLOOR = np.concatenate(
    [
        box(0.0, 0.0, 14.0, 9.0),
        line((5.0, 0.0), (5.0, 2.0)),
        line((5.0, 3.2), (5.0, 9.0)),
        line((5.0, 4.5), (9.0, 4.5)),
        line((10.2, 4.5), (14.0, 4.5)),
        box(0.6, 7.4, 1.2, 0.8),
        box(3.6, 5.6, 0.6, 1.0),
        box(7.2, 0.4, 1.0, 0.6),
        box(12.4, 2.6, 0.8, 1.2),
        box(6.0, 7.6, 1.6, 0.5),
        box(12.6, 6.4, 0.5, 1.4),
    ]
)
START = Pose2(2.0, 2.6, 0.0)
# Points (x m, y m) to drive to in a straight line, and turns on the spot (rad).
TOUR: tuple[tuple[float, float] | float, ...] = (
    2.0 * math.pi, (2.2, 6.2), (2.6, 2.6), (6.4, 2.6), -2.0 * math.pi, (9.6, 2.4), (9.6, 6.6),
    -math.pi, (7.0, 6.2), (11.4, 6.4), 2.0 * math.pi, (9.6, 6.0), (9.6, 3.0), (11.6, 1.4),
)  # fmt: skip


@dataclass(frozen=True)
class Laser:
    """How the laser of a case works.

    rate: Hz. spinning: its beams are measured one after the other over the time between scans.
    backward: against the order of the message. last: stamped at the last beam by time.
    stated: the messages hold the true time_increment, and the settings direction and stamp;
    otherwise nothing is known of them. wrong_increment: what the messages state instead (s from
    beam to beam).
    name: of its topic, below the vehicle's namespace; '' for the only one. mount: its pose on the
    vehicle. half: it looks ahead only, over 180°, from its right to its left.
    """

    rate: float = 5.5
    spinning: bool = True
    backward: bool = False
    last: bool = False
    stated: bool = True
    name: str = ''
    mount: Pose2 = LASER
    half: bool = False
    wrong_increment: float | None = None

    @property
    def angles(self) -> Array:
        """Bearings of the beams in the laser frame (B,) rad."""
        step = 2.0 * math.pi / BEAMS
        count = BEAMS // 2 + 1 if self.half else BEAMS
        first = -0.5 * math.pi if self.half else -math.pi
        angles: Array = first + step * np.arange(count, dtype=np.float64)
        return angles

    @property
    def time_increment(self) -> float:
        """Time from beam to beam (s)."""
        return 1.0 / (self.rate * BEAMS) if self.spinning else 0.0

    @property
    def stated_increment(self) -> float:
        """The time_increment of the messages (s)."""
        if self.wrong_increment is not None:
            return self.wrong_increment
        return self.time_increment if self.stated else 0.0

    @property
    def shares(self) -> Array:
        """When the beams of a message are measured (B,), in s after the first one by time."""
        order = np.arange(len(self.angles), dtype=np.float64)
        shares: Array = self.time_increment * (order[::-1] if self.backward else order)
        return shares

    @property
    def timing(self) -> SweepTiming:
        """What the settings say."""
        if not self.stated:
            return SweepTiming()
        direction = 'backward' if self.backward else 'forward'
        return SweepTiming(None, direction, 'last' if self.last else 'first')


class Drive:
    """True poses along the tour.

    stamps (N,) s and poses (N, 3); heading is continuous.
    """

    def __init__(self, turn_rate: float) -> None:
        step = 1.0 / TRUTH_RATE
        x, y, heading = START
        rows = [(x, y, heading)] * round(REST / step)
        for item in TOUR:
            wanted = item
            if not isinstance(wanted, float):
                ahead = math.atan2(wanted[1] - y, wanted[0] - x)
                wanted = wrap_angle(ahead - heading)
            for share in _travelled(abs(wanted), turn_rate, TURN_ACCELERATION, step):
                rows.append((x, y, heading + math.copysign(share, wanted)))
            heading += wanted
            if not isinstance(item, float):
                distance = math.dist(item, (x, y))
                c, s = math.cos(heading), math.sin(heading)
                for share in _travelled(distance, SPEED, ACCELERATION, step):
                    rows.append((x + c * share, y + s * share, heading))
                x, y = item
        self.poses = np.array(rows)
        self.stamps = step * np.arange(len(rows))

    @property
    def duration(self) -> float:
        """Length of the drive (s)."""
        return float(self.stamps[-1])

    def at(self, stamps: Array) -> Array:
        """Return the poses (T, 3) at stamps (T,) s; the heading is continuous."""
        columns = [np.interp(stamps, self.stamps, column) for column in self.poses.T]
        return np.stack(columns, axis=1)


def _travelled(length: float, speed: float, acceleration: float, step: float) -> Iterator[float]:
    """Yield how far a motion from rest to rest has come after each time step (s)."""
    done, v = 0.0, 0.0
    while done < length - 1e-9:
        # the speed from which the rest of the way suffices to stop
        allowed = math.sqrt(2.0 * acceleration * (length - done))
        v = min(v + acceleration * step, speed, max(allowed, acceleration * step))
        done = min(done + v * step, length)
        yield done


def odometry(
    drive: Drive, turn_factor: float, random: np.random.Generator, distance_factor: float = 1.0
) -> list[OdometryReading]:
    """Return what the wheels measure: turns and distances are so many times those in truth."""
    stamps = np.arange(0.0, drive.duration, 1.0 / ODOMETRY_RATE)
    true = [Pose2.from_array(pose) for pose in drive.at(stamps)]
    reading, readings = IDENTITY, [OdometryReading(float(stamps[0]), IDENTITY)]
    for stamp, (before, after) in zip(stamps[1:], itertools.pairwise(true), strict=True):
        step = np.asarray(before.between(after))
        moves = bool(np.abs(step).max() > 1e-9)
        step *= (distance_factor, distance_factor, turn_factor)
        if moves and step.any():
            step += WHEEL_DEVIATIONS * random.standard_normal(3)
        reading = reading.compose(Pose2.from_array(step))
        readings.append(OdometryReading(float(stamp), reading))
    return readings


def gyroscope(drive: Drive, random: np.random.Generator) -> list[ImuReading]:
    """Return what an IMU measures that is mounted level: the turn rate with bias, scale and noise.

    The bias begins at random and drifts like a random walk.
    """
    period = 1.0 / IMU_RATE
    stamps = np.arange(0.0, drive.duration, period)
    # the sensor averages over its period
    headings = drive.at(np.append(stamps - period, stamps[-1]).clip(0.0))[:, 2]
    rates = np.diff(headings) / period
    walk = BIAS_WALK * math.sqrt(period) * random.standard_normal(len(stamps)).cumsum()
    bias = BIAS_DEVIATION * random.standard_normal() + walk
    scale = 1.0 + SCALE_DEVIATION * random.standard_normal()
    noise = RATE_DEVIATION * random.standard_normal((len(stamps), 3))
    measured = scale * rates + bias + noise[:, 2]
    rows = zip(stamps.tolist(), noise.tolist(), measured.tolist(), strict=True)
    return [ImuReading(stamp, (tilt[0], tilt[1], rate)) for stamp, tilt, rate in rows]


def scans(drive: Drive, laser: Laser, random: np.random.Generator) -> list[LaserScan]:
    """Return the scans of a drive; the phase of the laser is random."""
    angles, mount = laser.angles, laser.mount
    found = []
    sweep = 1.0 / laser.rate
    for begin in np.arange(random.uniform(0.0, sweep), drive.duration - sweep, sweep):
        poses = drive.at(begin + laser.shares)
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        origins = poses[:, :2] + np.stack(
            [c * mount.x - s * mount.y, s * mount.x + c * mount.y], axis=1
        )
        ranges = distances_along(FLOOR, origins, poses[:, 2] + mount.theta + angles)
        ranges = ranges + RANGE_DEVIATION * random.standard_normal(len(angles))
        ranges[ranges > RANGE] = np.inf
        stamp = begin + (laser.shares.max() if laser.last else 0.0)
        found.append(
            LaserScan(
                float(stamp), float(angles[0]), float(angles[1] - angles[0]),
                ranges.astype(np.float32), 0.1, RANGE, mount,
                time_increment=laser.stated_increment,
                scan_time=sweep,
                timing=laser.timing,
                sensor=laser.name,
            )
        )  # fmt: skip
    return found


def in_order_of_arrival(
    readings: Sequence[OdometryReading | ImuReading],
    sweeps: Iterable[Sequence[LaserScan]],
    lasers: Iterable[Laser],
) -> list[OdometryReading | ImuReading | LaserScan]:
    """Return all records as they arrive: a scan when its last beam has been measured.

    sweeps: the scans of each laser.
    """
    arrivals = [(reading.stamp, 0, reading) for reading in readings]
    records: list[tuple[float, int, OdometryReading | ImuReading | LaserScan]] = list(arrivals)
    for scans_of_one, laser in zip(sweeps, lasers, strict=True):
        late = 0.0 if laser.last else float(laser.shares.max())
        records += [(scan.stamp + late, 1, scan) for scan in scans_of_one]
    records.sort(key=lambda item: item[:2])
    return [record for _, _, record in records]
