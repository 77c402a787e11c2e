"""Four mecanum wheels in line whose two pairs go apart while driving, on ball casters (ODD, arXiv 2407.10127)."""

from collections.abc import Sequence
from typing import ClassVar, Final, Literal

from gateway.chassis.contract import ChassisChannels, Drawing, DrawnWheel, LawParts, LoopLimit, Sideways
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import SpeedLaw
from gateway.control.odd_law import RATE, OddLaw, Yields
from gateway.kinematics.linear import Matrix
from gateway.kinematics.odd import AXES, OddGeometry, OddKinematics
from gateway.sections import Angle, Body, Length, Name, Section
from gateway.types import Rates

# Wheels in line push beside each other along the line and behind one another across it, where what they do not share
# alike turns the body (the paper, section VI). Of the position: its ends of two circles on casters, 2.67 and 2.42 cm
# off, the first of them sideways. Of the heading it prints no figure: twice the deviation, chosen by us until measured.
SIDEWAYS: Final = Sideways(position=2.67 * 2.67 / (2.42 * 2.42), heading=4.0)


class OddRobot(Section):
    """Pairs of wheels in line around the middle, `spacing` apart within a pair, the pairs `width` apart at the start.

    `roller_angles` and `wheels`: from left to right. `width_sensor`: which of the sensors of kind range tells the
    width, from 0. `yields`: what gives way where the wheels cannot turn for all of a command.
    """

    GEOMETRY: ClassVar[str] = "radius, spacing, narrowest, widest, width and roller_angles"
    AXES: ClassVar[tuple[str, ...]] = AXES
    SIDEWAYS: ClassVar[Sideways] = SIDEWAYS
    saturation: ClassVar[Saturation] = Saturation.BOTH  # what yields is said otherwise

    kind: Literal["odd"]
    name: Name
    body: Body
    radius: Length
    spacing: Length
    narrowest: Length
    widest: Length
    width: Length
    roller_angles: tuple[Angle, Angle, Angle, Angle]
    wheels: tuple[Name, Name, Name, Name]
    yields: Yields = Yields.ALL
    width_sensor: Literal[0, 1, 2, 3] | None = None

    def motor_names(self) -> tuple[str, ...]:
        """Wheels from left to right."""
        return self.wheels

    def kinematics(self) -> OddKinematics:
        """At the width of the start."""
        geometry = OddGeometry(
            self.roller_angles,
            radius=self.radius,
            spacing=self.spacing,
            narrowest=self.narrowest,
            widest=self.widest,
        )
        return OddKinematics(geometry, start=self.width)

    def trailing(self) -> None:
        """It does not."""

    def channels(self) -> tuple[ChassisChannels, ...]:
        """Its width, and the one that is asked for."""
        return (ChassisChannels("width", ("width", "width_wanted"), "m", "Width [m]", lambda numbers: numbers[:2]),)

    def law(self, parts: LawParts) -> OddLaw:
        """Every wheel at its speed, within the range of the width."""
        kinematics = parts.kinematics
        if not isinstance(kinematics, OddKinematics):
            message = "kinematics of another chassis"
            raise TypeError(message)
        return OddLaw(
            kinematics,
            wheels=SpeedLaw(kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period),
            top_speeds=parts.top_speeds,
            top_rate=parts.velocity[RATE],
            acceleration=parts.acceleration[RATE],
            lateness=parts.acceleration[RATE] / parts.jerk[RATE] + parts.delay + parts.period,
            yields=self.yields,
            place=self.width_sensor,
        )

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """Two equal halves on slides, at the width of the start."""
        masses = self.masses()
        return tuple(tuple(mass if row == at else 0.0 for at in range(4)) for row, mass in enumerate(masses))

    def masses(self) -> Rates:
        """The whole body; of the width a quarter, as each half goes by half of it."""
        return (self.body.mass, self.body.mass, self.body.inertia, 0.25 * self.body.mass)

    def drawing(self) -> Drawing:
        """At the width of the start."""
        places = self.kinematics().geometry.places(self.width)
        return Drawing(places[0], tuple(DrawnWheel(0.0, place, 0.0, self.radius) for place in places))

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()
