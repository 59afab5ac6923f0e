"""Depth image -> what lies in the height band of a vehicle: cells that are occupied, and free.

A laser near the floor sees neither table tops nor shelves nor steps down. A depth image is sorted
into cells of the floor and slices of height:

1. The rays of the image are levelled by the floor that the camera sees (FloorEstimate), so that a
   mount that is off by a few degrees does not turn the far floor into obstacles.
2. A reading within the band occupies its cell in its slice of height; between successive readings
   of a horizontal surface, which is seen at a grazing angle, the cells in between as well.
3. A ray frees the cells and slices that it passes before its reading: a ray below a table frees
   the space there, not the top.
4. A ray that ends below the floor has passed through a hole where it should have met the floor:
   a step down begins there. Readings of the floor say that there is none.
"""

import logging
import math
import weakref
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from explore_slam.compiled import kernel
from explore_slam.data import (
    HOLE_BIT,
    OBSTACLE_CELL,
    SLICE_HEIGHT,
    Intrinsics,
    LaserScan,
    ObstacleView,
    RgbdFrame,
)
from explore_slam.geometry import Pose2
from explore_slam.vision.camera_mount import CameraMount
from explore_slam.vision.camera_scan import camera_scan
from explore_slam.vision.config import VisionConfig
from explore_slam.vision.depth import depth_in_metres
from explore_slam.vision.floor import MISFITS, Floor, FloorEstimate
from explore_slam.vision.level_rays import WIDEST, Band, Rays, level_rays
from explore_slam.vision.sections import ObstacleConfig

logger = logging.getLogger(__name__)

_SAMPLES = 320  # columns of the image that are used: a cell at 3 m is 0.05 m or 5 of them wide
_ROW = 0.5 * OBSTACLE_CELL  # m, depth of a cell of the view; half, so that none is left out
_LEAST_READINGS = 2  # in a cell and slice: a single one may be wrong
# A cell beside a wall counts if it holds this share of the readings of the wall: noise spreads
# those over several cells. The cells beside are those within _BESIDE rows.
_LEAST_SHARE, _BESIDE = 0.15, 3
_FILLED = 4  # readings that a cell between two of a horizontal surface counts for
_LONGEST_GAP = 0.3  # m between successive readings of one surface
_LEVEL, _ROUGH = 0.1, 0.005  # slope and m, up to which a surface counts as horizontal
_NOTHING, _OBSTACLE, _FLOOR, _HOLE = 0, 1, 2, 3  # what a reading shows
_OUTLIER = 2.5  # standard deviations of noise that two readings of a wall are not apart
_MARGIN = 0.05  # m before a reading that its ray does not free
_FLAT = 1e-6  # slope of a ray that stays in its slice
_FREE_EVERY = 2  # rows of samples of which the rays free space: neighbours pass the same cells
_SLOPE = 0.01  # rad by which a levelled view may still be tilted: the floor rises with distance
# Samples that a bin of bearings is wide at least, and the tangent that it is wide at most: 0.3 for
# the coarsest depth sensors (8 x 8 zones over 45 degrees)
_APART, _COARSEST = 2.5, 0.5
_REMEMBERED = 4  # frames of a camera: between its scans and its view, a frame waits for odometry
# frames in a row without a reading, which are reported: 1 s at 30 Hz, 3 s at 10 Hz; a vehicle that
# turns before a wall nearer than the camera measures is blind for a moment
_BLIND = 30


class _View(NamedTuple):
    """Cells of a view: tangents of the bearing from the camera axis, and rows of distance.

    first: number of the first bin of tangents; step: of tangents; bins, rows, slices: numbers.
    """

    first: int
    step: float
    bins: int
    rows: int
    slices: int


class _Reading(NamedTuple):
    """What a reading shows; place: how far ahead (m) it counts; z: its height (m)."""

    kind: int
    place: float
    z: float


class _Look(NamedTuple):
    """A frame: pose of the camera on the floor, its rays and their bins, depth (W, H) m, floor.

    height (m): of the camera above the floor that it sees.
    """

    pose: Pose2
    rays: Rays
    view: _View
    bins: NDArray[np.int32]
    depth: NDArray[np.float32]
    floor: Floor
    height: float


class _Camera:
    """What is kept of a camera: its floor, its rays, its last frames, and what was warned of."""

    def __init__(self) -> None:
        self.estimate = FloorEstimate()
        self.geometry: tuple[object, Rays, _View, NDArray[np.int32]] | None = None
        self.looks: deque[tuple[weakref.ref[RgbdFrame], _Look]] = deque(maxlen=_REMEMBERED)
        self.blind = 0  # frames in a row without a reading
        self.warned: set[str] = set()


class ObstacleDetector:
    """Finds obstacles in the depth images of the cameras of one vehicle.

    mount: of the camera, for frames without one; by default that of the settings.
    vehicle: its name in messages.
    """

    def __init__(
        self,
        config: VisionConfig | None = None,
        mount: CameraMount | None = None,
        vehicle: str = 'the vehicle',
    ) -> None:
        self.config = config or VisionConfig()
        self._mount = mount or CameraMount.from_config(self.config.mount)
        self._vehicle = vehicle
        self._cameras: dict[str, _Camera] = {}

    def floor(self, camera: str = '') -> Floor:
        """Return the floor as a camera sees it, relative to where its mount has it."""
        return self._cameras[camera].estimate.floor if camera in self._cameras else Floor()

    def detect(self, frame: RgbdFrame) -> ObstacleView:
        """Return the obstacles and the free space in a frame, in the vehicle frame."""
        seen, band = self._look(frame), self.config.obstacles
        occupied, free = _sort(
            seen.rays,
            seen.bins,
            seen.depth,
            (seen.floor.along, seen.floor.across),
            seen.height,
            seen.view,
            Band(
                band.obstacle_lowest,
                band.obstacle_highest,
                band.step_depth,
                self.config.depth.depth_noise,
            ),
        )
        x, y, heading = seen.pose
        cells, hits, passes = _to_vehicle(occupied, free, seen.view, x, y, heading)
        return ObstacleView(frame.stamp, cells, hits, passes, frame.sensor)

    def scan(self, frame: RgbdFrame) -> LaserScan:
        """Return what a laser in the place of the camera would measure, for a vehicle without.

        It ends at the nearest obstacle of any height that a vehicle would meet.
        """
        seen, band = self._look(frame), self.config.obstacles
        return camera_scan(
            frame.stamp,
            seen.rays,
            seen.depth,
            (seen.floor.along, seen.floor.across),
            seen.height,
            Band(
                band.camera_scan_lowest,
                band.camera_scan_highest,
                band.step_depth,
                self.config.depth.depth_noise,
            ),
            band.obstacle_range,
            seen.pose,
            frame.sensor,
        )

    def _look(self, frame: RgbdFrame) -> _Look:
        """Return a frame as the kernels take it, and let it improve the estimate of the floor.

        This is done once for a frame: its scans and its view show it with the same floor.
        """
        if frame.sensor not in self._cameras:
            self._cameras[frame.sensor] = _Camera()
        camera = self._cameras[frame.sensor]
        for known, seen in camera.looks:
            if known() is frame:
                return seen
        mount = self._mount if frame.mount is None else CameraMount.from_optical(frame.mount)
        stride = max(1, round(frame.intrinsics.width / _SAMPLES))
        axis = mount.rotation[:, 2]
        pose = Pose2(float(mount.x), float(mount.y), math.atan2(axis[1], axis[0]))
        rays, view, bins = self._geometry(camera, frame, stride, mount, pose.theta)
        depth = np.ascontiguousarray(depth_in_metres(frame.depth[::stride, ::stride].T))
        self._check_readings(camera, frame.sensor, depth)
        if mount.z > 0.0:
            reach = self.config.obstacles.obstacle_range
            camera.estimate.add(*rays, depth, mount.z, reach)
            self._check_mount(frame.sensor, camera.estimate)
        floor = camera.estimate.floor
        height = mount.z - floor.height
        if not height > 0.0:  # NaN as well
            self._warn_of_height(camera, frame.sensor, mount.z, floor)
            depth = np.zeros_like(depth)  # shows nothing
        seen = _Look(pose, rays, view, bins, depth, floor, float(height))
        camera.looks.append((weakref.ref(frame), seen))
        return seen

    def _geometry(
        self, camera: _Camera, frame: RgbdFrame, stride: int, mount: CameraMount, heading: float
    ) -> tuple[Rays, _View, NDArray[np.int32]]:
        """Return the rays of every stride-th pixel, the cells of the view, and the bins of rays.

        heading (rad): of the camera in the vehicle frame.
        """
        intrinsics, band = frame.intrinsics, self.config.obstacles
        key = (intrinsics, stride, mount)
        if camera.geometry is None or camera.geometry[0] != key:
            apart = _APART * stride / intrinsics.fx
            rays = level_rays(intrinsics, stride, mount.rotation, heading)
            right = intrinsics.width - 1 - intrinsics.cx
            widest = max(abs(intrinsics.cx), abs(right)) / intrinsics.fx
            if widest > WIDEST or apart > _COARSEST:
                self._warn_of_width(camera, frame, widest, apart)
            if apart > _COARSEST:
                rays = rays._replace(ahead=np.zeros_like(rays.ahead))
            view, bins = _view_of(rays, min(apart, _COARSEST), band)
            camera.geometry = key, rays, view, bins
        return camera.geometry[1:]

    def _check_readings(self, camera: _Camera, name: str, depth: NDArray[np.float32]) -> None:
        """Warn of a camera that has had no reading for long; again when it has had some since."""
        if depth.max(initial=0.0) > 0.0:
            camera.blind = 0
            return
        camera.blind += 1
        if camera.blind == _BLIND:
            logger.warning(
                '%s: %s: no pixel of the last %d depth images has a reading (all are 0 or NaN): '
                'it shows neither obstacles nor free space; check its depth topic, and that its '
                'view is not covered',
                self._vehicle,
                name or 'the camera',
                camera.blind,
            )

    def _warn_of_height(self, camera: _Camera, name: str, z: float, floor: Floor) -> None:
        """Warn, once, of a camera at or below the floor."""
        if 'height' in camera.warned:
            return
        camera.warned.add('height')
        logger.warning(
            '%s: %s is mounted at z = %.3f m, but the floor is at %.3f m: its depth images are '
            'not used for obstacles and scans, which need a camera above the floor; check '
            'camera_z or its transform, and that the base frame is on the floor',
            self._vehicle,
            name or 'the camera',
            z,
            floor.height,
        )

    def _warn_of_width(
        self, camera: _Camera, frame: RgbdFrame, widest: float, apart: float
    ) -> None:
        """Warn, once, of intrinsics that are those of no depth camera.

        widest: tangent of the bearing at the edge of the image; apart: that a bin is wide.
        """
        if 'width' in camera.warned:
            return
        camera.warned.add('width')
        intrinsics, limit = frame.intrinsics, math.degrees(math.atan(WIDEST))
        used = f'what is within {limit:.0f} degrees'
        if apart > _COARSEST:
            used = f'none of them (fx is below {intrinsics.fx * apart / _COARSEST:.2g})'
        logger.warning(
            '%s: %s: with fx = %g and cx = %g, images of %d columns reach %.1f degrees to the '
            'side, expected at most %.0f: obstacles and scans use %s; check the camera_info of '
            'the depth images',
            self._vehicle,
            frame.sensor or 'the camera',
            intrinsics.fx,
            intrinsics.cx,
            intrinsics.width,
            math.degrees(math.atan(widest)),
            limit,
            used,
        )

    def _check_mount(self, camera: str, estimate: FloorEstimate) -> None:
        """Warn once of a mount that the floor contradicts, and once of one that it cannot be."""
        misfit = estimate.misfit()
        if misfit is not None:
            logger.warning(
                '%s: %s sees no floor near where its mount has it. In %d frames, %.0f %% of the '
                'readings lie on a plane that is tilted by %.1f degrees along and %.1f across '
                'its view, and %+.3f m from there: it is taken for obstacles or holes. Unless it '
                'is a step or a ramp, check the mount (camera_z, camera_pitch), and that the '
                'base frame is on the floor',
                self._vehicle,
                camera or 'the camera',
                MISFITS,
                100.0 * misfit.share,
                math.degrees(misfit.floor.along),
                math.degrees(misfit.floor.across),
                misfit.floor.height,
            )
        if not estimate.contradicts_mount():
            return
        floor = estimate.floor
        logger.warning(
            '%s: %s sees the floor tilted by %.1f degrees along and %.1f across its view, and '
            '%+.3f m from where its mount has it: heights are corrected, but the mount should be '
            '(camera_pitch %+.3f, camera_roll %+.3f, camera_z %+.3f)',
            self._vehicle,
            camera or 'the camera',
            math.degrees(floor.along),
            math.degrees(floor.across),
            floor.height,
            floor.along,
            -floor.across,
            -floor.height,
        )


def _view_of(rays: Rays, finest: float, band: ObstacleConfig) -> tuple[_View, NDArray[np.int32]]:
    """Return the cells of a view, and the bin (W, H) of every ray.

    finest: tangent that a few samples are apart.
    """
    usable = rays.ahead > 0.0
    step = max(0.5 * OBSTACLE_CELL / band.obstacle_range, finest)
    bins = np.floor(rays.tangent / np.float32(step)).astype(np.int32)
    first = int(bins[usable].min(initial=0))
    last = int(bins[usable].max(initial=first))
    slices = min(math.ceil(band.obstacle_highest / SLICE_HEIGHT - 1e-9), HOLE_BIT)
    view = _View(first, step, last - first + 1, math.ceil(band.obstacle_range / _ROW), slices)
    return view, np.where(usable, bins - first, 0).astype(np.int32)


@kernel
def _free_slices(
    counts: NDArray[np.int16],
    at: int,
    height: float,
    slope: float,
    end: float,
    lowest: float,
) -> None:
    """Free what a ray passes on its way to a distance (m), slice by slice: whole rows alone."""
    slices, rows = counts.shape[1] - 1, counts.shape[2] - 1
    if abs(slope) < _FLAT:
        slope = _FLAT
    inverse = 1.0 / slope
    final = height + slope * end
    low, high = min(height, final), max(height, final)
    first = int(max(low, 0.0) / SLICE_HEIGHT)
    last = min(int(max(high, 0.0) / SLICE_HEIGHT), slices - 1)
    for piece in range(first, last + 1):
        z0 = piece * SLICE_HEIGHT
        # what lies on the floor is lower than lowest
        z1 = lowest if piece == 0 else z0 + SLICE_HEIGHT
        one, two = (z0 - height) * inverse, (z1 - height) * inverse
        start, stop = max(min(one, two), 0.0) / _ROW, min(max(one, two), end) / _ROW
        begin, beyond = int(start + 0.999), min(int(stop), rows)
        if begin < beyond:
            counts[at, piece, begin] += 1
            counts[at, piece, beyond] -= 1


@kernel
def _kind_of(z: float, forward: float, band: Band) -> int:
    """Return what a reading at a height (m) and a distance ahead (m) shows.

    Whether a hole is one depends on the ray as well: it has to come down from above the floor.
    """
    if z < -(band.step + _SLOPE * forward):
        return _HOLE
    if z < band.lowest + _SLOPE * forward:
        return _FLOOR
    return _OBSTACLE if z < band.highest else _NOTHING


@kernel
def _continues(before: _Reading, reading: _Reading, noise: float) -> bool:
    """Return whether the surface goes on between two readings, one above the other in the image.

    noise (m): of the latter. Of obstacles, only horizontal surfaces do: readings of a wall are
    apart by noise.
    """
    gap = abs(reading.place - before.place)
    if before.kind != reading.kind or gap > _LONGEST_GAP:
        return False
    if reading.kind != _OBSTACLE:
        return True
    if gap <= max(_ROW, 1.5 * _OUTLIER * noise):
        return False
    return bool(abs(reading.z - before.z) < _LEVEL * gap + _ROUGH)


@kernel
def _sort(
    rays: Rays,
    bins: NDArray[np.int32],
    depth: NDArray[np.float32],
    tilt: tuple[float, float],
    height: float,
    view: _View,
    band: Band,
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return which slices are occupied, and which are free, as bits by bin and row.

    bins (W, H): of the rays; depth (W, H) m; tilt: slopes of the floor; height (m): of the camera.
    """
    hits = np.zeros((view.bins, view.slices + 1, view.rows + 1), np.int16)
    passes = np.zeros((view.bins, view.slices + 1, view.rows + 1), np.int16)
    reach = view.rows * _ROW
    for column in range(depth.shape[0]):
        before = _Reading(_NOTHING, 0.0, 0.0)  # above in the image
        for row in range(depth.shape[1]):
            forward = float(depth[column, row]) * float(rays.ahead[column, row])
            if forward <= 0.0:
                before = _Reading(_NOTHING, 0.0, 0.0)
                continue
            at = bins[column, row]
            slope = float(rays.slope[column, row]) - tilt[0]
            slope -= tilt[1] * float(rays.tangent[column, row])
            z = height + forward * slope
            noise = band.noise * forward * forward
            kind, place = _kind_of(z, forward, band), forward
            if kind == _HOLE:
                if height > 0.0 and slope < 0.0:
                    place = -height / slope  # where the ray should have met the floor
                else:
                    kind = _NOTHING
            if row % _FREE_EVERY == 0:
                end = min(min(forward - noise, place) - _MARGIN, reach)
                if end > 0.0:
                    _free_slices(passes, at, height, slope, end, band.lowest)
            reading = _Reading(kind, place, z)
            if kind != _NOTHING and 0.0 <= place < reach:
                same = _continues(before, reading, noise)
                start = before.place if same else place
                low = int(min(start, place) / _ROW)
                high = min(int(max(start, place) / _ROW) + 1, view.rows)
                if kind == _FLOOR:
                    passes[at, view.slices, low] += 1
                    passes[at, view.slices, high] -= 1
                else:
                    obstacle = kind == _OBSTACLE
                    piece = (
                        min(int(z / SLICE_HEIGHT), view.slices - 1) if obstacle else view.slices
                    )
                    weight = _FILLED if same and obstacle else 1
                    hits[at, piece, low] += weight
                    hits[at, piece, high] -= weight
            before = reading
    return _judge(hits, passes)


@kernel
def _judge(
    hits: NDArray[np.int16], passes: NDArray[np.int16]
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return occupied and free slices as bits, from differences of counts along the rows."""
    bins, slices, rows = hits.shape[0], hits.shape[1] - 1, hits.shape[2] - 1
    occupied = np.zeros((bins, rows), np.uint16)
    free = np.zeros((bins, rows), np.uint16)
    line = np.zeros(rows, np.int32)
    for at in range(bins):
        for piece in range(slices + 1):
            bit = np.uint16(1 << (HOLE_BIT if piece == slices else piece))
            total, passed = 0, 0
            for row in range(rows):
                total += hits[at, piece, row]
                line[row] = total
            for row in range(rows):
                passed += passes[at, piece, row]
                most = line[row]
                if most >= _LEAST_READINGS:
                    for other in range(max(row - _BESIDE, 0), min(row + _BESIDE + 1, rows)):
                        most = max(most, line[other])
                if line[row] >= max(_LEAST_READINGS, _LEAST_SHARE * most):
                    occupied[at, row] |= bit
                elif passed > 0:
                    free[at, row] |= bit
    return occupied, free


@kernel
def _to_vehicle(
    occupied: NDArray[np.uint16],
    free: NDArray[np.uint16],
    view: _View,
    x: float,
    y: float,
    heading: float,
) -> tuple[NDArray[np.int16], NDArray[np.uint16], NDArray[np.uint16]]:
    """Return cells (N, 2) of the vehicle frame, and their bits; what is occupied is not free.

    x, y (m), heading (rad): of the camera in the vehicle frame.
    """
    cos, sin = math.cos(heading), math.sin(heading)
    reach = view.rows * _ROW
    widest = max(abs(view.first), abs(view.first + view.bins)) * view.step
    around = int(reach * math.hypot(1.0, widest) / OBSTACLE_CELL) + 2
    column0 = math.floor(x / OBSTACLE_CELL) - around
    line0 = math.floor(y / OBSTACLE_CELL) - around
    hit = np.zeros((2 * around + 1, 2 * around + 1), np.uint16)
    passed = np.zeros((2 * around + 1, 2 * around + 1), np.uint16)
    count = 0
    for at in range(view.bins):
        tangent = (at + view.first + 0.5) * view.step
        dx, dy = cos - sin * tangent, sin + cos * tangent
        for row in range(view.rows):
            if occupied[at, row] | free[at, row] == 0:
                continue
            forward = (row + 0.5) * _ROW
            column = math.floor((x + forward * dx) / OBSTACLE_CELL) - column0
            line = math.floor((y + forward * dy) / OBSTACLE_CELL) - line0
            if hit[line, column] | passed[line, column] == 0:
                count += 1
            hit[line, column] |= occupied[at, row]
            passed[line, column] |= free[at, row]
    cells = np.empty((count, 2), np.int16)
    hits, passes = np.empty(count, np.uint16), np.empty(count, np.uint16)
    number = 0
    for line in range(hit.shape[0]):
        for column in range(hit.shape[1]):
            if hit[line, column] | passed[line, column] != 0:
                cells[number, 0], cells[number, 1] = column + column0, line + line0
                hits[number] = hit[line, column]
                passes[number] = passed[line, column] & ~hit[line, column]
                number += 1
    return cells, hits, passes


def warm_up() -> None:
    """Compile the kernels, so that the first frame does not wait for the compiler."""
    camera = Intrinsics(32, 24, 30.0, 30.0, 15.5, 11.5)
    image = np.zeros((24, 32), np.uint8)
    depth = np.full((24, 32), 2.0, np.float32)
    detector, frame = ObstacleDetector(), RgbdFrame(0.0, image, depth, camera)
    detector.detect(frame)
    detector.scan(frame)
