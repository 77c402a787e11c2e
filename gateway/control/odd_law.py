"""The drive law of a chassis whose wheels go apart: where the range of its width ends, and what yields to what.

How this works
--------------
The width is that of `gateway.control.odd_width`, which also says how freely it may change. Near an end of the range no
rate outward is aimed at that half the acceleration of the width could not stop in time, and none is driven that all of
it could not. A width that is commanded is gone to at a rate in proportion to what is missing, and just as softly: a
cascade over the loop of the rate, whose gain follows from how late the rate follows. What the wheels cannot turn at
once yields as the robot file says: the width, the motion, or all in proportion; what exceeds them still, on its way
from one setpoint to another, is scaled as a whole. Where a gyro is to steer it, wheels are told what makes it turn so.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from math import sqrt
from typing import Final

from gateway.control.drive_law import Features, Measured, Motion, SpeedLaw
from gateway.control.limits import Ground
from gateway.control.odd_width import CORRECTION, GATE, WidthEstimate
from gateway.control.posture import Posture
from gateway.control.steering import Steering
from gateway.kinematics.contract import desaturate
from gateway.kinematics.odd import OddKinematics
from gateway.types import Event, Facts, Rates, Region

TURNING: Final = 2  # place of it among the axes
RATE: Final = 3  # place of the width's rate among the axes
EARLY: Final = 0.5  # of the acceleration, with which an aim ends at the range: the rest is for jerk and lateness
DAMPING: Final = 0.25  # gain of the width times the lateness of its rate: k / (s (1 + T s)) is critically damped at 1/4


class Yields(Enum):
    """What gives way where the wheels cannot turn for all of a command."""

    ALL = "all"
    WIDTH = "width"
    MOTION = "motion"


class OddLaw:
    """State owner. `place`: of the sensor of the width among those of kind range, None: there is none.

    `top_rate` and `acceleration` of the width, m/s and m/s^2; `lateness`: s by which its rate follows a command.
    """

    def __init__(  # noqa: PLR0913 - what it is put together from, by name
        self,
        kinematics: OddKinematics,
        *,
        wheels: SpeedLaw,
        top_speeds: Sequence[float],
        top_rate: float,
        acceleration: float,
        lateness: float,
        yields: Yields,
        place: int | None,
        steering: Steering | None = None,
    ) -> None:
        self._kinematics = kinematics
        self._wheels = wheels
        self._top_speeds = tuple(top_speeds)
        self._acceleration = acceleration  # m/s^2 of the width
        self._yields = yields
        self._place = place
        self._steering = steering
        geometry = kinematics.geometry
        self._features = Features(width=True, widths=(geometry.narrowest, geometry.widest))
        self._gain = DAMPING / lateness
        self._top_rate = top_rate
        self._width = kinematics.width
        self._known = WidthEstimate(
            self._width.metres,
            narrowest=geometry.narrowest,
            widest=geometry.widest,
            gate=GATE + top_rate / CORRECTION,
            sensed=place is not None,
        )
        self._wanted: float | None = None  # a width that was asked for in this cycle, m

    @property
    def facts(self) -> Facts:
        """The width, m, what it is from, and by how much (m) it may be off while no sensor confirms it."""
        return {"width": self._width.metres, "width_by": self._known.by, "width_doubt": self._known.doubt}

    @property
    def features(self) -> Features:
        """Its width."""
        return self._features

    @property
    def posture(self) -> Posture | None:
        """It stands by itself."""
        return None

    @property
    def unready(self) -> str | None:
        """As long as a sensor of the width has not told it."""
        return self._known.unready

    def width_rate(self, width: float) -> float:
        """At which to go there."""
        self._wanted = width
        missing = width - self._width.metres
        rate = min(self._gain * abs(missing), self._top_rate, sqrt(2.0 * EARLY * self._acceleration * abs(missing)))
        return rate if missing > 0.0 else -rate

    @property
    def settings(self) -> Mapping[str, float]:
        """Nothing."""
        return {}

    def set(self, name: str, value: float) -> str | None:
        """There is nothing to set."""
        return self._wheels.set(name, value)

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """What ends within the range of the width, and what the wheels can turn, at this width."""
        most = self._known.freedom.share * self._top_rate
        slow = target if abs(target[RATE]) <= most else (*target[:RATE], most if target[RATE] > 0.0 else -most)
        return self._fitted(self._within(slow, EARLY * self._acceleration))

    def ground(self, *, whole: bool) -> Ground | None:
        """It does not know."""
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Every wheel at its speed, with no rate of the width that could not be stopped within its range."""
        events = self._measure(measured)
        if any(setpoint):
            self._known.drive()
        within = self._within(setpoint, self._acceleration)
        steered = self._steered(within, measured, braking=braking)
        driven = self._wheels.motion(steered, measured, braking=braking, path_rate=path_rate)
        limits = driven.limits if within is setpoint else (*driven.limits, "width")
        return Motion(driven.commands, driven.share, limits, self._numbers(), (*driven.events, *events))

    def stop(self, measured: Measured) -> Motion:
        """Every wheel braked."""
        self._forget_steering()
        events = self._measure(measured)
        braked = self._wheels.stop(measured)
        return Motion(braked.commands, numbers=self._numbers(), events=events)

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when its wheels do."""
        return turning

    def may_release(self, measured: Measured) -> bool:
        """It stands on its casters."""
        return True

    def forget_told(self) -> None:
        """Wheels that were let go may have been moved."""
        self._forget_steering()
        self._known.release()

    def _measure(self, measured: Measured) -> tuple[Event, ...]:
        """The width after this cycle, and what there is to say of it."""
        told = None
        if self._place is not None and self._place < len(measured.ranges):
            told = measured.ranges[self._place]
        rate = None if measured.estimate is None else measured.estimate.more[0]
        events = self._known.measure(rate, told, measured.dt)
        self._width.metres = self._known.metres
        return events

    def _steered(self, rates: Rates, measured: Measured, *, braking: bool) -> Rates:
        """Turning as a gyro has to see it; a robot that comes to rest makes up for nothing."""
        if self._steering is None:
            return rates
        resting = braking and not any(rates)
        turning = None if measured.attitude is None or resting else measured.attitude.yaw_rate
        return (*rates[:TURNING], self._steering.steered(rates[TURNING], turning, measured.dt), *rates[RATE:])

    def _forget_steering(self) -> None:
        if self._steering is not None:
            self._steering.forget()

    def _numbers(self) -> tuple[float | None, ...]:
        """Of its channels: the width, and the one that is asked for."""
        wanted, self._wanted = self._wanted, None
        return self._width.metres, wanted

    def _within(self, rates: Rates, acceleration: float) -> Rates:
        """With no more rate towards an end of the range than stops before it."""
        geometry, width, rate = self._kinematics.geometry, self._width.metres, rates[RATE]
        gap = (geometry.widest - width if rate > 0.0 else width - geometry.narrowest) - self._known.freedom.margin
        most = sqrt(2.0 * acceleration * max(gap, 0.0))
        if abs(rate) <= most:
            return rates
        return (*rates[:RATE], most if rate > 0.0 else -most)

    def _fitted(self, rates: Rates) -> Rates:
        """The part that is kept as a whole, of the other what the wheels have left; all of it where all yields."""
        motion, width = (*rates[:RATE], 0.0), (0.0, 0.0, 0.0, rates[RATE])
        if self._yields is Yields.ALL:
            return rates
        kept, other = (motion, width) if self._yields is Yields.WIDTH else (width, motion)
        base, added = self._kinematics.wheel_speeds(kept), self._kinematics.wheel_speeds(other)
        if base is None or added is None:
            return rates
        whole = desaturate(base, self._top_speeds)
        share = 1.0
        for speed, more, top in zip(base, added, self._top_speeds):
            left = max(top - whole * speed, 0.0) if more > 0.0 else max(top + whole * speed, 0.0)
            if abs(more) * share > left:
                share = left / abs(more)
        return tuple([whole * one + share * two for one, two in zip(kept, other)])
