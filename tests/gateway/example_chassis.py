"""A chassis that is not one of ours, which the documentation shows: three omni wheels, told by two lengths.

It has nothing but what every chassis must have, and is driven by `test_example_chassis.py`.
"""

from collections.abc import Sequence
from math import pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from gateway.arithmetic import sin_cos
from gateway.chassis.contract import (
    ALIKE,
    BODY,
    KIND,
    NAME,
    SATURATION,
    ChassisChannels,
    Drawing,
    DrawnWheel,
    LawParts,
    LoopLimit,
    Sideways,
)
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import SpeedLaw
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix, diagonal
from gateway.sections import Body, Length, Name, Section
from gateway.types import PLANAR, Rates, Twist
from replay.sim.plants.rigid_body import Chassis, RigidBody

ANGLES = (pi / 3, pi, -pi / 3)  # of the axles, from forward: the robot drives on two wheels ahead and one behind


class KiwiRobot(Section):
    """`reach`: from the middle to where the wheels touch the floor, `radius`: of the wheels, m."""

    GEOMETRY: ClassVar[str] = "reach and radius"
    AXES: ClassVar[tuple[str, ...]] = PLANAR
    SIDEWAYS: ClassVar[Sideways] = ALIKE

    kind: Annotated[Literal["kiwi"], Field(description=KIND)]
    name: Annotated[Name, Field(description=NAME)]
    body: Annotated[Body, Field(description=BODY)]
    reach: Annotated[Length, Field(description="from the middle to where the wheels touch the floor")]
    radius: Annotated[Length, Field(description="of the wheels")]
    wheels: Annotated[tuple[Name, Name, Name], Field(description="motors: left, rear, right")]
    saturation: Annotated[Saturation, Field(description=SATURATION)] = Saturation.BOTH

    def motor_names(self) -> tuple[str, ...]:
        """Left, rear, right."""
        return self.wheels

    def rows(self) -> list[tuple[float, float, float]]:
        """The speed of each rim per m/s forward, m/s to the left and rad/s: all of the geometry, once."""
        return [(-sine, cosine, self.reach) for sine, cosine in map(sin_cos, ANGLES)]

    def kinematics(self) -> FixedWheels:
        """Both directions, from the rows."""
        return FixedWheels(self.rows(), [self.radius] * len(ANGLES))

    def law(self, parts: LawParts) -> SpeedLaw:
        """Every wheel at its speed."""
        return SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)

    def masses(self) -> Rates:
        """The whole body."""
        return (self.body.mass, self.body.mass, self.body.inertia)

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """One rigid body."""
        return diagonal(self.masses())

    def drawing(self) -> Drawing:
        """Wheels roll at right angles to their axles."""
        places = [(self.reach * cosine, self.reach * sine) for sine, cosine in map(sin_cos, ANGLES)]
        wheels = [DrawnWheel(x, y, angle + pi / 2, self.radius) for (x, y), angle in zip(places, ANGLES, strict=True)]
        return Drawing(reach=self.reach, wheels=tuple(wheels))

    def trailing(self) -> None:
        """It does not."""

    def channels(self) -> tuple[ChassisChannels, ...]:
        """None of its own."""
        return ()

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()


def plant(robot: KiwiRobot) -> RigidBody:
    """How it moves in the simulation: one rigid body on its wheels."""
    return RigidBody(robot.body, lambda body: _moving(robot, body))


def _moving(robot: KiwiRobot, body: Body) -> Chassis:
    mass, radius = body.mass, robot.radius
    return Chassis(
        body=body,
        rows=tuple((x / radius, y / radius, turn / radius) for x, y, turn in robot.rows()),
        wheel_radii=(radius,) * len(ANGLES),
        load_shares=(1.0 / len(ANGLES),) * len(ANGLES),
        mass=((mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, body.inertia)),
        across=1.0,
        gyroscopic=lambda u: (mass * u[2] * u[1], -mass * u[2] * u[0], 0.0),
        body_twist=lambda u, _: Twist(*u),
        chassis_angle=lambda heading, _: heading,
    )
