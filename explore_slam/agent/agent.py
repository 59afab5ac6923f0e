"""The central agent, without ROS: vision, belief, grid and planner for all vehicles.

The live node, the bag replay, the experiments and the benchmarks all drive this class. The same
records in the same order give the same belief, map and plans, bit for bit.
"""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from explore_slam.agent import checkpoint
from explore_slam.agent.config import AgentConfig
from explore_slam.agent.odometry import OdometryBuffer
from explore_slam.agent.scan_odometry import refine_by_scan
from explore_slam.agent.vehicle_track import Keyframe, Observation, VehicleTrack
from explore_slam.data import (
    InterRobotObservation,
    LandmarkObservations,
    LaserScan,
    OdometryReading,
    RgbdFrame,
    VehicleState,
    VehicleStatus,
)
from explore_slam.errors import AgentError
from explore_slam.geometry import Array, Pose2
from explore_slam.mapping import Body, LaserMap, OccupancyGrid, ScanMatcher, save_map
from explore_slam.slam import Landmarks, TeamBelief, UpdateSummary, compound
from explore_slam.vision import FeatureExtractor, KeyframeSelector

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class KeyframeEvent:
    """A keyframe that entered the belief: the pose right after it, and what the update did."""

    vehicle: str
    stamp: float
    pose: Pose2
    covariance: Array
    update: UpdateSummary | None  # None: motion alone, no frame came for a while


class Agent:
    """Belief and map of a team of vehicles whose start poses in the map are known.

    Records go in with add_odometry, add_scan, add_frame, add_landmarks and add_sighting;
    estimates, grid and landmarks can be read at any time. Planning is in TeamPlanner.
    """

    def __init__(
        self, config: AgentConfig, start_poses: Mapping[str, Pose2], seed: int = 0
    ) -> None:
        if not start_poses:
            raise AgentError('start_poses is empty, expected a pose for every vehicle')
        self.config = config
        self.start_poses = dict(start_poses)
        self.seed = seed
        self.paused = False
        self.tracks: dict[str, VehicleTrack] = {}
        self.configure(config)
        self._begin()

    def _begin(self) -> None:
        inputs = self.config.inputs
        self.belief = TeamBelief(self.start_poses, self.config.slam, self.seed)
        self.laser_map = LaserMap(self.config.mapping)
        self.now = 0.0
        self.tracks = {
            name: VehicleTrack(
                name,
                pose,
                OdometryBuffer(
                    name, inputs.odometry_span, inputs.maximum_speed, inputs.clock_jump
                ),
                KeyframeSelector(self.config.vision),
                ScanMatcher(self.config.scan_matching),
            )
            for name, pose in self.start_poses.items()
        }
        self._events: list[KeyframeEvent] = []

    def configure(self, config: AgentConfig) -> None:
        """Go on with other settings; those of belief and grid take effect at the next reset."""
        extractor = FeatureExtractor(config.vision)
        self.config, self._extractor = config, extractor
        self._laser = config.laser_mount.pose
        for track in self.tracks.values():
            track.selector.config = config.vision.keyframes
            track.matcher.config = config.scan_matching

    def reset(self) -> None:
        """Forget everything learned; vehicles are at their start poses again."""
        self._begin()

    # -- records in ----------------------------------------------------------------------------

    def add_odometry(self, vehicle: str, reading: OdometryReading) -> None:
        """Take the next odometry reading; observations that waited for it are used now."""
        track = self._track(vehicle)
        before = track.odometry.last
        if not track.odometry.add(reading):
            track.count('late_odometry')
            return
        if reading.stamp < before:
            self._follow_clock_back(track)
        self.now = max(self.now, reading.stamp)
        track.last_heard = self.now
        if track.keyframe is None:
            self._add_keyframe(track, reading.stamp)
        self._use_ready(track)

    def add_scan(self, vehicle: str, scan: LaserScan) -> None:
        """Take a laser scan; it waits until odometry reaches its stamp."""
        if self.config.scan_matching.scan_matching and not self.paused:
            most = self.config.inputs.waiting_observations
            self._track(vehicle).wait_for_match(scan, most)
        self._add(vehicle, scan)

    def add_frame(self, vehicle: str, frame: RgbdFrame) -> None:
        """Take an RGB-D frame; it becomes a keyframe when the vehicle moved far enough."""
        self._add(vehicle, frame)

    def add_landmarks(self, vehicle: str, observations: LandmarkObservations) -> None:
        """Take landmarks that were extracted elsewhere (on the vehicle, from a data set)."""
        self._add(vehicle, observations)

    def add_sighting(self, vehicle: str, sighting: InterRobotObservation) -> None:
        """Take the position of another vehicle as this one sees it."""
        self._track(sighting.vehicle)
        self._add(vehicle, sighting)

    def advance(self, stamp: float) -> None:
        """Tell the time (s): vehicles that said nothing for long are silent."""
        if not math.isfinite(stamp):
            raise AgentError(f'time is {stamp}, expected finite seconds')
        back = stamp < self.now - self.config.inputs.clock_jump
        self.now = stamp if back else max(self.now, stamp)

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Put a vehicle where a person says it is (RViz's initial pose); the map stays."""
        self._track(vehicle)
        self.belief.set_pose(vehicle, pose, covariance)

    def _track(self, vehicle: str) -> VehicleTrack:
        track = self.tracks.get(vehicle)
        if track is None:
            raise AgentError(f'unknown vehicle {vehicle!r}, expected one of {list(self.tracks)}')
        return track

    def _add(self, vehicle: str, observation: Observation) -> None:
        track = self._track(vehicle)
        if self.paused:
            track.count('ignored_while_paused')
            return
        track.wait(observation, self.config.inputs.waiting_observations)
        self._use_ready(track)

    def _follow_clock_back(self, track: VehicleTrack) -> None:
        """Go on in the new time from where the vehicle is."""
        track.follow_clock_back()
        self.belief.restart_clock(track.name)
        self.now = track.odometry.last

    # -- observations into the belief ----------------------------------------------------------

    def _use_ready(self, track: VehicleTrack) -> None:
        noise = self.config.slam.odometry_noise
        while (scan := track.next_to_match()) is not None:
            if track.keyframe is None or scan.stamp >= track.keyframe.stamp:
                refine_by_scan(track, scan, self._laser, noise)
        patience = self.config.scan_matching.matching_patience
        while (observation := track.next_ready(patience)) is not None:
            if isinstance(observation, LaserScan):
                self._use_scan(track, observation)
            elif isinstance(observation, RgbdFrame):
                self._use_frame(track, observation)
            elif isinstance(observation, LandmarkObservations):
                self._use_landmarks(track, observation)
            else:
                self._use_sighting(track, observation)

    def _too_late(self, track: VehicleTrack, stamp: float) -> bool:
        if track.keyframe is not None and stamp >= track.keyframe.stamp:
            return False
        track.count('late_observations')
        return True

    def _use_frame(self, track: VehicleTrack, frame: RgbdFrame) -> None:
        if self._too_late(track, frame.stamp):
            return
        track.last_seen = frame.stamp
        track.count('frames')
        if track.selector.wants(frame.stamp, track.odometry.at(frame.stamp)):
            self._update(track, self._extractor.extract(frame))

    def _use_landmarks(self, track: VehicleTrack, observations: LandmarkObservations) -> None:
        if self._too_late(track, observations.stamp):
            return
        track.last_seen = observations.stamp
        self._update(track, observations)

    def _update(self, track: VehicleTrack, observations: LandmarkObservations) -> None:
        self._predict(track, observations.stamp)
        summary = None
        if len(observations):
            summary = self.belief.update(track.name, observations)
        else:
            track.count('frames_without_landmarks')
        self._add_keyframe(track, observations.stamp, summary)

    def _use_sighting(self, track: VehicleTrack, sighting: InterRobotObservation) -> None:
        if self._too_late(track, sighting.stamp):
            return
        if self.config.slam.maps == 'dedicated' or not self.config.slam.inter_robot_observations:
            track.count('unused_sightings')
            return
        other = self.tracks[sighting.vehicle]
        if other.odometry.last < sighting.stamp or self._too_late(other, sighting.stamp):
            track.count('unmatched_sightings')
            return
        for seen in (track, other):
            self._predict(seen, sighting.stamp)
            self._add_keyframe(seen, sighting.stamp)
        self.belief.update_inter_robot(track.name, [sighting])

    def _predict(self, track: VehicleTrack, stamp: float) -> None:
        """Hand the motion since the newest keyframe to the belief, which compounds the steps."""
        noise = self.config.slam.odometry_noise
        for step in track.steps_since_keyframe(stamp):
            self.belief.predict(track.name, step.increment, step.covariance_or(noise))

    def _add_keyframe(
        self, track: VehicleTrack, stamp: float, update: UpdateSummary | None = None
    ) -> None:
        number = self.belief.add_keyframe(track.name, stamp)
        track.keyframe = Keyframe(number, stamp, track.odometry.at(stamp))
        pose, covariance = self.belief.estimate(track.name)
        self._events.append(KeyframeEvent(track.name, stamp, pose, covariance, update))

    # -- scans into the grid -------------------------------------------------------------------

    def _use_scan(self, track: VehicleTrack, scan: LaserScan) -> None:
        if track.keyframe is None:
            track.count('late_observations')
            return
        pose = track.odometry.at(scan.stamp)
        if not self._scan_wanted(track, scan.stamp, pose):
            return
        track.last_scan = (scan.stamp, pose)
        self._keyframe_without_frames(track, scan.stamp)
        moved = track.keyframe.odometry.between(pose)
        self.laser_map.add(
            track.keyframe.number,
            track.name,
            scan,
            moved.compose(self._laser),
            self._bodies(track, scan.stamp),
        )

    def _scan_wanted(self, track: VehicleTrack, stamp: float, pose: Pose2) -> bool:
        if track.last_scan is None:
            return True
        last_stamp, last_pose = track.last_scan
        moved, scans = last_pose.between(pose), self.config.scans
        return (
            math.hypot(moved.x, moved.y) >= scans.scan_distance
            or abs(moved.theta) >= scans.scan_heading
            or stamp - last_stamp >= scans.scan_gap
        )

    def _keyframe_without_frames(self, track: VehicleTrack, stamp: float) -> None:
        """Make a keyframe of motion alone when the camera is silent, so that scans have a pose."""
        chosen = self.config.vision.keyframes
        if stamp - track.last_seen < chosen.maximum_keyframe_gap or self._too_late(track, stamp):
            return
        moved = track.moved_since_keyframe(stamp)
        if (
            math.hypot(moved.x, moved.y) >= chosen.minimum_travel_distance
            or abs(moved.theta) >= chosen.minimum_travel_heading
        ):
            self._predict(track, stamp)
            self._add_keyframe(track, stamp)

    def _bodies(self, track: VehicleTrack, stamp: float) -> list[Body]:
        """Return where the other vehicles were, so that they do not become walls."""
        radius = self.config.exploration.paths.vehicle_radius + self.config.scans.body_margin
        bodies = []
        for other in self.tracks.values():
            if other is track:
                continue
            if other.keyframe is None:
                bodies.append(Body(-1, other.start, radius))
            else:
                moved = other.moved_since_keyframe(stamp)
                bodies.append(Body(other.keyframe.number, moved, radius))
        return bodies

    # -- what is known -------------------------------------------------------------------------

    @property
    def vehicles(self) -> list[str]:
        """Names of the vehicles."""
        return list(self.tracks)

    @property
    def grid(self) -> OccupancyGrid:
        """The occupancy grid along the best particle's path, brought up to date."""
        self.laser_map.redraw(self.belief.best_path())
        return self.laser_map.grid

    def take_events(self) -> list[KeyframeEvent]:
        """Return the keyframes since the last call."""
        events, self._events = self._events, []
        return events

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean pose and covariance (3, 3) of a vehicle at its newest odometry."""
        track = self._track(vehicle)
        pose, covariance = self.belief.estimate(vehicle)
        noise = self.config.slam.odometry_noise
        for step in track.steps_since_keyframe(track.odometry.last):
            pose, covariance = compound(
                pose, covariance, step.increment, step.covariance_or(noise)
            )
        return pose, covariance

    def map_pose(self, vehicle: str) -> Pose2:
        """Return the pose on the best particle's path, which is the one the grid was drawn on."""
        track = self._track(vehicle)
        moved = track.moved_since_keyframe(track.odometry.last)
        return self.belief.best_pose(vehicle).compose(moved)

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of the keyframes along the best lineage."""
        self._track(vehicle)
        return self.belief.trajectory(vehicle)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle."""
        return self.belief.landmarks()

    def statuses(self) -> list[VehicleStatus]:
        """Return what every vehicle is doing."""
        return [self._status(track) for track in self.tracks.values()]

    def summary(self) -> dict[str, Any]:
        """Return counts of what was used and what was left out, per vehicle."""
        return {
            name: {**track.counts, 'odometry_resets': track.odometry.breaks}
            for name, track in self.tracks.items()
        }

    def save_state(self, path: Path) -> Path:
        """Write belief and scans to a file that load_state reads; return its path."""
        for track in self.tracks.values():
            if track.keyframe is not None and track.odometry.last > track.keyframe.stamp:
                self._predict(track, track.odometry.last)
                self._add_keyframe(track, track.odometry.last)
        checkpoint.save(path, self.belief, self.laser_map)
        return path

    def load_state(self, path: Path) -> None:
        """Go on from a saved state of the same vehicles; a bad file changes nothing."""
        belief, laser_map = checkpoint.load(path, self.config.mapping)
        if set(belief.vehicles) != set(self.start_poses):
            raise AgentError(
                f'{path} is of vehicles {sorted(belief.vehicles)}, '
                f'expected {sorted(self.start_poses)}'
            )
        self._begin()
        self.belief, self.laser_map = belief, laser_map
        for vehicle in self.tracks:
            belief.restart_clock(vehicle)

    def save_map(self, base: Path) -> Path:
        """Write base.pgm and base.yaml (map_server); return the path of the YAML file."""
        return save_map(self.grid, base)

    def _status(self, track: VehicleTrack) -> VehicleStatus:
        pose, covariance = self.estimate(track.name)
        deviation = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
        state = track.state
        if track.last_heard < self.now - self.config.inputs.silent_timeout:
            state = VehicleState.SILENT
        elif deviation > self.config.inputs.lost_deviation:
            state = VehicleState.LOST
        goal = track.plan.goal if track.plan is not None and len(track.plan.waypoints) else None
        return VehicleStatus(self.now, track.name, state, pose, covariance, goal)
