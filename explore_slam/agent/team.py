"""State of the team: filter, laser map and odometry, and the steps that tie them together.

The measurement kinds (explore_slam.agent.measurements) work on this object.
"""

import logging
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from explore_slam.agent.config import AgentConfig
from explore_slam.agent.loop_closing import LoopClosing
from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.agent.odometry_sources import make_source
from explore_slam.agent.placement import Placement
from explore_slam.agent.tag_mapping import TagMapping
from explore_slam.agent.vehicle_track import Keyframe, VehicleTrack, merged_steps
from explore_slam.data import (
    LandmarkObservations,
    LaserScan,
    ObstacleView,
    TagObservations,
    VehicleBody,
)
from explore_slam.errors import AgentError
from explore_slam.exploration import paths_of
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import MAP_FRAME, LaserMap, ObstacleMap, VehicleDisc
from explore_slam.registration import ScanMatcher
from explore_slam.slam import TeamBelief, UpdateSummary
from explore_slam.tags import table_of
from explore_slam.vision import FeatureExtractor, KeyframeSelector
from explore_slam.vision.obstacles import ObstacleDetector
from explore_slam.vision.rolling_shutter import at_the_stamp

# Steps that the motion since the newest keyframe is compounded of: joining those of long drives
# without keyframes keeps the poses between them cheap.
_MERGED_STEPS = 40

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class KeyframeEvent:
    """A keyframe that entered the filter: the estimate right after it and the update's summary.

    update None: a keyframe without landmarks, from odometry alone. in_map: whether the pose is in
    the map, not in a frame of the vehicle's own because its start pose is unknown.
    """

    vehicle: str
    stamp: float
    pose: Pose2
    covariance: Array
    update: UpdateSummary | None
    in_map: bool = True


class Team:
    """Filter, laser map and tracks of all vehicles; `configure` replaces the settings."""

    def __init__(
        self,
        config: AgentConfig,
        start_poses: Mapping[str, Pose2 | None],
        seed: int,
        bodies: Mapping[str, VehicleBody] | None = None,
        sources: Mapping[str, str] | None = None,
        camera_scans: Collection[str] = (),
    ) -> None:
        """Begin at the start poses.

        bodies: of vehicles that are not of the standard size. sources: of their odometry, where
        it is not that of the wheels. camera_scans: vehicles whose scans are made of depth images.
        """
        inputs, noise = config.inputs, config.slam.odometry_noise
        _check_sources(sources or {}, config)
        blind = sorted(n for n in camera_scans if (sources or {}).get(n) == 'scan')
        if blind:
            raise AgentError(
                f'odometry of {", ".join(blind)} is scan, expected wheels or wheels+gyro: the '
                'scans of a camera show too little of the motion'
            )
        self.config = config
        self.start_poses = dict(start_poses)
        self.camera_scans = frozenset(camera_scans)
        self.belief = TeamBelief(self.start_poses, config.slam, seed)
        # in a depth image the floor is seen where a beam has no return
        self.laser_map = LaserMap(config.mapping, known_free=self.camera_scans)
        self.obstacle_map = ObstacleMap(config.mapping)
        self.loops = LoopClosing(config.closures)
        self.tags = TagMapping(config.vision.tags, table_of(config.vision.tags).poses)
        self.extractor = FeatureExtractor(config.vision)
        self.detectors = {
            name: ObstacleDetector(config.vision, vehicle=name) for name in self.start_poses
        }
        self.events: list[KeyframeEvent] = []
        self.tracks = {
            name: VehicleTrack(
                name,
                pose,
                OdometryBuffer(
                    name,
                    inputs.odometry_duration,
                    inputs.odometry_jump_speed,
                    inputs.clock_jump_threshold,
                ),
                KeyframeSelector(config.vision),
                ScanMatcher(config.scan_matching, open_ended=source.weak),
                Placement(name, start_known=pose is not None),
                body=(bodies or {}).get(name, VehicleBody()),
                source=source,
            )
            for name, pose in self.start_poses.items()
            for source in [make_source((sources or {}).get(name, 'wheels'), name, noise)]
        }

    def configure(self, config: AgentConfig) -> None:
        """Replace the settings; those of filter and grid take effect with the next Team.

        AgentError changes nothing.
        """
        _check_sources({name: track.source.name for name, track in self.tracks.items()}, config)
        self.extractor = FeatureExtractor(config.vision)
        self.tags.configure(config.vision.tags, table_of(config.vision.tags).poses)
        if config.vision != self.config.vision:
            self.detectors = {
                name: ObstacleDetector(config.vision, vehicle=name) for name in self.tracks
            }
        self.config = config
        for track in self.tracks.values():
            track.configure(config.vision.keyframes, config.scan_matching)

    def track(self, vehicle: str) -> VehicleTrack:
        """Return the track of a vehicle; AgentError if there is none of this name."""
        track = self.tracks.get(vehicle)
        if track is None:
            raise AgentError(f'unknown vehicle {vehicle!r}, expected one of {list(self.tracks)}')
        return track

    def matches_scans(self, track: VehicleTrack) -> bool:
        """Return whether the scans of a vehicle refine its odometry; those of cameras do not.

        A depth image shows 60 degrees up to a few metres, often of one wall. In the simulated
        office, matching moved a pose that was right to 1 cm by 0.6 m, far beyond the error that it
        claimed. Scans in the plane of the camera, matched near the odometry's pose only, err less
        than wheels, but in two of five runs by far more than they claimed. The landmarks of the
        same image measure all directions.
        """
        return self.config.scan_matching.scan_matching and track.name not in self.camera_scans

    def laser_pose(self, scan: LaserScan) -> Pose2:
        """Return the pose of a scan's laser in the vehicle frame: its own, else the setting."""
        return scan.mount or self.config.laser_mount.pose

    def is_late(self, track: VehicleTrack, stamp: float) -> bool:
        """Return whether a stamp (s) lies before the newest keyframe, and count it if so."""
        if track.keyframe is not None and stamp >= track.keyframe.stamp:
            return False
        track.count('late_observations')
        return True

    def predict(self, track: VehicleTrack, stamp: float) -> None:
        """Propagate the filter by the odometry from the newest keyframe to a stamp (s)."""
        white = track.odometry.white_at(stamp)
        for step in track.steps_since_keyframe(stamp):
            self.belief.predict(track.name, step.increment, step.covariance, white)

    def discs(self, track: VehicleTrack, scan: LaserScan) -> list[tuple[float, float, float]]:
        """Return discs (x m, y m, radius m), in the frame of a vehicle, that hide the others."""
        if len(self.tracks) == 1:
            return []
        own = self.pose_at(track, scan.stamp)
        others = [
            (self.pose_at(other, scan.stamp), self.body_radius(other, scan))
            for name, other in self.tracks.items()
            if other is not track and self.belief.are_in_one_frame(track.name, name)
        ]
        return [(*own.between(pose)[:2], radius) for pose, radius in others]

    def bodies(self, track: VehicleTrack, seen: LaserScan | ObstacleView) -> list[VehicleDisc]:
        """Return the positions of the other vehicles, so that they do not become walls."""
        bodies = []
        for other in self.tracks.values():
            if other is track:
                continue
            radius = self.body_radius(other, seen)
            if other.keyframe is None:
                if other.start is None:
                    continue
                bodies.append(VehicleDisc(MAP_FRAME, other.start, radius))
            else:
                moved = other.moved_since_keyframe(seen.stamp)
                bodies.append(VehicleDisc(other.keyframe.number, moved, radius))
        return bodies

    def body_radius(self, track: VehicleTrack, scan: LaserScan | ObstacleView) -> float:
        """Return the radius (m) around a vehicle in which another may see its body.

        The vehicle moves while the beams of a sweep are measured one after the other: as far as
        it gets from where it is in the middle of the sweep, the radius is larger.
        """
        paths = paths_of(self.config.exploration.paths, track.body)
        radius = paths.planning_radius + self.config.scans.body_margin
        half = 0.5 * scan.undone_sweep if isinstance(scan, LaserScan) else 0.0
        if half == 0.0 or not len(track.odometry):
            return radius
        middle = track.odometry.at(scan.stamp)
        ends = (track.odometry.at(scan.stamp + after) for after in (-half, half))
        return radius + max(math.dist(middle[:2], end[:2]) for end in ends)

    def pose_at(self, track: VehicleTrack, stamp: float) -> Pose2:
        """Return the estimated pose of a vehicle at a stamp (s) after its newest keyframe."""
        moved, _ = self.motion_since_keyframe(track, stamp)
        return self.belief.best_pose(track.name).compose(moved)

    def motion_since_keyframe(self, track: VehicleTrack, stamp: float) -> tuple[Pose2, Array]:
        """Return mean and covariance (3, 3) of the motion from the newest keyframe to a stamp (s).

        Wheel odometry is corrected by its calibration.
        """
        steps = merged_steps(track.steps_since_keyframe(stamp), _MERGED_STEPS)
        return self.belief.motion(track.name, steps)

    def add_keyframe(
        self, track: VehicleTrack, stamp: float, update: UpdateSummary | None = None
    ) -> None:
        """Store the current pose as a keyframe; `predict` has brought it to the stamp (s)."""
        number = self.belief.add_keyframe(track.name, stamp)
        track.keyframe = Keyframe(number, stamp, track.odometry.at(stamp))
        pose, covariance = self.belief.estimate(track.name)
        in_map = self.belief.is_in_map(track.name)
        self.events.append(KeyframeEvent(track.name, stamp, pose, covariance, update, in_map))

    def update(self, track: VehicleTrack, observations: LandmarkObservations) -> None:
        """Update the filter with landmark observations, which become a keyframe."""
        self.predict(track, observations.stamp)
        summary = None
        if len(observations):
            velocity = track.odometry.velocity(observations.stamp)
            readout = self.config.vision.depth.camera_readout_time
            observations = at_the_stamp(observations, velocity, readout)
            summary = self.belief.update(track.name, observations)
            if summary.joined:
                logger.info('%s joined the map by the landmarks that it observes', track.name)
            track.count('landmark_closures', int(summary.closed))
            track.count('landmark_closures_retracted', int(summary.retracted))
            track.placement.check_update(summary)
        else:
            track.count('frames_without_landmarks')
        self.add_keyframe(track, observations.stamp, summary)

    def add_tags(self, track: VehicleTrack, observations: TagObservations) -> None:
        """Take tags that a vehicle has seen; their keyframe is the newest, or a new one."""
        if not self.belief.uses_tags:
            track.count('unused_tags', len(observations))
            return
        if track.keyframe is None or track.keyframe.stamp < observations.stamp:
            self.predict(track, observations.stamp)
            self.add_keyframe(track, observations.stamp)
        if track.keyframe is None:
            return
        counts = self.tags.add(self.belief, self.loops, track.name, track.keyframe, observations)
        track.count('tags', len(observations))
        track.count('tag_sightings', counts.sightings)
        track.count('tag_closures', counts.closed)
        track.count('tag_closures_retracted', counts.retracted)


def _check_sources(sources: Mapping[str, str], config: AgentConfig) -> None:
    """Raise AgentError for a vehicle whose motion is measured by scans that are not matched."""
    alone = sorted(name for name, source in sources.items() if source == 'scan')
    if alone and not config.scan_matching.scan_matching:
        raise AgentError(
            f'odometry of {", ".join(alone)} is scan and scan_matching is false, expected true: '
            'nothing else shows the motion'
        )
