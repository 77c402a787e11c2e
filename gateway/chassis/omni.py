"""n omni wheels at arbitrary poses (Rojas 2005, sections 3-4 and 9, generalised to any wheel position and radius).

How this works
--------------
A wheel at p with its axle at angle a drives along d = (-sin a, cos a). Its rim speed is d . (v + w x p), one row of
the rim matrix; everything else follows from the rows. No matrix is typed in: the printed pseudo-inverse of the paper
is wrong.
"""

from collections.abc import Sequence
from math import pi, sqrt
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

from pydantic import Field

from gateway.arithmetic import angle_of, sin_cos
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
from gateway.control.drive_law import DriveLaw, SpeedLaw
from gateway.control.grip import Grip, Push
from gateway.control.launch import LEAST_FRICTION, MOST_FRICTION, LaunchLaw
from gateway.control.launch_slip import Losses
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix, diagonal
from gateway.kinematics.undriven import doubt
from gateway.sections import Angle, Body, Length, Metres, Name, Positive, Section, Unit
from gateway.types import PLANAR, Rates

_INWARD: Final = 0.1  # of the reach: a lever below it is none


class WheelPose(NamedTuple):
    """Contact point (m), axle angle counter-clockwise from forward (rad), rolling radius (m)."""

    x: float
    y: float
    axis_angle: float
    radius: float


def omni_kinematics(wheels: Sequence[WheelPose]) -> FixedWheels:
    """Kinematics of these wheels. Raises GeometryError unless they have three distinct directions."""
    return FixedWheels([_rim_row(wheel) for wheel in wheels], [wheel.radius for wheel in wheels])


def _rim_row(wheel: WheelPose) -> tuple[float, float, float]:
    sine, cosine = sin_cos(wheel.axis_angle)
    return -sine, cosine, cosine * wheel.x + sine * wheel.y


class OmniWheel(Section):
    """Pose of one omni wheel: contact point, angle of the axle (outward), rolling radius.

    `roller_mass`: of the roller that touches the floor, kg; used by the simulated world alone, which guesses otherwise.
    """

    motor: Annotated[Name, Field(description="name of its [[motor]]")]
    x: Annotated[Metres, Field(description="of its point on the floor, forward of the middle")]
    y: Annotated[Metres, Field(description="of its point on the floor, to the left of the middle")]
    axis_angle: Annotated[
        Angle,
        Field(
            description="of its axle, pointing outward, counter-clockwise from forward; a wheel that turns positively "
            "drives to the left of it, as seen from above"
        ),
    ]
    radius: Annotated[Length, Field(description="from the axle to the floor")]
    roller_mass: Annotated[
        Positive | None,
        Field(description="of the roller that touches the floor; for the simulated world alone, which guesses else"),
        Unit("kg"),
    ] = None


class GripConfig(Section):
    """What the floor gives a wheel: a launch accelerates as hard as that lets it, and no harder."""

    friction: Annotated[
        float,
        Field(ge=LEAST_FRICTION, le=MOST_FRICTION, description="of the rollers on the floor"),
        Unit("of the load"),
    ]


class OmniRobot(Section):
    """n omni wheels at arbitrary poses."""

    GEOMETRY: ClassVar[str] = "each wheel's x, y, axis_angle and radius"
    AXES: ClassVar[tuple[str, ...]] = PLANAR
    SIDEWAYS: ClassVar[Sideways] = ALIKE

    kind: Annotated[Literal["omni"], Field(description=KIND)]
    name: Annotated[Name, Field(description=NAME)]
    body: Annotated[Body, Field(description=BODY)]
    wheel: Annotated[list[OmniWheel], Field(min_length=3, max_length=16, description="one for each wheel")]
    saturation: Annotated[Saturation, Field(description=SATURATION)] = Saturation.BOTH
    grip: Annotated[GripConfig | None, Field(description="launches by what the floor gives; else they are ramps")] = (
        None
    )

    def motor_names(self) -> tuple[str, ...]:
        """Motors of the chassis in wheel order."""
        return tuple(wheel.motor for wheel in self.wheel)

    def kinematics(self) -> FixedWheels:
        """From the poses of the wheels."""
        try:
            return omni_kinematics(self._poses())
        except GeometryError as error:
            raise GeometryError(f"{error}{self._meant()}") from None

    def doubts(self) -> tuple[str, ...]:
        """A motion that is hardly driven, and axles that point inward."""
        hardly = doubt(self.kinematics().rim_matrix, self._reach())
        found = [] if hardly is None else [f"robot.wheel: {hardly}{self._meant()}"]
        inward = [
            wheel.motor
            for wheel, (*_, lever) in zip(self.wheel, self.kinematics().rim_matrix, strict=True)
            if lever < -_INWARD * self._reach()
        ]
        if inward:
            found.append(
                f"robot.wheel: axis_angle of {' and '.join(inward)} points inward: turned positively, such a wheel "
                "turns the robot clockwise. It is meant to be that of the axle pointing outward"
            )
        return tuple(found)

    def _poses(self) -> list[WheelPose]:
        return [WheelPose(wheel.x, wheel.y, wheel.axis_angle, wheel.radius) for wheel in self.wheel]

    def _reach(self) -> float:
        """How far the farthest wheel is from the middle, m."""
        return max(sqrt(wheel.x * wheel.x + wheel.y * wheel.y) for wheel in self.wheel)

    def _meant(self) -> str:
        """What axles would be that point outward from the middle; nothing where that is no better."""
        outward = [pose._replace(axis_angle=angle_of(pose.y, pose.x)) for pose in self._poses()]
        try:
            rows = omni_kinematics(outward).rim_matrix
        except GeometryError:
            return ""
        if doubt(rows, self._reach()) is not None:
            return ""
        angles = ", ".join(
            f"{pose.axis_angle:.4g} ({wheel.motor})" for pose, wheel in zip(outward, self.wheel, strict=True)
        )
        return f". axis_angle is that of the axle, outward; from the middle through each wheel it would be {angles}"

    def trailing(self) -> None:
        """It does not."""

    def channels(self) -> tuple[ChassisChannels, ...]:
        """None of its own."""
        return ()

    def law(self, parts: LawParts) -> DriveLaw:
        """Every wheel at its speed, and no harder than it grips where the robot file says how that is."""
        speeds = SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)
        if self.grip is None:
            return speeds
        body = self.body
        losses = Losses(body.joint_inertia, body.joint_friction, body.joint_drag)
        return LaunchLaw(
            speeds,
            grip=self.ground(
                [
                    losses.push(pusher.torque, wheel.radius)
                    for pusher, wheel in zip(parts.pushers, self.wheel, strict=True)
                ]
            ),
            friction=self.grip.friction,
            radii=[wheel.radius for wheel in self.wheel],
            losses=losses,
            acceleration=parts.acceleration,
            top_speeds=parts.top_speeds,
            pushers=parts.pushers,
        )

    def ground(self, pushes: Sequence[Push] = ()) -> Grip:
        """What the floor gives the wheels; `pushes`: what their motors have for it, empty: more than that."""
        body = self.body
        return Grip(
            self.kinematics().rim_matrix,
            [(wheel.x, wheel.y) for wheel in self.wheel],
            mass=body.mass,
            inertia=body.inertia,
            height=body.centre_height or 0.0,
            pushes=pushes,
        )

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """One rigid body."""
        return diagonal(self.masses())

    def masses(self) -> Rates:
        """The whole body."""
        return (self.body.mass, self.body.mass, self.body.inertia)

    def drawing(self) -> Drawing:
        """A wheel rolls at right angles to its axle."""
        return Drawing(
            reach=self._reach(),
            wheels=tuple(DrawnWheel(wheel.x, wheel.y, wheel.axis_angle + pi / 2, wheel.radius) for wheel in self.wheel),
            rollers=True,
        )

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()
