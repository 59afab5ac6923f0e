"""The central agent, without ROS: records of all vehicles in, poses and map of the team out.

The live node, the replay of recordings, the experiments and the benchmarks all drive this class.
The same records in the same order give the same estimates, map and plans, bit for bit.

What happens to a record:

1. Odometry is appended to its vehicle's track; everything else waits until odometry reaches it.
2. A scan whose beams were measured one after the other becomes one of a single moment as soon as
   odometry covers its sweep; all that follows takes it as such.
3. Scans are matched with earlier ones and correct the odometry (laser odometry).
4. Measurements are processed in the order of their stamps, each by its kind
   (explore_slam.agent.measurements): frames that become keyframes and landmark observations
   update the filter, scans are added to the laser map and close loops.
5. On request the occupancy grid is redrawn along the most likely path.
"""

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from explore_slam.agent import checkpoint
from explore_slam.agent.config import AgentConfig
from explore_slam.agent.loop_closing import Join, LoopClosing
from explore_slam.agent.measurement_queue import Stamped
from explore_slam.agent.measurements import kind_of
from explore_slam.agent.measurements.scans import release_sweeps
from explore_slam.agent.odometry_sources import Motion, NewScan
from explore_slam.agent.placement import DISPLACED
from explore_slam.agent.scan_odometry import refine_by_scan
from explore_slam.agent.tag_mapping import TagMapping
from explore_slam.agent.team import KeyframeEvent, Team
from explore_slam.agent.vehicle_track import VehicleTrack
from explore_slam.data import (
    ImuReading,
    LaserScan,
    ObstacleView,
    OdometryReading,
    VehicleBody,
    VehicleState,
    VehicleStatus,
)
from explore_slam.errors import AgentError
from explore_slam.exploration import KnownPlace
from explore_slam.geometry import IDENTITY, Array, Pose2, rotated
from explore_slam.mapping import (
    LaserMap,
    ObstacleMap,
    OccupancyGrid,
    cells_looked_at,
    save_map,
    with_obstacles,
)
from explore_slam.slam import Landmarks, OdometryCalibration, TeamBelief, compound
from explore_slam.slam.checks import check_motion_covariance, check_pose
from explore_slam.sweeps import Sweep


class Agent:
    """Localization and mapping for a team of vehicles.

    A vehicle whose start pose is unknown (None) maps in a frame of its own. Its scans and its
    landmarks are searched in the map; when enough of them agree on where it is, it joins: all of
    them enter the common map. Until then it is unlocalized, its poses are not in the map, and it
    gets no target. If all start poses are unknown, the map begins where the first vehicle starts.

    `add` takes records; estimates, grid and landmarks can be read at any time. TeamPlanner plans.

    paused: ignore measurements; odometry is still tracked.
    now: newest time (s) of the agent.
    bodies: size and speed of vehicles that are not standard.
    sources: what the odometry of a vehicle is measured by: wheels (the default), scan, or
    wheels+gyro.
    camera_scans: vehicles without a laser, whose scans are made of their depth images.
    """

    def __init__(
        self,
        config: AgentConfig,
        start_poses: Mapping[str, Pose2 | None],
        seed: int = 0,
        bodies: Mapping[str, VehicleBody] | None = None,
        sources: Mapping[str, str] | None = None,
        camera_scans: Collection[str] = (),
    ) -> None:
        if not start_poses:
            raise AgentError('start_poses is empty, expected a pose for every vehicle')
        self.start_poses = dict(start_poses)
        self.seed = seed
        self.paused = False
        self.now = 0.0
        self.bodies = dict(bodies or {})
        self.sources = dict(sources or {})
        self.camera_scans = frozenset(camera_scans)
        # grid with obstacles, and the drawings of which it was made
        self._merged: tuple[tuple[Team, int, int], OccupancyGrid] | None = None
        self._team = self._new_team(config)

    def _new_team(self, config: AgentConfig) -> Team:
        """Return a team at its start poses."""
        return Team(
            config, self.start_poses, self.seed, self.bodies, self.sources, self.camera_scans
        )

    @property
    def config(self) -> AgentConfig:
        """Settings in force."""
        return self._team.config

    def configure(self, config: AgentConfig) -> None:
        """Replace the settings; those of filter and grid take effect at the next reset."""
        self._team.configure(config)

    def reset(self) -> None:
        """Forget filter, map and odometry; the vehicles are at their start poses again.

        What has been learnt of the sensors is kept: of the sweeps of the lasers, and of the IMU.
        """
        before = self.tracks
        self._team = self._new_team(self.config)
        for name, track in self.tracks.items():
            track.sweeps.keep_knowledge(before[name].sweeps)
            track.source.keep_knowledge(before[name].source)
        self.now = 0.0

    # -- records in ----------------------------------------------------------------------------

    def add(self, vehicle: str, record: Stamped) -> None:
        """Add a record of a vehicle: an OdometryReading, an ImuReading or a measurement.

        AgentError if the vehicle or the type of the record is unknown; the state is unchanged.
        """
        track = self.track(vehicle)
        if isinstance(record, OdometryReading | ImuReading):
            for motion in _motions(track, record):
                self._add_motion(track, motion)
            return
        kind = kind_of(record)
        kind.check(self._team, record)
        motion_scan = record if track.source.needs_scans else None
        track.unmapped = self.paused
        if self.paused and not isinstance(motion_scan, LaserScan):
            track.count('ignored_while_paused')
            return
        if kind.draws_map and track.placement.displaced:
            track.count('scans_while_displaced')
            return
        kind.enqueue(self._team, track, record)
        if isinstance(motion_scan, LaserScan):
            self._cover(track, motion_scan)
        self._process(track)

    def advance(self, stamp: float) -> None:
        """Set the time (s), by which silent vehicles are recognized."""
        if not math.isfinite(stamp):
            raise AgentError(f'time is {stamp}, expected finite seconds')
        jumped_back = stamp < self.now - self.config.inputs.clock_jump_threshold
        self.now = stamp if jumped_back else max(self.now, stamp)

    def set_pose(self, vehicle: str, pose: Pose2, covariance: Array) -> None:
        """Place a vehicle, where it is now, at a pose given by the operator; the map is kept.

        covariance: (3, 3) of the pose. SlamError if it cannot be used, AgentError if it is farther
        from all vehicles than the map may be wide; the state is unchanged.
        """
        track = self.track(vehicle)
        check_pose('pose', pose)
        self._check_within_reach(vehicle, pose)
        check_motion_covariance('covariance', covariance)
        self._add_keyframe_here(track)  # else its motion since the newest one would follow
        self.belief.set_pose(vehicle, pose, covariance)
        track.placement.set_by_operator()

    def _check_within_reach(self, vehicle: str, pose: Pose2) -> None:
        """Raise AgentError for a pose that no map with this vehicle and another can hold."""
        limit = self.config.mapping.maximum_map_side
        nearest = min(math.dist(pose[:2], self.estimate(name)[0][:2]) for name in self.start_poses)
        if nearest > limit:
            raise AgentError(
                f'pose of {vehicle} is ({pose.x:g} m, {pose.y:g} m), {nearest:g} m from the '
                f'nearest vehicle, expected at most maximum_map_side = {limit:g} m'
            )

    def _cover(self, track: VehicleTrack, scan: LaserScan) -> None:
        """Extend the trajectory of a vehicle whose motion its scans show to a new scan."""
        laser = self._team.laser_pose(scan)
        queue = track.sweeps.of(scan.sensor)
        new = NewScan(scan, queue.judge.known_sweep(scan), queue.newest_end, laser)
        for motion in track.source.cover(new, track.odometry, track.matcher):
            self._add_motion(track, motion)

    def _add_motion(self, track: VehicleTrack, motion: Motion) -> None:
        reading = motion.reading
        before, restarts = track.odometry.last, track.odometry.restarts
        resets = track.odometry.resets
        if not len(track.odometry):
            track.placement.check_first_reading(reading.pose)
        if track.odometry.clock_jumps_back(reading):
            self._add_keyframe_here(track)  # the motion until now has stamps of the old clock
        if not track.odometry.add(reading, motion.step):
            track.count('late_odometry')
            return
        reckoned = track.source.reckoned(reading)
        track.sweeps.add_odometry(reckoned, jumped=track.odometry.resets != resets)
        if track.odometry.restarts != restarts:
            track.placement.displace()
            self.belief.displace(track.name, DISPLACED)
        if reading.stamp < before:
            self._restart_clock(track)
        self.now = max(self.now, reading.stamp)
        track.last_heard = self.now
        if track.keyframe is None:
            self._team.add_keyframe(track, reading.stamp)
        self._process(track)

    def _restart_clock(self, track: VehicleTrack) -> None:
        """Continue at the new time of a vehicle whose clock jumped back."""
        track.restart_clock()
        self.belief.restart_clock(track.name)
        self.now = track.odometry.last

    def _process(self, track: VehicleTrack) -> None:
        """Deskew and match the scans and process the measurements that odometry has reached."""
        release_sweeps(self._team, track)
        while (scan := track.next_to_match()) is not None:
            if track.keyframe is None or scan.stamp >= track.keyframe.stamp:
                laser = self._team.laser_pose(scan)
                bodies = self._team.discs(track, scan)
                refine_by_scan(track, scan, laser, self.config.slam, bodies)
        timeout = self.config.scan_matching.scan_wait_timeout
        while (measurement := track.next_ready(timeout)) is not None:
            kind_of(measurement).process(self._team, track, measurement)

    # -- estimates out -------------------------------------------------------------------------

    @property
    def vehicles(self) -> list[str]:
        """Names of the vehicles."""
        return list(self.tracks)

    def track(self, vehicle: str) -> VehicleTrack:
        """Return the track of a vehicle; AgentError if there is none of this name."""
        return self._team.track(vehicle)

    @property
    def tracks(self) -> dict[str, VehicleTrack]:
        """Odometry, newest keyframe and plan of every vehicle."""
        return self._team.tracks

    @property
    def belief(self) -> TeamBelief:
        """The filter."""
        return self._team.belief

    @property
    def loops(self) -> LoopClosing:
        """Scans attached to keyframes, and the closures found with them."""
        return self._team.loops

    @property
    def tags(self) -> TagMapping:
        """Tags in the map, and what they tie together."""
        return self._team.tags

    @property
    def laser_map(self) -> LaserMap:
        """All mapped scans, and the grid as it was drawn last."""
        return self._team.laser_map

    @property
    def obstacle_map(self) -> ObstacleMap:
        """All mapped views of obstacles, and the layer as it was drawn last."""
        return self._team.obstacle_map

    def take_views(self, vehicle: str) -> list[ObstacleView]:
        """Return the newest view of obstacles of each camera of a vehicle, each once."""
        track = self.track(vehicle)
        taken, track.new_views = track.new_views, {}
        return list(taken.values())

    @property
    def grid(self) -> OccupancyGrid:
        """The occupancy grid with the obstacles of the cameras, along the most likely path."""
        path, in_map = self.belief.best_path(), self.belief.keyframes_in_map()
        self.laser_map.redraw(path, in_map)
        if not len(self.obstacle_map):
            return self.laser_map.grid
        self.obstacle_map.redraw(path, in_map)
        drawn = (self._team, self.laser_map.revision, self.obstacle_map.revision)
        if self._merged is None or self._merged[0] != drawn:
            merged = with_obstacles(self.laser_map.grid, self.obstacle_map.layer)
            self._merged = (drawn, merged)
        return self._merged[1]

    def looked_at(self, grid: OccupancyGrid) -> NDArray[np.bool_] | None:
        """Return through which cells (H, W) of `grid` cameras have looked; None without any."""
        return cells_looked_at(grid, self.obstacle_map.layer) if len(self.obstacle_map) else None

    @property
    def no_returns(self) -> dict[str, tuple[float, bool]]:
        """Vehicle -> share of its beams without return (+inf), and whether they free cells."""
        return self.laser_map.no_returns

    def take_events(self) -> list[KeyframeEvent]:
        """Return the keyframes since the last call."""
        events, self._team.events = self._team.events, []
        return events

    def take_joins(self) -> list[Join]:
        """Return the vehicles that have been joined to the map since the last call."""
        return self._team.loops.take_joins()

    def is_in_map(self, vehicle: str) -> bool:
        """Return whether the poses of a vehicle are in the map, not in a frame of its own."""
        self.track(vehicle)
        return self.belief.is_in_map(vehicle)

    def home(self, vehicle: str) -> Pose2:
        """Return the pose in the map where a vehicle started, as known now."""
        known = self.start_poses[vehicle]
        if known is not None and not self._team.tags.frame_is_surveyed:
            return known
        _, poses = self.trajectory(vehicle)
        return Pose2.from_array(poses[0]) if len(poses) else IDENTITY

    def estimate(self, vehicle: str) -> tuple[Pose2, Array]:
        """Return mean pose and covariance (3, 3) of a vehicle at its newest odometry."""
        track = self.track(vehicle)
        motion = self._team.motion_since_keyframe(track, track.odometry.last)
        pose, covariance = compound(*self.belief.estimate(vehicle), *motion)
        white = track.odometry.white_at(track.odometry.last)
        if white is not None and track.keyframe and track.odometry.last > track.keyframe.stamp:
            covariance = covariance + rotated(white, -pose.theta)
        return pose, covariance

    def map_pose(self, vehicle: str) -> Pose2:
        """Return the pose of a vehicle relative to the grid: the end of the most likely path."""
        track = self.track(vehicle)
        return self._team.pose_at(track, track.odometry.last)

    def known_places(self, vehicle: str, reach: float) -> tuple[KnownPlace, ...]:
        """Return the places within a reach (m) of a vehicle at which it may close a loop."""
        track = self.track(vehicle)
        if track.keyframe is None:
            return ()
        places = self.loops.known_places(self.belief, vehicle, reach)
        return tuple(KnownPlace((x, y), deviation) for x, y, deviation in places)

    def trajectory(self, vehicle: str) -> tuple[Array, Array]:
        """Return stamps (T,) and poses (T, 3) of the keyframes on the most likely path."""
        self.track(vehicle)
        return self.belief.trajectory(vehicle)

    def landmarks(self) -> Landmarks:
        """Return the landmarks of the best particle."""
        return self.belief.landmarks()

    def statuses(self) -> list[VehicleStatus]:
        """Return pose, state and goal of every vehicle."""
        return [self._status(track) for track in self.tracks.values()]

    def summary(self) -> dict[str, Any]:
        """Return counts of processed and discarded records, per vehicle."""
        return {
            name: {**track.counts, 'odometry_resets': track.odometry.resets}
            for name, track in self.tracks.items()
        }

    def odometry_sources(self) -> dict[str, dict[str, float | str]]:
        """Return per vehicle what its odometry is measured by, and what is known of the sensor."""
        return {
            name: {'source': track.source.name, **track.source.report(), **track.slip.report()}
            for name, track in self.tracks.items()
        }

    def found_sweeps(self) -> dict[str, dict[str, Sweep]]:
        """Return vehicle -> laser -> when its beams are measured, where its scans have shown it.

        The only laser of a vehicle is ''.
        """
        return {name: track.sweeps.found() for name, track in self.tracks.items()}

    def odometry_calibrations(self) -> dict[str, OdometryCalibration]:
        """Return the estimated calibration of the wheel odometry of every vehicle."""
        return {
            name: OdometryCalibration.of(*self.belief.odometry_calibration(name))
            for name in self.tracks
        }

    def _status(self, track: VehicleTrack) -> VehicleStatus:
        pose, covariance = self.estimate(track.name)
        deviation = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 0.0))
        state = track.state
        if track.last_heard < self.now - self.config.inputs.silent_timeout:
            state = VehicleState.SILENT
        elif not self.belief.is_in_map(track.name):
            state = VehicleState.UNLOCALIZED
        elif track.placement.displaced or deviation > self.config.inputs.lost_deviation:
            state = VehicleState.LOST
        goal = track.plan.goal if track.plan is not None and len(track.plan.waypoints) else None
        return VehicleStatus(self.now, track.name, state, pose, covariance, goal)

    # -- files ---------------------------------------------------------------------------------

    def save_state(self, path: Path) -> Path:
        """Write filter and scans to a file for load_state; return its path."""
        for track in self.tracks.values():
            self._add_keyframe_here(track)
        team = self._team
        saved = checkpoint.Saved(
            team.belief, team.laser_map, team.obstacle_map, team.loops, team.tags
        )
        checkpoint.save(path, saved)
        return path

    def _add_keyframe_here(self, track: VehicleTrack) -> None:
        """Add a keyframe at the newest odometry of a vehicle, unless there is one."""
        if track.keyframe is not None and track.odometry.last > track.keyframe.stamp:
            self._team.predict(track, track.odometry.last)
            self._team.add_keyframe(track, track.odometry.last)

    def load_state(self, path: Path) -> None:
        """Continue from a saved state of the same vehicles; AgentError changes nothing."""
        saved = checkpoint.load(path, self.config, self.camera_scans)
        belief = saved.belief
        if set(belief.vehicles) != set(self.start_poses):
            raise AgentError(
                f'{path} is of vehicles {sorted(belief.vehicles)}, '
                f'expected {sorted(self.start_poses)}'
            )
        known = {
            name: self.estimate(name)[0] for name, track in self.tracks.items() if track.keyframe
        }
        self.reset()
        self._team.belief, self._team.loops, self._team.tags = belief, saved.loops, saved.tags
        self._team.laser_map, self._team.obstacle_map = saved.laser_map, saved.obstacle_map
        self._merged = None
        for vehicle in self.tracks:
            belief.restart_clock(vehicle)
            loaded = belief.estimate(vehicle)[0]
            self.track(vehicle).placement.check_loaded_pose(known.get(vehicle), loaded)

    def save_map(self, base: Path) -> Path:
        """Write base.pgm and base.yaml for nav2's map_server; return the path of the YAML file."""
        return save_map(self.grid, base)


def _motions(track: VehicleTrack, record: OdometryReading | ImuReading) -> list[Motion]:
    """Return what a reading of the wheels, or of the IMU, extends the trajectory by."""
    if isinstance(record, OdometryReading):
        track.count('unused_odometry', int(track.source.needs_scans))
        return track.source.add_odometry(record)
    track.count('unused_imu', int(not track.source.uses_imu))
    return track.source.add_imu(record)
