"""From the setpoint of the body to what every joint is told: what a drive law says, and the law of speeds.

How this works
--------------
The core decides whether and how fast the body may move; the law of the chassis decides how its joints do that. It gets
the setpoint within the body's limits and everything measured, and answers with one command per joint, at the output,
and with what of the setpoint is really driven. Which joints may be commanded at all is not its business.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple, Protocol

from drivers.setpoint import CommandKind, Setpoint
from gateway.control.limits import Ground, excess
from gateway.control.posture import Posture
from gateway.kinematics.contract import Estimate, Kinematics, desaturate
from gateway.types import Attitude, Event, Facts, Rates, Region, TwistCommand

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_VELOCITY: Final = CommandKind.VELOCITY
_TOO_FAST: Final = ("motor_speed",)


class Measured(NamedTuple):
    """Everything measured in one cycle, at the outputs and in the order of the robot file; None is unknown."""

    now_ns: int
    dt: float  # s since the cycle before
    speeds: tuple[float | None, ...]  # rad/s
    positions: tuple[float | None, ...]  # rad from the joint's zero
    torques: tuple[float | None, ...]  # N m
    ages_ns: tuple[int | None, ...]  # of speed and position
    angles: tuple[float | None, ...] = ()  # positions that are trusted, for the geometry
    estimate: Estimate | None = None  # motion of the body, and what of the wheels it does not explain
    slipping: bool = False
    heading: float | None = None  # rad, as a gyro tells it: from any zero, wrapped or not
    attitude: Attitude | None = None
    ranges: tuple[float | None, ...] = ()  # m
    torque_ages_ns: tuple[int | None, ...] = ()  # of the torques: many are told more seldom than speed


class JointCommand(Setpoint):
    """Setpoint of one joint at its output: rad/s, N m or V by kind; 0.0 for coast and brake.

    `feed_forward`: N m that a speed loop adds; `limit`: N m that it may use at most (None: what the joint can). Which
    of these a joint obeys is in its capabilities (`gateway.core.assembly.Robot`); a limit bounds a torque anywhere.
    """


COAST: Final = JointCommand(CommandKind.COAST)
BRAKE: Final = JointCommand(CommandKind.BRAKE)


class Motion:
    """What the joints are told. Nobody changes it; no named tuple, see `Setpoint`.

    `share`: of the setpoint that is driven, 0 to 1; `limits`: those at work, by name; `numbers`: of the channels that
    only this kind of chassis has; `events`: what it has to say in this cycle; `turned`: rad, counter-clockwise, from
    the setpoint's direction to that of a manoeuvre that is driven instead.
    """

    __slots__ = ("commands", "events", "limits", "numbers", "share", "turned")

    def __init__(
        self,
        commands: tuple[JointCommand, ...],
        share: float = 1.0,
        limits: tuple[str, ...] = (),
        numbers: tuple[float | None, ...] = (),
        events: tuple[Event, ...] = (),
        *,
        turned: float = 0.0,
    ) -> None:
        self.commands: Final = commands
        self.share: Final = share
        self.limits: Final = limits
        self.numbers: Final = numbers
        self.events: Final = events
        self.turned: Final = turned

    def limited_by(self, limits: tuple[str, ...]) -> "Motion":
        """The same, with these limits at work before its own."""
        if not limits:
            return self
        together = (*limits, *self.limits)
        return Motion(self.commands, self.share, together, self.numbers, self.events, turned=self.turned)


class Features(NamedTuple):
    """What of a command a chassis can do besides its twist; what it cannot is refused and moves nothing."""

    width: bool = False  # the wheels can go apart
    widths: tuple[float, float] | None = None  # m, from and to which, where it knows
    regions: frozenset[Region] = frozenset({Region.ANY})
    more_regions: str = ""  # what the robot file has to say for others, where anything helps
    grip: bool = False  # it knows what the floor gives

    @property
    def choices(self) -> bool:
        """Whether `aim` has anything to say."""
        return self.width or len(self.regions) > 1

    def objection(self, command: TwistCommand) -> str | None:
        """Why this command is none for this chassis; None: it is one."""
        if command.width_rate is not None and not self.width:
            return f"width_rate = {command.width_rate:g}: must be left out: the width of this chassis is fixed"
        if command.width is not None and self.widths is None:
            return f"width = {command.width:g}: must be left out: the width of this chassis is fixed, or not known"
        if command.width is not None and self.widths is not None:
            narrowest, widest = self.widths
            if not narrowest <= command.width <= widest:
                return f"width = {command.width:g}: must be from {narrowest:g} to {widest:g} m on this robot"
        if command.region not in self.regions:
            known = " or ".join(repr(region.value) for region in Region if region in self.regions)
            return f"region = {command.region.value!r}: must be {known} on this chassis{self.more_regions}"
        return None


class DriveLaw(Protocol):
    """How one kind of chassis moves as the setpoint says, and what stop and rest are for it. State owner.

    In each cycle one of `motion` and `stop` is called, once. What neither may command is decided elsewhere.
    """

    @property
    def facts(self) -> Facts:
        """What `state` tells of this kind of chassis, of the cycle that was driven or stopped last; keys of its own.

        Asked where a status is made and not in each cycle: what it takes to put it together belongs in here.
        """
        ...

    @property
    def features(self) -> Features:
        """What it can do besides twists; the same for ever."""
        ...

    @property
    def posture(self) -> Posture | None:
        """How it stands, of a robot that would fall when it is let go; None: it stands by itself. The same for ever."""
        ...

    @property
    def settings(self) -> Mapping[str, float]:
        """What of it may be set while it drives (`gateway.core.settings`), as it is at the start."""
        ...

    def set(self, name: str, value: float) -> str | None:
        """Take a new value of one of these, within its range and without a step; why not, if not."""
        ...

    @property
    def unready(self) -> str | None:
        """What it has to know before anything may be driven, in words; None: nothing. Asked of a released robot."""
        ...

    def width_rate(self, width: float) -> float:
        """Rate, m/s, at which to go to this width (m). Only of a law that knows its widths; before `aim`."""
        ...

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """What of a target may be driven towards now: all of it, less, or nothing yet.

        Of a law whose features leave a choice, asked before the limits of the body, in each cycle that drives, and
        before `motion`. `region`: the way round that the command asks for; `whole`: every motor is well.
        """
        ...

    def ground(self, *, whole: bool) -> Ground | None:
        """What the floor gives; None: everything, as far as is known.

        Only of a law that knows (`Features.grip`): asked in every cycle that drives or brakes, before `motion`.
        `whole`: every motor obeys.
        """
        ...

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Commands for this setpoint, whatever is known. `braking`: the setpoint is on its way to rest.

        `path_rate`: rad/s by which the commander says that the direction of its path turns; None: it does not say.
        """
        ...

    def stop(self, measured: Measured) -> Motion:
        """Commands of an emergency stop: the shortest way to rest, and rest. The setpoint is zero at once."""
        ...

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """Whether it moves more than it does at rest; None: not known. `turning`: whether any measured wheel turns."""
        ...

    def may_release(self, measured: Measured) -> bool:
        """Whether a robot at rest may be let go: not one that would fall. Asked in every mode, shutdown included."""
        ...

    def forget_told(self) -> None:
        """The joints were let go since they were told anything: what they are told next does not go on from it."""
        ...


TWISTS: Final = Features()


class SpeedLaw:
    """Every joint at the speed that the kinematics has for it, all slowed alike where one cannot go so fast.

    While an angle that the kinematics needs is unknown the joints keep the proportion they last had, and slow down as
    the setpoint does; once that has begun on the way to rest it stays so, because an angle that comes back is a step.
    """

    def __init__(self, kinematics: Kinematics, *, top_speeds: Sequence[float], velocity: Rates, period: float) -> None:
        self._kinematics = kinematics
        self._top_speeds = tuple(top_speeds)
        self._velocity = velocity  # limits of the body
        self.period: Final = period  # s, of the loop
        self._features = Features(width="width_rate" in kinematics.axes)
        self._brakes = Motion((BRAKE,) * len(self._top_speeds))
        self._blind = False
        self._ramp: tuple[float, list[float]] = (0.0, [0.0] * len(self._top_speeds))  # last setpoint known in speeds

    @property
    def facts(self) -> Facts:
        """Nothing."""
        return {}

    @property
    def features(self) -> Features:
        """What the axes of the chassis let it do."""
        return self._features

    @property
    def posture(self) -> Posture | None:
        """It stands by itself."""
        return None

    @property
    def settings(self) -> Mapping[str, float]:
        """Nothing."""
        return {}

    def set(self, name: str, value: float) -> str | None:
        """There is nothing to set."""
        return f"{name}: this chassis has no such setting"

    @property
    def unready(self) -> str | None:
        """Nothing."""
        return None

    def width_rate(self, width: float) -> float:
        """It knows no width."""
        return 0.0

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """All of it."""
        return target

    def ground(self, *, whole: bool) -> Ground | None:
        """It does not know."""
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Commands for this setpoint."""
        return self.motion_at(setpoint, self.angles_ahead(measured), braking=braking)

    def motion_at(self, setpoint: Rates, angles: Sequence[float | None], *, braking: bool) -> Motion:
        """The same with the steered joints at these angles, rad."""
        speeds, share = self.speeds_at(setpoint, angles, braking=braking)
        return Motion(_velocities(speeds), share, () if share == 1.0 else _TOO_FAST)

    def speeds_at(self, setpoint: Rates, angles: Sequence[float | None], *, braking: bool) -> tuple[list[float], float]:
        """Rad/s of every joint, and which share of the setpoint that is."""
        self._blind = self._blind and braking
        speeds = None if self._blind else self._kinematics.wheel_speeds(setpoint, angles)
        if speeds is None:
            self._blind = braking
            return self._in_proportion(setpoint), 1.0
        share = desaturate(speeds, self._top_speeds)
        if share < 1.0:
            setpoint = tuple([axis * share for axis in setpoint])
            speeds = [speed * share for speed in speeds]
        self._ramp = excess(setpoint, self._velocity), speeds
        return speeds, share

    def stop(self, measured: Measured) -> Motion:
        """Every joint braked."""
        self._blind = False
        return self._brakes

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when its wheels do."""
        return turning

    def may_release(self, measured: Measured) -> bool:
        """It stands by itself."""
        return True

    def forget_told(self) -> None:
        """It goes by the setpoint alone."""

    def angles_ahead(self, measured: Measured) -> Sequence[float | None]:
        """Angles of the steered joints as they will be when the motors turn as commanded: a period from now."""
        if not self._kinematics.steered:
            return measured.angles
        angles = list(measured.angles)
        for index in self._kinematics.steered:
            angle, speed, age_ns = angles[index], measured.speeds[index], measured.ages_ns[index]
            if angle is not None and speed is not None and age_ns is not None:
                angles[index] = angle + speed * (age_ns * 1e-9 + self.period)
        return angles

    def _in_proportion(self, setpoint: Rates) -> list[float]:
        """The last speeds known, all in the proportion in which the setpoint fell."""
        size, speeds = self._ramp
        factor = excess(setpoint, self._velocity) / size if size > 0.0 else 0.0
        return [speed * min(factor, 1.0) for speed in speeds]


def _velocities(speeds: Sequence[float]) -> tuple[JointCommand, ...]:
    return tuple([JointCommand(_VELOCITY, speed) for speed in speeds])
