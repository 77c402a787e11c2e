"""n mecanum wheels that all roll forward, anywhere on the body; most often four in a rectangle."""

from collections.abc import Sequence
from math import sqrt
from typing import Annotated, ClassVar, Literal

from pydantic import Field

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
from gateway.kinematics.linear import Matrix
from gateway.kinematics.mecanum import MecanumWheel, mecanum_kinematics
from gateway.sections import Angle, Body, Length, Metres, Name, Section
from gateway.types import PLANAR, Rates


class MecanumPose(Section):
    """Contact point of one wheel, axis of the roller that touches the floor (from forward), rolling radius."""

    motor: Annotated[Name, Field(description="name of its [[motor]]")]
    x: Annotated[Metres, Field(description="of its point on the floor, forward of the middle")]
    y: Annotated[Metres, Field(description="of its point on the floor, to the left of the middle")]
    roller_angle: Annotated[
        Angle, Field(description="of the axis of the roller that touches the floor, counter-clockwise from forward")
    ]
    radius: Annotated[Length, Field(description="from the axle to the floor")]


class MecanumRobot(Section):
    """n mecanum wheels that roll forward."""

    GEOMETRY: ClassVar[str] = "each wheel's x, y, roller_angle and radius"
    AXES: ClassVar[tuple[str, ...]] = PLANAR
    SIDEWAYS: ClassVar[Sideways] = ALIKE

    kind: Annotated[Literal["mecanum"], Field(description=KIND)]
    name: Annotated[Name, Field(description=NAME)]
    body: Annotated[Body, Field(description=BODY)]
    wheel: Annotated[list[MecanumPose], Field(min_length=3, max_length=16, description="one for each wheel")]
    saturation: Annotated[Saturation, Field(description=SATURATION)] = Saturation.BOTH

    def motor_names(self) -> tuple[str, ...]:
        """Motors of the chassis in wheel order."""
        return tuple(wheel.motor for wheel in self.wheel)

    def kinematics(self) -> FixedWheels:
        """From the poses of the wheels."""
        return mecanum_kinematics(
            [MecanumWheel(wheel.x, wheel.y, wheel.roller_angle, wheel.radius) for wheel in self.wheel]
        )

    def trailing(self) -> None:
        """It does not."""

    def channels(self) -> tuple[ChassisChannels, ...]:
        """None of its own."""
        return ()

    def law(self, parts: LawParts) -> SpeedLaw:
        """Every wheel at its speed."""
        return SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """One rigid body."""
        mass = self.body.mass
        return (mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, self.body.inertia)

    def masses(self) -> Rates:
        """The whole body."""
        return (self.body.mass, self.body.mass, self.body.inertia)

    def drawing(self) -> Drawing:
        """All wheels roll forward."""
        return Drawing(
            reach=max(sqrt(wheel.x * wheel.x + wheel.y * wheel.y) for wheel in self.wheel),
            wheels=tuple(DrawnWheel(wheel.x, wheel.y, 0.0, wheel.radius) for wheel in self.wheel),
            rollers=True,
        )

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()
