"""The drive law of a chassis whose wheels go apart: where the range of its width ends, and what yields to what.

How this works
--------------
The width is what the wheels add up to from the one at the start, drawn towards a sensor of it where there is one. Near
an end of the range no rate outward is aimed at that half the acceleration of the width could not stop in time, and none
is driven that all of it could not. What the wheels cannot turn at once yields as the robot file says: the width, the
motion, or all in proportion; what exceeds them still, on its way from one setpoint to another, is scaled as a whole.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from math import sqrt
from typing import Final

from gateway.control.drive_law import Features, Measured, Motion, SpeedLaw
from gateway.control.limits import Ground
from gateway.control.posture import Posture
from gateway.kinematics.contract import desaturate
from gateway.kinematics.odd import OddKinematics
from gateway.types import Facts, Rates, Region

RATE: Final = 3  # place of the width's rate among the axes
EARLY: Final = 0.5  # of the acceleration, with which an aim ends at the range: the rest is for jerk and lateness
CORRECTION: Final = 0.05  # of what a sensor says otherwise, taken in each cycle
FAR: Final = 0.05  # m off: a sample that is none; source: ours, half of what a pair of wheels is wide


class Yields(Enum):
    """What gives way where the wheels cannot turn for all of a command."""

    ALL = "all"
    WIDTH = "width"
    MOTION = "motion"


class OddLaw:
    """State owner. `place`: of the sensor of the width among those of kind range, None: there is none."""

    def __init__(
        self,
        kinematics: OddKinematics,
        *,
        wheels: SpeedLaw,
        top_speeds: Sequence[float],
        acceleration: float,
        yields: Yields,
        place: int | None,
    ) -> None:
        self._kinematics = kinematics
        self._wheels = wheels
        self._top_speeds = tuple(top_speeds)
        self._acceleration = acceleration  # m/s^2 of the width
        self._yields = yields
        self._place = place
        self._features = Features(width=True)
        self._width = kinematics.width
        self._sensed = False  # the sensor of the width is heard and believed

    @property
    def facts(self) -> Facts:
        """The width, m, and whether a sensor confirms it."""
        return {"width": self._width.metres, "width_sensed": self._sensed}

    @property
    def features(self) -> Features:
        """Its width."""
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
        return self._wheels.set(name, value)

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        """What ends within the range of the width, and what the wheels can turn, at this width."""
        return self._fitted(self._within(target, EARLY * self._acceleration))

    def ground(self, *, whole: bool) -> Ground | None:
        """It does not know."""
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        """Every wheel at its speed, with no rate of the width that could not be stopped within its range."""
        self._measure(measured)
        within = self._within(setpoint, self._acceleration)
        driven = self._wheels.motion(within, measured, braking=braking, path_rate=path_rate)
        limits = driven.limits if within is setpoint else (*driven.limits, "width")
        return Motion(driven.commands, driven.share, limits, (self._width.metres,), driven.events)

    def stop(self, measured: Measured) -> Motion:
        """Every wheel braked."""
        self._measure(measured)
        braked = self._wheels.stop(measured)
        return Motion(braked.commands, numbers=(self._width.metres,))

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        """It stands when its wheels do."""
        return turning

    def may_release(self, measured: Measured) -> bool:
        """It stands on its casters."""
        return True

    def forget_told(self) -> None:
        """It goes by the setpoint alone."""

    def _measure(self, measured: Measured) -> None:
        """The width after this cycle, within its stops."""
        geometry, width = self._kinematics.geometry, self._width.metres
        if measured.estimate is not None:
            width += measured.estimate.more[0] * measured.dt
        told = None
        if self._place is not None and self._place < len(measured.ranges):
            told = measured.ranges[self._place]
        self._sensed = told is not None and abs(told - width) <= FAR
        if told is not None and self._sensed:
            width += CORRECTION * (told - width)
        self._width.metres = min(max(width, geometry.narrowest), geometry.widest)

    def _within(self, rates: Rates, acceleration: float) -> Rates:
        """With no more rate towards an end of the range than stops before it."""
        geometry, width, rate = self._kinematics.geometry, self._width.metres, rates[RATE]
        gap = geometry.widest - width if rate > 0.0 else width - geometry.narrowest
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
