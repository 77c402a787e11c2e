"""n mecanum wheels that all roll forward, anywhere on the body; most often four in a rectangle."""

from collections.abc import Sequence
from math import copysign, pi, remainder, sqrt
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field

from gateway.arithmetic import dot
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
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix
from gateway.kinematics.mecanum import MecanumWheel, mecanum_kinematics
from gateway.kinematics.undriven import doubt
from gateway.sections import Angle, Body, Length, Metres, Name, Section
from gateway.types import PLANAR, Rates

_SLANTS: Final = (0.1, 1.4)  # rad: rollers that are rollers
_AS_GOOD: Final = 0.99  # of the force of the other: not worth a word


class MecanumPose(Section):
    """Contact point of one wheel, axis of the roller that touches the floor (from forward), rolling radius."""

    motor: Annotated[Name, Field(description="name of its [[motor]]")]
    x: Annotated[Metres, Field(description="of its point on the floor, forward of the middle")]
    y: Annotated[Metres, Field(description="of its point on the floor, to the left of the middle")]
    roller_angle: Annotated[
        Angle,
        Field(
            description="of the axis of the roller that touches the floor, counter-clockwise from forward (on top of "
            "the wheel, seen from above, it lies mirrored); a wheel that turns positively rolls forward"
        ),
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
        try:
            return mecanum_kinematics(self._poses())
        except GeometryError as error:
            raise GeometryError(f"{error}{self._meant()}") from None

    def doubts(self) -> tuple[str, ...]:
        """A motion that is hardly driven, and rollers that turn it with less force than mirrored ones would."""
        hardly, meant = doubt(self.kinematics().rim_matrix, self._reach()), self._meant()
        if hardly is not None:
            return (f"robot.wheel: {hardly}{meant}",)
        share = _turning(self._poses()) / _turning(self._crossed()) if meant else 1.0
        if share < _AS_GOOD:
            return (f"robot.wheel: its wheels turn it with {share:.0%} of the force that they could have{meant}",)
        return ()

    def _poses(self) -> list[MecanumWheel]:
        return [MecanumWheel(wheel.x, wheel.y, wheel.roller_angle, wheel.radius) for wheel in self.wheel]

    def _reach(self) -> float:
        """How far the farthest wheel is from the middle, m."""
        return max(sqrt(wheel.x * wheel.x + wheel.y * wheel.y) for wheel in self.wheel)

    def _crossed(self) -> list[MecanumWheel]:
        """The same with rollers that make an X on top of the wheels; wheels between the corners keep theirs."""
        return [
            pose
            if pose.x * pose.y == 0.0
            else pose._replace(roller_angle=copysign(_slant(pose.roller_angle), -pose.x * pose.y))
            for pose in self._poses()
        ]

    def _meant(self) -> str:
        """The rollers of an X, which most robots have; nothing where that is no better."""
        crossed = self._crossed()
        try:
            rows = mecanum_kinematics(crossed).rim_matrix
        except GeometryError:
            return ""
        if crossed == self._poses() or doubt(rows, self._reach()) is not None:
            return ""
        turned = {wheel.motor: pose.roller_angle for wheel, pose in zip(self.wheel, crossed, strict=True)}
        right = [motor for motor, angle in turned.items() if angle < 0.0]
        left = [motor for motor, angle in turned.items() if angle > 0.0]
        if not (right and left):
            return ""
        return (
            f". Rollers of {' and '.join(right)} must go one way (roller_angle = {turned[right[0]]:.4g}), those of "
            f"{' and '.join(left)} the other ({turned[left[0]]:.4g}): on top of the wheels, seen from above, they make "
            "an X"
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
            reach=self._reach(),
            wheels=tuple(DrawnWheel(wheel.x, wheel.y, 0.0, wheel.radius) for wheel in self.wheel),
            rollers=True,
        )

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()


def _slant(angle: float) -> float:
    """Of a roller, whichever way it goes; the usual one where it has none."""
    slant = abs(remainder(angle, pi))
    return slant if _SLANTS[0] <= slant <= _SLANTS[1] else 0.25 * pi


def _turning(wheels: Sequence[MecanumWheel]) -> float:
    """Lever of all wheels together, m."""
    levers = [lever for *_, lever in mecanum_kinematics(wheels).rim_matrix]
    return sqrt(dot(levers, levers))
