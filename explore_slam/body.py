"""How large and how fast a vehicle is, and what it sees: settings for all that use them."""

import math
from dataclasses import dataclass

from explore_slam.data import STANDARD_CLEARANCE, STANDARD_RADIUS, VehicleBody
from explore_slam.settings import Section, setting


@dataclass(frozen=True)
class BodyConfig(Section):
    """Size, speed and clearance of a vehicle; agent and path follower must agree on them."""

    vehicle_radius: float = setting(
        STANDARD_RADIUS,
        'Radius of the circle around the vehicle origin that contains the body',
        unit='m',
        low=0.05,
        high=2.0,
        tier='basic',
    )
    follow_speed: float = setting(
        VehicleBody().speed,
        'Speed along the plan without obstacles',
        unit='m/s',
        low=0.02,
        high=1.5,
        tier='basic',
    )

    side_clearance: float = setting(
        STANDARD_CLEARANCE,
        'Clearance beside the body that the path follower requires, and the planner with it',
        unit='m',
        low=0.0,
        high=1.0,
    )

    @property
    def record(self) -> VehicleBody:
        """Size and speed as a record."""
        return VehicleBody(self.vehicle_radius, self.follow_speed, self.side_clearance)


@dataclass(frozen=True)
class ViewConfig(Section):
    """What the laser of a vehicle sees, where it differs from that of others in the team."""

    vehicle_sensor_range: float = setting(
        0.0,
        'Range that the laser of the vehicle is expected to cover, for the choice of targets; 0: '
        'sensor_range',
        unit='m',
        low=0.0,
        high=100.0,
    )
    vehicle_field_of_view: float = setting(
        math.pi,
        'Field of view of its laser, symmetric about the direction of travel, for the choice of '
        'targets',
        unit='rad',
        low=0.05,
        high=2.0 * math.pi,
    )

    def of(self, body: VehicleBody) -> VehicleBody:
        """Return a body with this view."""
        return body._replace(
            sensor_range=self.vehicle_sensor_range or None,
            field_of_view=self.vehicle_field_of_view,
        )
