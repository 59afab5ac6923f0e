"""The rendered simulator without ROS: advances vehicles tick by tick, returns sensor records."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np

from explore_slam.data import Intrinsics, OdometryReading
from explore_slam.errors import SimulationError
from explore_slam.geometry import Pose2
from explore_slam.simulation.config import SimulationConfig
from explore_slam.simulation.records import Collision, Record, SimEvent, TruePose
from explore_slam.simulation.rendered.base import DifferentialDrive
from explore_slam.simulation.rendered.contacts import Contacts
from explore_slam.simulation.rendered.kinect import KinectSensor, camera_intrinsics
from explore_slam.simulation.rendered.laser import LaserScanner, TimedPose
from explore_slam.simulation.rendered.model import build_model
from explore_slam.simulation.rendered.mujoco_import import mujoco
from explore_slam.simulation.rendered.renderer import Renderer
from explore_slam.simulation.wheel_odometry import WheelOdometry
from explore_slam.simulation.worlds.loading import load_world
from explore_slam.simulation.worlds.world import World

CONTACT_RELEASE = 0.01  # m of clearance after which a new contact is a new collision
MODALITIES = 3  # odometry, laser, camera: one random stream each per vehicle


@dataclass
class _Schedule:
    """When a sensor is due: rate (Hz; 0 is never) and time of the first reading (s)."""

    rate: float
    first: float
    taken: int = 0

    def due(self, now: float) -> bool:
        """Return whether a reading is due, and count it as taken."""
        if self.rate <= 0.0 or now + 1e-9 < self.first + self.taken / self.rate:
            return False
        # at most one reading per step, however high the rate
        self.taken = max(self.taken + 1, math.floor((now + 1e-9 - self.first) * self.rate) + 1)
        return True


@dataclass
class _Vehicle:
    """One simulated vehicle.

    before: its pose before the last time step. touching: the obstacle in contact, '' for none.
    """

    name: str
    pose: Pose2
    before: Pose2
    drive: DifferentialDrive
    odometry: WheelOdometry
    laser: LaserScanner
    kinect: KinectSensor | None
    schedules: dict[str, _Schedule]
    touching: str = ''


@dataclass
class _Log:
    """Collisions since the start, and their number per vehicle."""

    collisions: list[Collision] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)


class Simulator:
    """Simulated vehicles in a world; equal seeds and commands give equal records.

    Use it from one thread (OpenGL). Call close() at the end, or use it as a context manager.
    """

    def __init__(
        self,
        world: World | Path | str,
        vehicles: dict[str, Pose2] | None = None,
        config: SimulationConfig | None = None,
        seed: int = 0,
    ) -> None:
        """Place vehicles at their start poses.

        world: a world, or the path of a world file or map_server map.
        vehicles: name -> start pose in the world; default: those suggested by the world.
        Raises SimulationError for poses that are not free.
        """
        self.config = config or SimulationConfig()
        self.world = world if isinstance(world, World) else load_world(world)
        starts = dict(self.world.starts if vehicles is None else vehicles)
        if not starts:
            raise SimulationError(
                f'world {self.world.name!r} suggests no start poses and none were given'
            )
        base = self.config.base
        self._contacts = Contacts(self.world, base.simulated_radius, base.simulated_height)
        self._contacts.check_poses(starts)
        self._rendered = build_model(self.world, list(starts), self.config)
        self._model = self._rendered.model
        self._data = mujoco.MjData(self._model)
        self._vehicles = self._make_vehicles(starts, seed)
        self._log = _Log(counts=dict.fromkeys(starts, 0))
        self._ticks = 0
        self._renderer: Renderer | None = None
        if self.config.kinect.simulated_camera_rate > 0.0:
            self._renderer = Renderer(self._rendered)

    # -- state ----------------------------------------------------------------------------------

    @property
    def vehicles(self) -> list[str]:
        """Names of the vehicles in the order of their start poses."""
        return list(self._vehicles)

    @property
    def time(self) -> float:
        """Simulated time (s) since the start."""
        return self._ticks / self.config.tick_rate

    @property
    def intrinsics(self) -> Intrinsics:
        """Pinhole parameters of the cameras."""
        return camera_intrinsics(self.config.kinect)

    @property
    def collisions(self) -> dict[str, int]:
        """Number of collisions of each vehicle."""
        return dict(self._log.counts)

    @property
    def collision_log(self) -> list[Collision]:
        """All collisions in the order of their time."""
        return list(self._log.collisions)

    def true_pose(self, vehicle: str) -> Pose2:
        """Return the true pose of a vehicle in the world."""
        return self._find(vehicle).pose

    def velocity(self, vehicle: str) -> tuple[float, float]:
        """Return the true speed (m/s) and turn rate (rad/s) of a vehicle."""
        drive = self._find(vehicle).drive
        return drive.linear, drive.angular

    def set_velocity(self, vehicle: str, linear: float, angular: float) -> None:
        """Command speed (m/s) and turn rate (rad/s), valid until the next command."""
        if not (math.isfinite(linear) and math.isfinite(angular)):
            raise SimulationError(
                f'{vehicle}: velocity command is ({linear}, {angular}), expected finite m/s, rad/s'
            )
        self._find(vehicle).drive.command(linear, angular)

    def place(self, vehicle: str, pose: Pose2) -> None:
        """Move a vehicle to another pose without odometry (kidnapped robot)."""
        others = {v.name: v.pose for v in self._vehicles.values() if v.name != vehicle}
        moved = self._find(vehicle)
        self._contacts.check_poses({**others, vehicle: pose})
        moved.pose = moved.before = pose
        moved.touching = ''

    def step(self) -> list[SimEvent]:
        """Advance by one tick; return the records of its sensors in a fixed order."""
        self._ticks += 1
        seconds = 1.0 / self.config.tick_rate
        for vehicle in self._vehicles.values():
            self._drive(vehicle, seconds)
        events: list[SimEvent] = []
        placed = False
        for vehicle in self._vehicles.values():
            due = {name for name, plan in vehicle.schedules.items() if plan.due(self.time)}
            if 'laser' in due and self.config.laser.simulated_sweep_time > 0.0:
                vehicle.laser.begin(self.time)
            if vehicle.laser.is_sweeping:
                due.add('laser')
            if due & {'laser', 'kinect'} and not placed:
                self._place_bodies()
                placed = True
            events += [SimEvent(self.time, vehicle.name, r) for r in self._measure(vehicle, due)]
        return events

    def close(self) -> None:
        """Free the renderer; further calls have no effect."""
        if self._renderer is not None:
            self._renderer.close()

    def __enter__(self) -> 'Simulator':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # -- set-up ---------------------------------------------------------------------------------

    def _find(self, vehicle: str) -> _Vehicle:
        try:
            return self._vehicles[vehicle]
        except KeyError:
            raise SimulationError(
                f'there is no vehicle {vehicle!r}, only {list(self._vehicles)}'
            ) from None

    def _make_vehicles(self, starts: dict[str, Pose2], seed: int) -> dict[str, _Vehicle]:
        config, made = self.config, {}
        seeds = np.random.SeedSequence(seed).spawn(MODALITIES * len(starts))
        for index, (name, pose) in enumerate(starts.items()):
            own = seeds[MODALITIES * index : MODALITIES * (index + 1)]
            rngs = [np.random.default_rng(s) for s in own]
            # the cameras are staggered, which spreads the load of rendering
            camera_rate = config.kinect.simulated_camera_rate
            shift = index / (len(starts) * camera_rate) if camera_rate > 0.0 else 0.0
            made[name] = _Vehicle(
                name,
                pose,
                pose,
                DifferentialDrive(config.base),
                WheelOdometry(config.odometry, rngs[0]),
                LaserScanner(
                    config.laser, config.laser_mount, int(self._model.body(name).id), rngs[1]
                ),
                KinectSensor(config.kinect, rngs[2]) if camera_rate > 0.0 else None,
                {
                    'odometry': _Schedule(config.odometry.simulated_odometry_rate, 0.0),
                    'laser': _Schedule(config.laser.simulated_scan_rate, 0.0),
                    'kinect': _Schedule(camera_rate, shift),
                },
            )
        return made

    # -- one step -------------------------------------------------------------------------------

    def _drive(self, vehicle: _Vehicle, seconds: float) -> None:
        """Move a vehicle over a time step, up to the next obstacle; rotation is never blocked."""
        increment = vehicle.drive.advance(seconds)
        if increment.x != 0.0 or increment.y != 0.0:
            increment = self._free_part(vehicle, increment)
        vehicle.before, vehicle.pose = vehicle.pose, vehicle.pose.compose(increment)
        vehicle.odometry.move(increment)

    def _free_part(self, vehicle: _Vehicle, increment: Pose2) -> Pose2:
        """Return the free part of an increment; record a collision if there is a new one."""
        others = {v.name: v.pose for v in self._vehicles.values() if v is not vehicle}
        wanted = vehicle.pose.compose(increment)
        obstacle = self._contacts.obstacle_between(vehicle.pose, wanted, others)
        if not obstacle:
            if vehicle.touching and self._contacts.clearance(wanted, others) > CONTACT_RELEASE:
                vehicle.touching = ''
            return increment
        if vehicle.touching != obstacle:
            self._log.counts[vehicle.name] += 1
            self._log.collisions.append(Collision(self.time, vehicle.name, obstacle))
        vehicle.touching = obstacle
        vehicle.drive.stall()
        return self._contacts.shortened(vehicle.pose, increment, others)

    def _place_bodies(self) -> None:
        """Set the poses of all bodies and cameras in MuJoCo."""
        for index, vehicle in enumerate(self._vehicles.values()):
            half = 0.5 * vehicle.pose.theta
            self._data.mocap_pos[index] = (vehicle.pose.x, vehicle.pose.y, 0.0)
            self._data.mocap_quat[index] = (math.cos(half), 0.0, 0.0, math.sin(half))
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _measure(self, vehicle: _Vehicle, due: set[str]) -> list[Record]:
        """Return the records of the sensors that are due."""
        now, records = self.time, list[Record]()
        if 'odometry' in due:
            odometry, drive = vehicle.odometry, vehicle.drive
            records.append(OdometryReading(now, odometry.pose, odometry.covariance))
            records.append(TruePose(now, vehicle.pose, drive.linear, drive.angular))
        if vehicle.laser.is_sweeping:
            before = TimedPose(now - 1.0 / self.config.tick_rate, vehicle.before)
            step = before, TimedPose(now, vehicle.pose)
            scan = vehicle.laser.advance(*step, self._rendered, self._data)
            if scan is not None:
                records.append(scan)
        elif 'laser' in due:
            records.append(vehicle.laser.measure(now, vehicle.pose, self._rendered, self._data))
        if 'kinect' in due and self._renderer is not None and vehicle.kinect is not None:
            camera = list(self._vehicles).index(vehicle.name)
            images = self._renderer.render(self._data, camera)
            records.append(vehicle.kinect.measure(now, *images, vehicle.drive.angular))
        return records
