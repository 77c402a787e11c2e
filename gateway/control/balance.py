"""The drive law of a robot that stands on its wheels alone: it balances, and drives as it leans.

How this works
--------------
Another law says how the wheels turn for a motion of the body; this one says at which speed along x they have to roll so
that it stays upright (`gateway.control.pendulum`): PD of the pitch, PI of the speed, fed back positively, about the
speed and the lean of the setpoint. No motion is aimed at that leaves the wheels too little room for it, and where
they have none left all the same, the other axes yield. Encoders
tell how the wheels turn against the body, which turns itself: what is told and what is measured differ from rolling by
the pitch rate. An emergency stop brings the setpoint to zero within the limits, not at once: a robot that balances
cannot stop faster than it can lean back.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from gateway.control.drive_law import COAST, DriveLaw, Features, JointCommand, Measured, Motion
from gateway.control.limits import Ground
from gateway.control.pendulum import Standing
from gateway.control.posture import Posture
from gateway.kinematics.contract import Kinematics, desaturate
from gateway.types import Attitude, Event, Facts, Level, Rates, Region

SWAY: Final = 0.1  # m/s at which a robot that balances on one spot may still roll
LEAN_TIME: Final = 0.1  # s in which the lean of a new acceleration is taken up
_LOST: Final = Event(Level.ERROR, "balance_lost", "a motor is lost, and it will fall: take hold of it")


class BalancingLaw:
    """State owner. `wheels`: how they turn for a motion; `acceleration`: m/s^2 along x, of a stop too."""

    def __init__(
        self,
        wheels: DriveLaw,
        kinematics: Kinematics,
        posture: Posture,
        standing: Standing,
        *,
        acceleration: float,
        top_speeds: Sequence[float],
        torques: Sequence[float],
        period: float,
    ) -> None:
        self._wheels = wheels
        self._kinematics = kinematics
        self._posture = posture
        self._gains = standing.gains
        self._body = standing.body
        self._radius = standing.radius
        self._acceleration = acceleration
        reserve = standing.reserve(acceleration) / standing.radius
        self._commanded = tuple([top - reserve for top in top_speeds])
        self._top_speeds = tuple(top_speeds)
        self._torques = tuple(torques)
        # Where it leans by `catch` against a push or a slope, and stands: no further away it is led back the harder.
        self._farthest = standing.gains.pitch * standing.catch / standing.gains.position  # m
        self._taken_up = period / (period + LEAN_TIME)
        self._coasts = (COAST,) * len(self._top_speeds)
        self._reference = 0.0  # m/s, of the setpoint in the cycle before
        self._lean = 0.0  # rad, of the setpoint
        self._speed = 0.0  # m/s along x over the ground
        self._ahead = 0.0  # m of the way that it is before its setpoint
        self._told = 0.0  # m/s along x, as the wheels were told to roll
        self._whole = True  # as of the cycle before

    @property
    def facts(self) -> Facts:
        """Those of the wheels, how it stands and leans, and whether it can stay upright: four axes need four wheels."""
        attitude = self._posture.attitude
        pitch = None if attitude is None else attitude.pitch
        whole = self._posture.whole
        return {**self._wheels.facts, "stance": self._posture.stance.value, "pitch": pitch, "can_balance": whole}

    @property
    def features(self) -> Features:
        """Those of the wheels."""
        return self._wheels.features

    @property
    def posture(self) -> Posture | None:
        """How it stands."""
        return self._posture

    @property
    def unready(self) -> str | None:
        """What the wheels wait for, or why it is not to stand up."""
        return self._wheels.unready or self._posture.objection()

    def width_rate(self, width: float) -> float:
        """As the wheels."""
        return self._wheels.width_rate(width)

    @property
    def settings(self) -> Mapping[str, float]:
        """Those of the wheels."""
        return self._wheels.settings

    def set(self, name: str, value: float) -> str | None:
        """One of the wheels."""
        return self._wheels.set(name, value)

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """As the wheels, and as slow as leaves them room to outrun it."""
        target = self._wheels.aim(target, measured, region=region, path_rate=path_rate, whole=whole)
        speeds = self._kinematics.wheel_speeds(target, ())
        share = 1.0 if speeds is None else desaturate(speeds, self._commanded)
        return target if share == 1.0 else tuple([share * axis for axis in target])

    def ground(self, *, whole: bool) -> Ground | None:
        """It does not know."""
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Upright on the way to this setpoint; nothing while it is down."""
        return self._driven(setpoint, measured, braking=braking, path_rate=path_rate)

    def stop(self, measured: Measured) -> Motion:
        """Upright on the shortest way to rest, and at rest."""
        most = self._acceleration * measured.dt
        reference = self._reference - max(-most, min(most, self._reference))
        size = len(self._kinematics.axes) - 1
        return self._driven((reference, *(0.0,) * size), measured, braking=True, path_rate=None)

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when it stays where it is, swaying a little."""
        attitude = self._posture.attitude
        if not (turning and self._posture.stands) or attitude is None:
            return turning
        rolling = (attitude.pitch_rate or 0.0) * self._radius
        most = max([abs(speed * self._radius + rolling) for speed in measured.speeds if speed is not None])
        return most > SWAY

    def may_release(self, measured: Measured) -> bool:
        """Only down."""
        return not self._posture.stands

    def forget_told(self) -> None:
        """It begins anew, where it is."""
        self._reference = self._lean = self._speed = self._ahead = self._told = 0.0
        self._wheels.forget_told()

    def _driven(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None) -> Motion:
        attitude = self._posture.attitude
        if attitude is None or not self._posture.stands:
            self.forget_told()
            down = self._wheels.motion((0.0,) * len(setpoint), measured, braking=braking)
            return Motion(self._coasts, numbers=(*down.numbers, None), events=down.events)
        self._told = self._balanced(setpoint, attitude, measured)
        rolled = self._told - self._radius * (attitude.pitch_rate or 0.0)
        rest, share = self._beside(rolled, setpoint)
        motion = self._wheels.motion((rolled, *rest), measured, braking=braking, path_rate=path_rate)
        commands = motion.commands if self._posture.strength == 1.0 else self._weakened(motion.commands)
        limits = motion.limits if share == 1.0 else (*motion.limits, "balance")
        return Motion(commands, share, limits, (*motion.numbers, self._told), (*motion.events, *self._warned()))

    def _warned(self) -> tuple[Event, ...]:
        """That a motor is lost, once; what is left of the wheels goes on as well as it can."""
        before, self._whole = self._whole, self._posture.whole
        return (_LOST,) if before and not self._whole else ()

    def _balanced(self, setpoint: Rates, attitude: Attitude, measured: Measured) -> float:
        """M/s along x by which it stays upright on the way to this speed, and in this turn.

        Turning while it goes sideways is an acceleration along x, for which it has to lean: -wz vy.
        """
        reference, sideways, wz = setpoint[0], setpoint[1], setpoint[2]
        gains, dt = self._gains, measured.dt
        turning = attitude.pitch_rate or 0.0
        if measured.estimate is not None:
            self._speed = measured.estimate.twist.vx + self._radius * turning
        change = (reference - self._reference) / dt if dt > 0.0 else 0.0
        wanted = self._body.lean(change - wz * sideways)
        self._lean += self._taken_up * (wanted - self._lean)
        self._reference = reference
        self._ahead = max(-self._farthest, min(self._farthest, self._ahead + (self._speed - reference) * dt))
        return (
            reference
            + gains.pitch * (attitude.pitch - self._lean)
            + gains.pitch_rate * turning
            + gains.velocity * (self._speed - reference)
            + gains.position * self._ahead
        )

    def _beside(self, rolled: float, setpoint: Rates) -> tuple[Rates, float]:
        """The other axes with what the wheels have left beside rolling, and which share that is."""
        rest = setpoint[1:]
        base = self._kinematics.wheel_speeds((rolled, *(0.0,) * len(rest)), ())
        added = self._kinematics.wheel_speeds((0.0, *rest), ())
        if base is None or added is None:
            return rest, 1.0
        whole = desaturate(base, self._top_speeds)
        share = 1.0
        for speed, more, top in zip(base, added, self._top_speeds):
            left = max(top - whole * speed, 0.0) if more > 0.0 else max(top + whole * speed, 0.0)
            if abs(more) * share > left:
                share = left / abs(more)
        return (rest, 1.0) if share == 1.0 else (tuple([share * axis for axis in rest]), share)

    def _weakened(self, commands: Sequence[JointCommand]) -> tuple[JointCommand, ...]:
        strength = self._posture.strength
        return tuple(
            [
                JointCommand(command.kind, command.value, feed_forward=command.feed_forward, limit=strength * torque)
                for command, torque in zip(commands, self._torques)
            ]
        )
