"""Depth image -> the scan that a laser would measure: for vehicles without one.

Every beam takes the nearest readings in a band of heights above the floor. It ends at their mean;
where there are none, it has no return if the floor is seen beyond the range, and otherwise it is
no measurement.
"""

import math

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import LaserScan
from explore_slam.geometry import Pose2
from explore_slam.vision.level_rays import Band, Rays

_STEP = math.radians(0.5)  # between beams, as of an LMS-200; five columns of a Kinect's image
RANGE_MIN = 0.3  # m; nearer than any depth camera measures
_BIN = 0.05  # m, of ranges, in which the nearest readings are searched
_LEAST = 4  # readings in two neighbouring bins: single ones may be wrong
_WIDTH = 3.0  # standard deviations of noise on either side of a wall
_FLOOR_SHARE = 0.9  # of the range, up to which the floor must be seen for no return


def camera_scan(
    stamp: float,
    rays: Rays,
    depth: NDArray[np.float32],
    tilt: tuple[float, float],
    height: float,
    band: Band,
    reach: float,
    mount: Pose2,
    sensor: str = '',
) -> LaserScan:
    """Return the scan in a depth image (W, H) m.

    tilt: slopes of the floor; height (m): of the camera above it. band: heights that count.
    reach (m): longest range. mount: of the camera, which looks along its x axis. sensor: its name.
    """
    half = math.atan(float(np.abs(rays.tangent[rays.ahead > 0.0]).max(initial=0.0)))
    beams = 2 * math.ceil(half / _STEP) + 1
    first = -(beams // 2) * _STEP
    ranges = _ranges(rays, depth, tilt, height, band, reach, beams, first)
    return LaserScan(stamp, first, _STEP, ranges, RANGE_MIN, reach, mount, sensor=sensor)


@kernel
def _ranges(
    rays: Rays,
    depth: NDArray[np.float32],
    tilt: tuple[float, float],
    height: float,
    band: Band,
    reach: float,
    beams: int,
    first: float,
) -> NDArray[np.float32]:
    """Return the ranges (B,) m; +inf: no return, NaN: no measurement."""
    counts = np.zeros((beams, int(reach / _BIN) + 2), np.int32)
    seen = np.zeros(beams)  # how far the floor is seen
    measured = np.full(depth.shape, -1.0, np.float32)
    beam_of = np.zeros(depth.shape, np.int32)
    for column in range(depth.shape[0]):
        for row in range(depth.shape[1]):
            forward = float(depth[column, row]) * float(rays.ahead[column, row])
            tangent = float(rays.tangent[column, row])
            slope = float(rays.slope[column, row]) - tilt[0] - tilt[1] * tangent
            z = height + forward * slope
            if forward <= 0.0 or z >= band.highest:
                continue
            beam = int((math.atan(tangent) - first) / _STEP + 0.5)
            beam = min(max(beam, 0), beams - 1)
            far = forward * math.sqrt(1.0 + tangent * tangent)
            if z < band.lowest or far >= reach:
                seen[beam] = max(seen[beam], far)
                continue
            beam_of[column, row], measured[column, row] = beam, far
            counts[beam, int(far / _BIN)] += 1
    ranges = _means(_nearest(counts), beam_of, measured, band.noise)
    for beam in range(beams):
        if math.isnan(ranges[beam]) and seen[beam] > _FLOOR_SHARE * reach:
            ranges[beam] = np.inf
    return ranges


@kernel
def _nearest(counts: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return where the nearest readings of each beam begin (B,) m; inf: there are none."""
    nearest = np.full(counts.shape[0], np.inf)
    for beam in range(counts.shape[0]):
        for place in range(counts.shape[1] - 1):
            if counts[beam, place] + counts[beam, place + 1] >= _LEAST:
                nearest[beam] = (place if counts[beam, place] > 0 else place + 1) * _BIN
                break
    return nearest


@kernel
def _means(
    nearest: NDArray[np.float64],
    beam_of: NDArray[np.int32],
    measured: NDArray[np.float32],
    noise: float,
) -> NDArray[np.float32]:
    """Return the mean (B,) m of the nearest readings of each beam; NaN: there are none.

    beam_of, measured (W, H): beam and distance (m) of each reading, negative where there is none.
    """
    sums, numbers = np.zeros(nearest.size), np.zeros(nearest.size)
    for column in range(measured.shape[0]):
        for row in range(measured.shape[1]):
            far, beam = float(measured[column, row]), beam_of[column, row]
            off = far - nearest[beam]
            if far > 0.0 and 0.0 <= off < _BIN + 2.0 * _WIDTH * noise * far * far:
                sums[beam] += far
                numbers[beam] += 1.0
    means = np.full(nearest.size, np.nan, np.float32)
    for beam in range(nearest.size):
        if numbers[beam] > 0.0:
            means[beam] = sums[beam] / numbers[beam]
    return means
