"""The setpoint of translation and that of rotation, each with a profile of its own, and one of them first.

How this works
--------------
The forces for a displacement and those for a turn act for different times (Rojas 2005, section 5), so here each goes to
its target by itself, along the straight line in (vx, vy): whichever is there first does not wait for the other.
They still share the wheels and the floor. Where both together are too much one is kept, the first, as far as it can be
had alone, and the second gets what is left:
- of top speed (wheels) and of w x v (floor): the second aims at no more than fits to the first where it is and where it
  goes; and until it is down there the first goes only as far as fits to the second. All corners between here and there
  are holdable, and with them everything between, because both limits are convex in each of the two alone.
- of the acceleration of the wheels: what the second would still use after it has fallen by its jerk limit is not taken
  from it; the first gets the rest of each wheel, and what that leaves is the second's.
A stop goes along the whole twist as before: nothing is first there.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Final, NamedTuple

from gateway.control.limits import (
    Ease,
    Ground,
    arrives,
    eased,
    excess,
    landable,
    landing_slope,
    scale_to,
    scaled,
    spare,
    summed,
    turned,
    turning_excess,
)
from gateway.control.wheel_limits import WheelLimits
from gateway.types import Rates

_WHOLE: Final = 1.0 - 1e-9  # a share that differs from all of it by rounding
_NOTHING: Rates = (0.0, 0.0, 0.0)


class Saturation(Enum):
    """What is kept where the wheels or the floor cannot give all that is asked for; the value is the robot file's."""

    BOTH = "both"  # the direction of the whole twist; nothing is decoupled
    TRANSLATION = "translation"
    ROTATION = "rotation"


class Group(NamedTuple):
    """A part of the twist: its name, its axes as ones among zeros, and its jerk in units of its acceleration, 1/s."""

    name: str
    axes: Rates
    slope: float

    def of(self, rates: Rates) -> Rates:
        """This part of it, zero in the others."""
        x, y, z = self.axes
        return (x * rates[0], y * rates[1], z * rates[2])


class Going(NamedTuple):
    """Where a group is, how fast that changes, and where it may go now."""

    now: Rates
    rate: Rates
    aim: Rates


class Decoupled:
    """How a setpoint of three axes walks with one group first. Keeps nothing."""

    def __init__(
        self, first: Saturation, *, velocity: Rates, acceleration: Rates, jerk: Rates, wheels: WheelLimits
    ) -> None:
        translation = Group("translation", (1.0, 1.0, 0.0), landing_slope(acceleration[:2], jerk[:2]))
        rotation = Group("rotation", (0.0, 0.0, 1.0), landing_slope(acceleration[2:], jerk[2:]))
        turning_first = first is Saturation.ROTATION
        self._first, self._second = (rotation, translation) if turning_first else (translation, rotation)
        self._velocity = velocity
        self._acceleration = acceleration
        self._jerk = jerk
        self._wheels = wheels

    def step(
        self, rates: Rates, rate: Rates, target: Rates, *, dt: float, effort: float, ground: Ground | None, ease: Ease
    ) -> tuple[Rates, Rates, tuple[str, ...]]:
        """Setpoint and its rate after dt seconds, and the names of the limits at work; `effort`, `ease` as of all."""
        first, second, active = self._aims(rates, target, ground)
        if dt <= 0.0:
            return rates, rate, active
        one = Going(self._first.of(rates), self._first.of(rate), first)
        two = Going(self._second.of(rates), self._second.of(rate), second)
        free = spare(rates, self._acceleration, summed(summed(first, second, 1.0), rates, -1.0))
        given = self._given(one, rates, ground, self._falling(two.rate, dt))
        one_after, one_rate = self._walk_first(one, two, free, dt=dt, effort=effort * given, ease=ease)
        left = self._given(two, rates, ground, one_rate)
        two_after, two_rate = self._walk_second(two, one_rate, free, dt=dt, effort=effort * left, ease=ease)
        if one_after != first or two_after != second:
            active = (*active, "acceleration", "grip") if min(given, left) < 1.0 else (*active, "acceleration")
        return summed(one_after, two_after, 1.0), summed(one_rate, two_rate, 1.0), active

    def _given(self, going: Going, rates: Rates, ground: Ground | None, beside: Rates) -> float:
        """What the floor gives a group beside the acceleration of the other: all of it, as far as is known."""
        return 1.0 if ground is None else ground.effort(rates, summed(going.aim, going.now, -1.0), beside)

    def _aims(self, rates: Rates, target: Rates, ground: Ground | None) -> tuple[Rates, Rates, tuple[str, ...]]:
        """Where the first group and the second may go now, and which limits keep them from their targets."""
        first, second = self._first.of(target), self._second.of(target)
        top_first, top_second = scale_to(first, self._velocity), scale_to(second, self._velocity)
        active: list[str] = [] if top_first is first and top_second is second else ["velocity"]
        cut: list[str] = []
        alone = self._wheels.share(_NOTHING, top_first, self._wheels.speeds)
        if alone < _WHOLE:
            active.append("motor_speed")
            cut.append(self._first.name)
            top_first = scaled(top_first, alone)
        beside = min(
            self._fits(top_first, top_second, active, ground),
            self._fits(self._first.of(rates), top_second, active, ground),
        )
        if beside < _WHOLE:
            cut.append(self._second.name)
            top_second = scaled(top_second, beside)
        until = self._fits(self._second.of(rates), top_first, active, ground)
        if until < _WHOLE:
            cut.append(self._first.name)
            top_first = scaled(top_first, until)
        if not active:
            return top_first, top_second, ()
        return top_first, top_second, tuple(dict.fromkeys([*active, *[f"{name}_cut" for name in cut]]))

    def _fits(self, kept: Rates, added: Rates, active: list[str], ground: Ground | None) -> float:
        """The share of the one group that wheels and floor have left beside the other; what holds it is noted."""
        wheels = self._wheels.share(kept, added, self._wheels.speeds)
        if wheels < _WHOLE:
            active.append("motor_speed")
        both = summed(kept, added, 1.0)
        turning = turning_excess(both, self._acceleration)
        if ground is not None:
            turning = max(turning, ground.turning(both))
        if turning * _WHOLE > 1.0:
            active.append("turning")
            return min(wheels, 1.0 / turning)
        return wheels

    def _walk_first(
        self, one: Going, two: Going, free: Rates, *, dt: float, effort: float, ease: Ease
    ) -> tuple[Rates, Rates]:
        limits = self._wheels.accelerations
        after, rate = self._walk(self._first, one, free, limits, dt=dt, effort=effort, ease=ease)
        if not limits:
            return after, rate
        left = self._wheels.left(self._falling(two.rate, dt))
        return self._within(one, one.rate, rate, after, left, dt=dt)

    def _walk_second(
        self, two: Going, first: Rates, free: Rates, *, dt: float, effort: float, ease: Ease
    ) -> tuple[Rates, Rates]:
        if not self._wheels.accelerations:
            return self._walk(self._second, two, free, (), dt=dt, effort=effort, ease=ease)
        left = self._wheels.left(first)
        after, rate = self._walk(self._second, two, free, left, dt=dt, effort=effort, ease=ease)
        return self._within(two, self._falling(two.rate, dt), rate, after, left, dt=dt)

    def _within(
        self, going: Going, kept: Rates, rate: Rates, after: Rates, left: Sequence[float], *, dt: float
    ) -> tuple[Rates, Rates]:
        """The step, or as much of it from a rate that is kept as the wheels have left."""
        share = self._wheels.share(kept, summed(rate, kept, -1.0), left)
        if share >= _WHOLE:
            return after, rate
        rate = summed(kept, summed(rate, kept, -1.0), share)
        return scale_to(summed(going.now, rate, dt), self._velocity), rate

    def _walk(
        self, group: Group, going: Going, free: Rates, wheels: Sequence[float], *, dt: float, effort: float, ease: Ease
    ) -> tuple[Rates, Rates]:
        """One step of a group by itself, as the whole twist goes (`gateway.control.limits`).

        `wheels`: rad/s^2 that each has for it; planning with those keeps every rate one from which it can fall.
        """
        way = summed(going.aim, going.now, -1.0)
        ease = eased(ease, going.now, way, self._acceleration, dt)
        longest = self._wheels.seconds(way, wheels)
        if longest <= dt and arrives(way, going.rate, self._acceleration, self._jerk, dt, ease=ease):
            return going.aim, scaled(way, 1.0 / dt)
        length = max(excess(way, free) / (effort * ease.acceleration), longest)
        rate = turned(going.rate, way, length, self._jerk, slope=group.slope * ease.slope, dt=dt, ease=ease.jerk)
        rate = landable(going.now, going.rate, rate, self._velocity, self._jerk, dt=dt)
        return scale_to(summed(going.now, rate, dt), self._velocity), rate

    def _falling(self, rate: Rates, dt: float) -> Rates:
        """A rate after it has fallen for a step as fast as the jerk limits let it."""
        size = excess(rate, self._jerk)
        return scaled(rate, 1.0 - dt / size) if size > dt else _NOTHING
