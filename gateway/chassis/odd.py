"""Four mecanum wheels in line whose two pairs go apart while driving, on ball casters (ODD, arXiv 2407.10127)."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from gateway.chassis.contract import (
    BODY,
    KIND,
    NAME,
    ChassisChannels,
    Drawing,
    DrawnLength,
    DrawnWheel,
    LawParts,
    LoopLimit,
    Sideways,
)
from gateway.control.balance import BalancingLaw
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import DriveLaw, SpeedLaw
from gateway.control.odd_law import RATE, TURNING, OddLaw, Yields
from gateway.control.pendulum import BalanceError, BalanceGains, Standing, objection, pendulum, unfit
from gateway.control.posture import Posture
from gateway.control.steering import Steering, SteeringGains
from gateway.kinematics.linear import Matrix
from gateway.kinematics.odd import AXES, WHEELS, OddGeometry, OddKinematics
from gateway.sections import Angle, Body, Length, Name, Section, Unit
from gateway.types import Rates

# Wheels in line push beside each other along the line and behind one another across it, where what they do not share
# alike turns the body (the paper, section VI). Of the position: its ends of two circles on casters, 2.67 and 2.42 cm
# off, the first of them sideways. Of the heading it prints no figure: twice the deviation, chosen by us until measured.
SIDEWAYS: Final = Sideways(position=2.67 * 2.67 / (2.42 * 2.42), heading=4.0)


class Balance(Section):
    """A robot that stands on its wheels alone: its body as a pendulum over their axle, gains, and how far it may lean.

    What the gains are for is in `gateway.control.pendulum`. `lag`: by which the wheels follow, `delay`: by which what
    is known of the pitch is old; both at worst.
    """

    height: Annotated[float, Field(ge=0.01, le=5.0, description="of the centre of mass above the axle"), Unit("m")]
    pitch_inertia: Annotated[
        float, Field(gt=0.0, le=1000.0, description="of the body about its centre of mass"), Unit("kg m^2")
    ]
    pitch: Annotated[float, Field(gt=0.0, le=100.0, description="gain of the pitch"), Unit("m/s per rad")]
    pitch_rate: Annotated[float, Field(gt=0.0, le=100.0, description="gain of the pitch rate"), Unit("m per rad")]
    velocity: Annotated[float, Field(ge=0.0, le=100.0, description="gain of the speed, fed back positively")]
    position: Annotated[
        float, Field(ge=0.0, le=100.0, description="gain of the place, fed back positively"), Unit("1/s")
    ]
    catch: Annotated[float, Field(ge=0.02, le=0.5, description="lean from which it stands up at most"), Unit("rad")] = (
        0.12
    )
    fall: Annotated[float, Field(ge=0.1, le=1.2, description="lean beyond which it lets go"), Unit("rad")] = 0.6
    lag: Annotated[float, Field(ge=0.001, le=0.2, description="by which the wheels follow, at worst"), Unit("s")] = 0.02
    delay: Annotated[
        float, Field(ge=0.0, le=0.2, description="by which what is known of the pitch is old, at worst"), Unit("s")
    ] = 0.01

    def gains(self) -> BalanceGains:
        """For the law."""
        return BalanceGains(self.pitch, self.pitch_rate, self.velocity, self.position)


class SteeringConfig(Section):
    """PD of the yaw, by the yaw rate of an IMU (`gateway.control.steering`). `lag`: by which it follows at worst."""

    yaw: Annotated[float, Field(gt=0.0, le=100.0, description="gain of the turn that is missing"), Unit("1/s")]
    yaw_rate: Annotated[float, Field(ge=0.0, le=10.0, description="gain of the turning speed that is missing")] = 0.0
    lag: Annotated[float, Field(ge=0.001, le=1.0, description="by which the turn follows, at worst"), Unit("s")] = 0.05

    @model_validator(mode="after")
    def _does_not_swing(self) -> Self:
        problem = self.gains().objection(self.lag)
        if problem is not None:
            raise ValueError(problem)
        return self

    def gains(self) -> SteeringGains:
        """For the law."""
        return SteeringGains(self.yaw, self.yaw_rate)


class OddRobot(Section):
    """Pairs of wheels in line around the middle, `spacing` apart within a pair, the pairs `width` apart at the start.

    `roller_angles` and `wheels`: from left to right. `width_sensor`: which of the sensors of kind range tells the
    width, from 0. `yields`: what gives way where the wheels cannot turn for all of a command.
    """

    GEOMETRY: ClassVar[str] = "radius, spacing, narrowest, widest, width and roller_angles"
    AXES: ClassVar[tuple[str, ...]] = AXES
    SIDEWAYS: ClassVar[Sideways] = SIDEWAYS
    saturation: ClassVar[Saturation] = Saturation.BOTH  # what yields is said otherwise

    kind: Annotated[Literal["odd"], Field(description=KIND)]
    name: Annotated[Name, Field(description=NAME)]
    body: Annotated[Body, Field(description=BODY)]
    radius: Annotated[Length, Field(description="of the wheels, from the axle to the floor")]
    spacing: Annotated[Length, Field(description="between the two wheels of a pair")]
    narrowest: Annotated[Length, Field(description="least distance of the two pairs that is driven to")]
    widest: Annotated[Length, Field(description="largest distance of the two pairs that is driven to")]
    width: Annotated[Length, Field(description="distance of the two pairs at the start, where no sensor tells it")]
    roller_angles: Annotated[
        tuple[Angle, Angle, Angle, Angle],
        Field(description="of each wheel, left to right: the axis of the roller on the floor, from forward"),
    ]
    wheels: Annotated[tuple[Name, Name, Name, Name], Field(description="names of their motors, from left to right")]
    yields: Annotated[Yields, Field(description="what gives way where the wheels cannot turn for all of a command")] = (
        Yields.ALL
    )
    width_sensor: Annotated[
        Literal[0, 1, 2, 3] | None,
        Field(description="which [[sensor]] of kind range, from 0, tells the width; left out: the wheels alone do"),
    ] = None
    steering: Annotated[SteeringConfig | None, Field(description="makes up for turn that an IMU sees missing")] = None
    balance: Annotated[Balance | None, Field(description="for a robot that stands on its wheels alone")] = None

    @model_validator(mode="after")
    def _stays_upright(self) -> Self:
        if self.balance is None:
            return self
        problem = objection(self.balance.gains(), self._standing(self.balance).body)
        if problem is None and self.balance.catch >= self.balance.fall:
            problem = f"catch = {self.balance.catch:g}: must be below fall, {self.balance.fall:g}"
        if problem is not None:
            raise ValueError(f"balance.{problem}")
        return self

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

    def doubts(self) -> tuple[str, ...]:
        """A motion that is hardly driven at one end of the range."""
        found = self.kinematics().geometry.doubt()
        return () if found is None else (f"robot.roller_angles: {found}",)

    def trailing(self) -> None:
        """It does not."""

    def channels(self) -> tuple[ChassisChannels, ...]:
        """Its width, the one that is asked for, and how its wheels roll to keep it upright."""
        width = ChassisChannels("width", ("width", "width_wanted"), "m", "Width [m]", lambda numbers: numbers[:2])
        if self.balance is None:
            return (width,)
        told = ChassisChannels("balance", ("rolled",), "m/s", "Rolled to balance [m/s]", lambda numbers: numbers[2:3])
        return width, told

    def law(self, parts: LawParts) -> DriveLaw:
        """Every wheel at its speed, within the range of the width; upright, if nothing else keeps it so."""
        kinematics = parts.kinematics
        if not isinstance(kinematics, OddKinematics):
            message = "kinematics of another chassis"
            raise TypeError(message)
        law = OddLaw(
            kinematics,
            wheels=SpeedLaw(kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period),
            top_speeds=parts.top_speeds,
            top_rate=parts.velocity[RATE],
            acceleration=parts.acceleration[RATE],
            lateness=parts.acceleration[RATE] / parts.jerk[RATE] + parts.delay + parts.period,
            yields=self.yields,
            place=self.width_sensor,
            steering=self._steering(parts),
        )
        return law if self.balance is None else self._balancing(self.balance, law, parts)

    def _steering(self, parts: LawParts) -> Steering | None:
        if self.steering is None:
            return None
        return Steering(self.steering.gains(), top=parts.velocity[TURNING], acceleration=parts.acceleration[TURNING])

    def _balancing(self, balance: Balance, wheels: OddLaw, parts: LawParts) -> BalancingLaw:
        standing = self._standing(balance)
        torques = [pusher.torque for pusher in parts.pushers]
        problem = unfit(
            standing,
            speed=parts.velocity[0],
            acceleration=parts.acceleration[0],
            wheel_speed=min(parts.top_speeds),
            push=WHEELS * min(torques) / self.radius,
            period=parts.period,
            delay=parts.delay,
        )
        if problem is not None:
            raise BalanceError(problem)
        return BalancingLaw(
            wheels,
            parts.kinematics,
            Posture(catch=balance.catch, fall=balance.fall),
            standing,
            acceleration=parts.acceleration[0],
            top_speeds=parts.top_speeds,
            torques=torques,
            period=parts.period,
        )

    def _standing(self, balance: Balance) -> Standing:
        body = pendulum(
            mass=self.body.mass,
            height=balance.height,
            pitch_inertia=balance.pitch_inertia,
            radius=self.radius,
        )
        return Standing(balance.gains(), body, self.radius, self.body.mass, balance.catch, balance.lag, balance.delay)

    def inertia(self, angles: Sequence[float]) -> Matrix:
        """Two equal halves on slides, at the width of the start."""
        masses = self.masses()
        return tuple(tuple(mass if row == at else 0.0 for at in range(4)) for row, mass in enumerate(masses))

    def masses(self) -> Rates:
        """The whole body; of the width a quarter, as each half goes by half of it."""
        return (self.body.mass, self.body.mass, self.body.inertia, 0.25 * self.body.mass)

    def drawing(self) -> Drawing:
        """At the width of the start, with the widths that it can have behind it."""
        outer_left, inner_left, *others = self.kinematics().geometry.places(self.width)
        widths = (("narrowest", self.narrowest), ("width", self.width), ("widest", self.widest))
        rows = [-self.radius * (1.9 + 0.65 * place) for place in range(len(widths))]
        return Drawing(
            outer_left,
            tuple(DrawnWheel(0.0, place, 0.0, self.radius) for place in (outer_left, inner_left, *others)),
            rollers=True,
            lengths=tuple(
                DrawnLength(key, (row, 0.5 * length), (row, -0.5 * length))
                for row, (key, length) in zip(rows, widths, strict=True)
            ),
        )

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        """Nothing."""
        return ()
