"""Velocity, acceleration and jerk limits of the body in every axis; each scales the whole vector: direction is kept.

How this works
--------------
The setpoint walks towards the target along the straight line between them. Measured in units of the acceleration
limits (seconds at full acceleration, the slowest axis counting), the remaining way is L; rho is the jerk limit in the
same units and h the step. A rate that falls by rho h in each of n steps and ends at zero covers
n r - rho h n (n - 1)/2 steps of way, so with the fewest n that suffice, r = (L/h)/n + rho h (n - 1)/2 lands on the
target exactly: no overshoot at any loop rate.
The acceleration vector then turns and grows no faster than the jerk limits allow; an axis that would be beyond its top
speed meanwhile leaves the line and falls by itself (`landable`).

What the floor feels is dv/dt + w x v: whoever drives a curve accelerates. So a twist may turn only as fast as its
w x v stays within TURNING_SHARE of the acceleration limits, and dv/dt gets what w x v leaves of them. The set of such
twists is not convex: where the straight line would leave it, the rates that must fall go first (`_beside`).
Axes beyond the twist (`Rates`) accelerate nothing but themselves.

`Ease` makes speeding up softer than the limits are, and nothing else: as long as an axis falls all of them hold, so
whoever lets go or commands zero, on one axis or on all, has it as soon as without it. It only ever changes what is
aimed at; the rate gets there within the jerk limit, so that it may come, change and go in any cycle.
"""

from math import ceil, floor, sqrt
from typing import Final, NamedTuple, Protocol

from drivers.records import maker
from gateway.arithmetic import dot
from gateway.control.wheel_limits import WheelLimits
from gateway.types import PLANAR, Rates, Twist

_twist: Final = maker(Twist)
TURNING_SHARE: Final = 0.7  # of the acceleration limits; the rest stays free for braking in a curve
_TURNING_DELAY: Final = 1.4461490724592034  # atanh(sqrt(k))/sqrt(k), k = TURNING_SHARE: see `stopping_time`
LEAST_SHARE: Final = 0.2  # of an acceleration limit that changing speed always has, wherever the setpoint was left
_ROUNDING: Final = 1.0 + 1e-9  # a rate that has just fallen by a whole step may seem to have fallen by more
_UNROLLED: Final = len(PLANAR)  # most robots have no more axes, and loops over so few cost twice as much
_LINE_TOLERANCE: Final = 1.02  # of the turning limit, by which the way between two twists on its edge may exceed it


class Ease(NamedTuple):
    """Shares (0..1] of the limits of acceleration and jerk with which a setpoint may speed up."""

    acceleration: float = 1.0
    jerk: float = 1.0

    @property
    def slope(self) -> float:
        """Of what is left of both, in that of the limits (`landing_slope`)."""
        return self.jerk / self.acceleration


NO_EASE: Final = Ease()


class Ground(Protocol):
    """What the floor gives, where that is known."""

    def turning(self, rates: Rates) -> float:
        """As `turning_excess`, of what the floor gives instead of the acceleration limits."""
        ...

    def effort(self, rates: Rates, way: Rates, beside: Rates) -> float:
        """The share (0..1] of the acceleration limits with which this setpoint may go this way.

        `beside`: an acceleration that it has anyway, besides its w x v.
        """
        ...


class Course(Protocol):
    """A way of its own from a setpoint to its target; keeps nothing."""

    def step(
        self, rates: Rates, rate: Rates, target: Rates, *, dt: float, effort: float, ground: Ground | None, ease: Ease
    ) -> tuple[Rates, Rates, tuple[str, ...]]:
        """Setpoint and its rate after dt seconds, and the names of the limits at work."""
        ...


def excess(vector: Rates, limits: Rates) -> float:
    """How many times the limit the worst axis takes."""
    if len(vector) == _UNROLLED:
        x, y, z = vector
        limit_x, limit_y, limit_z = limits
        along, across, turn = abs(x) / limit_x, abs(y) / limit_y, abs(z) / limit_z
        worst = across if across > along else along  # `max` is a call, and this is asked many times in a cycle
        return turn if turn > worst else worst
    worst = 0.0
    for value, limit in zip(vector, limits):
        worst = max(worst, abs(value) / limit)
    return worst


def scale_to(vector: Rates, limits: Rates) -> Rates:
    """The vector, shortened until every axis is within its limit."""
    worst = excess(vector, limits)
    return vector if worst <= 1.0 else scaled(vector, 1.0 / worst)


def turning_excess(rates: Rates, acceleration: Rates) -> float:
    """How many times the share for turning the acceleration w x v of a steady twist takes, in its worst axis."""
    vx, vy, wz = rates[0], rates[1], rates[2]
    return abs(wz) * max(abs(vy) / acceleration[0], abs(vx) / acceleration[1]) / TURNING_SHARE


def stopping_time(*, velocity: Rates, acceleration: Rates, jerk: Rates) -> float:
    """Longest time to rest from any twist within the limits, s; an upper bound.

    Straight on it is L + 1/rho, or 2 sqrt(L/rho) where full acceleration is never reached. In a curve w x v takes up
    to TURNING_SHARE = k of the limits: with v = s v0, ds/dt = -(1 - k s^2)/L needs atanh(sqrt k)/sqrt k times as long.
    """
    length, slowness = excess(velocity, acceleration), 1.0 / landing_slope(acceleration, jerk)
    straight = length + slowness if length >= slowness else 2.0 * sqrt(length * slowness)
    return straight * _TURNING_DELAY


def stopping_distance(*, velocity: Rates, acceleration: Rates, jerk: Rates) -> float:
    """Longest way of the origin until rest from any twist within the limits, m; an upper bound.

    Straight on the speed falls along a ramp symmetric about its middle: half of top speed times the time.
    In a curve braking begins more slowly than it ends, by no more than the factor of `stopping_time` again.
    """
    fastest = sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    return 0.5 * fastest * stopping_time(velocity=velocity, acceleration=acceleration, jerk=jerk)


class TwistLimiter:
    """The moving setpoint: position (`rates`, of every axis that has limits) and rate (its acceleration)."""

    def __init__(
        self,
        *,
        velocity: Rates,
        acceleration: Rates,
        jerk: Rates,
        wheels: WheelLimits | None = None,
        course: Course | None = None,
    ) -> None:
        """`wheels`: where their acceleration is limited; `course`: another way to go than the straight line."""
        self._wheels = wheels
        self._course = course
        self._velocity = velocity
        self._acceleration = acceleration
        self._jerk = jerk
        self._rho = landing_slope(acceleration, jerk)
        self._turn_x = TURNING_SHARE * acceleration[1]  # of |wz vx|, which accelerates along y
        self._turn_y = TURNING_SHARE * acceleration[0]
        self._zero: Rates = (0.0,) * len(velocity)
        self._asked: Rates | None = None  # the last target, and what of it can be held: a command stays for some cycles
        self._answer: tuple[Rates, tuple[str, ...]] = (self._zero, ())
        self.rates = self._zero
        self._rate = self._zero

    @property
    def setpoint(self) -> Twist:
        """What of it moves the body in its plane."""
        return _twist(self.rates[:_UNROLLED])

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint is exactly zero."""
        return self.rates == self._zero

    def reset(self, rates: Rates | None = None) -> None:
        """Start over from a known motion; None: rest."""
        self.rates = self._zero if rates is None else rates
        self._rate = self._zero

    def scale(self, factor: float) -> None:
        """A later limit shortened the setpoint: continue from what is really driven."""
        self.rates = scaled(self.rates, factor)
        self._rate = scaled(self._rate, factor)

    def step(
        self,
        target: Rates,
        dt: float,
        *,
        effort: float = 1.0,
        headroom: float = 1.0,
        ground: Ground | None = None,
        ease: Ease = NO_EASE,
    ) -> tuple[Rates, tuple[str, ...]]:
        """Setpoint after dt seconds and the names of the limits that held it back.

        `effort` (0..1] scales the acceleration that may be used (degraded driving has fewer motors to push with).
        `headroom` [0..1] scales what the setpoint may grow: motors at their torque limit cannot follow. An axis that
        is to fall falls all the same, or a robot that is overloaded would obey no command for less but zero.
        `ground` may give less than the limits say ("grip"). `ease`: of speeding up.
        """
        before = self.rates
        if self._course is not None:
            after, self._rate, active = self._course.step(
                before, self._rate, target, dt=dt, effort=effort, ground=ground, ease=ease
            )
            return self._held_back(before, after, headroom), active
        wanted, active = self._holdable(target, ground)
        if dt <= 0.0 or (wanted == before and self._rate == self._zero):
            return before, active
        aim = self._beside(wanted) if self._line_leaves(wanted) else wanted
        way = summed(aim, before, -1.0)
        ease = eased(ease, before, way, self._acceleration, dt)
        if self._arrives(way, dt, ease):
            after, self._rate = aim, scaled(way, 1.0 / dt)
        else:
            given = 1.0 if ground is None else ground.effort(before, way, self._zero)
            self._turn_rate(way, dt, effort * given, ease)
            after = scale_to(summed(before, self._rate, dt), self._velocity)
            active = (*active, "acceleration", "grip") if given < 1.0 else (*active, "acceleration")
        return self._held_back(before, after, headroom), active

    def _held_back(self, before: Rates, after: Rates, headroom: float) -> Rates:
        """Take this step, with this much of every axis that grows."""
        if headroom < 1.0 and _grows(before, after):
            after = self._hold_back(before, after, headroom)
        self.rates = after
        return after

    def _hold_back(self, before: Rates, after: Rates, headroom: float) -> Rates:
        shares = [headroom if abs(new) > abs(old) else 1.0 for old, new in zip(before, after, strict=True)]
        self._rate = tuple([rate * share for rate, share in zip(self._rate, shares, strict=True)])
        return tuple([old + share * (new - old) for old, new, share in zip(before, after, shares, strict=True)])

    def brake(self, dt: float, *, effort: float = 1.0) -> Rates:
        """Setpoint after dt seconds on its way to rest along its own direction: no axis ever grows.

        A rate that led elsewhere is dropped at once; what it had of slowing down is kept. `effort` as for `step`.
        """
        along = tuple([value / limit for value, limit in zip(self.rates, self._acceleration, strict=True)])
        square = dot(along, along)
        if dt <= 0.0 or square == 0.0:
            if square == 0.0:
                self.reset()
            return self.rates
        falling = -self._rate_along(along) / square  # 1/s
        self._rate = scaled(self.rates, -max(0.0, falling))
        way = scaled(self.rates, -1.0)
        if self._arrives(way, dt):
            self.reset()
            return self.rates
        self._turn_rate(way, dt, effort)
        left = 1.0 + dt * self._rate_along(along) / square
        if left <= 0.0:
            self.reset()
            return self.rates
        self.rates = scaled(self.rates, min(left, 1.0))
        return self.rates

    def _rate_along(self, direction: Rates) -> float:
        """The rate in units of the acceleration limits, along such a direction."""
        total = 0.0
        for part, rate, limit in zip(direction, self._rate, self._acceleration, strict=True):
            total += part * rate / limit
        return total

    def _holdable(self, target: Rates, ground: Ground | None) -> tuple[Rates, tuple[str, ...]]:
        """The target within top speed and turning limit, and which of them shortened it."""
        if ground is not None:  # which may give less than it did
            return self._held_within(target, ground)
        if target is not self._asked:
            self._asked, self._answer = target, self._held_within(target, None)
        return self._answer

    def _held_within(self, target: Rates, ground: Ground | None) -> tuple[Rates, tuple[str, ...]]:
        wanted = scale_to(target, self._velocity)
        active: tuple[str, ...] = () if wanted is target else ("velocity",)
        turning = turning_excess(wanted, self._acceleration)
        if ground is not None:
            turning = max(turning, ground.turning(wanted))
        if turning <= 1.0:
            return wanted, active
        return scaled(wanted, 1.0 / sqrt(turning)), (*active, "turning")

    def _line_leaves(self, wanted: Rates) -> bool:
        """Whether the straight line to a holdable twist passes through twists that are not."""
        vx, vy, wz = self.rates[:3]
        to_vx, to_vy, to_wz = wanted[:3]
        return (
            _peak(wz, to_wz, vx, to_vx) > _LINE_TOLERANCE * self._turn_x
            or _peak(wz, to_wz, vy, to_vy) > _LINE_TOLERANCE * self._turn_y
        )

    def _beside(self, wanted: Rates) -> Rates:
        """What of the wanted twist the present turning limit allows: each of speed and turn, the other as it is."""
        vx, vy, wz = self.rates[:3]
        to_vx, to_vy, to_wz = wanted[:3]
        turn = min(_quotient(self._turn_x, abs(vx)), _quotient(self._turn_y, abs(vy)))
        speed = min(
            1.0,
            _quotient(_quotient(self._turn_x, abs(wz)), abs(to_vx)),
            _quotient(_quotient(self._turn_y, abs(wz)), abs(to_vy)),
        )
        return (to_vx * speed, to_vy * speed, max(-turn, min(turn, to_wz)), *wanted[3:])

    def _arrives(self, way: Rates, dt: float, ease: Ease = NO_EASE) -> bool:
        if self._wheels is not None and self._wheels.seconds(way, self._wheels.accelerations) > dt:
            return False
        return arrives(way, self._rate, self._acceleration, self._jerk, dt, ease=ease)

    def _turn_rate(self, way: Rates, dt: float, effort: float, ease: Ease = NO_EASE) -> None:
        length = excess(way, spare(self.rates, self._acceleration, way)) / (effort * ease.acceleration)
        if self._wheels is not None:
            length = max(length, self._wheels.seconds(way, self._wheels.accelerations))
        rate = turned(self._rate, way, length, self._jerk, slope=self._rho * ease.slope, dt=dt, ease=ease.jerk)
        self._rate = landable(self.rates, self._rate, rate, self._velocity, self._jerk, dt=dt)


def eased(ease: Ease, rates: Rates, way: Rates, acceleration: Rates, dt: float) -> Ease:
    """What of it holds for a setpoint that goes this way: nothing while an axis falls.

    A straight line has one pace: what grows on it beside goes with what falls. Not for a fall that a step of dt has
    room for, as that of a hand that trembles, beside more that grows.
    """
    if ease == NO_EASE:
        return NO_EASE
    falls = tuple([step if value * step < 0.0 else 0.0 for value, step in zip(rates, way)])
    falling = excess(falls, acceleration)
    return ease if falling <= dt and falling < excess(summed(way, falls, -1.0), acceleration) else NO_EASE


def arrives(way: Rates, rate: Rates, acceleration: Rates, jerk: Rates, dt: float, *, ease: Ease = NO_EASE) -> bool:
    """Whether one step can cover the rest of the way and the next can be at rest, within every limit."""
    if excess(way, acceleration) > dt * ease.acceleration:
        return False
    last = scaled(way, 1.0 / dt)
    change = summed(last, rate, -1.0)
    step = dt * ease.jerk
    return excess(last, jerk) <= step and excess(change, jerk) <= step * _ROUNDING


def turned(rate: Rates, way: Rates, length: float, jerk: Rates, *, slope: float, dt: float, ease: float = 1.0) -> Rates:
    """The rate turned towards the way, as far as the jerk limits let it in a step.

    `length`: s that the way takes at full acceleration; `slope`: see `landing_slope`. `ease`: share of the jerk
    by which it rises. It falls by all of it: after a larger share the way may be too short for less.
    """
    gain = min(1.0, _landing_rate(length / dt, slope * dt)) / length if length > 0.0 else 0.0
    change = summed(scaled(way, gain), rate, -1.0)
    worst = excess(change, jerk) / (dt if ease == 1.0 or dot(change, rate) < 0.0 else dt * ease)
    return summed(rate, change, 1.0 / worst if worst > 1.0 else 1.0)


def landable(now: Rates, before: Rates, rate: Rates, velocity: Rates, jerk: Rates, *, dt: float) -> Rates:
    """The rate after that before, where every axis can still end at its top speed.

    All of a rate turns towards a target that jumps, and an axis that has little to fall falls with those that have
    much. One that would be beyond its top speed before it lands falls by itself instead, by all the jerk that it has;
    what can land can so after that step too, so it is never too late.
    """
    kept = rate
    for axis, (speed, was, change, top, most) in enumerate(zip(now, before, rate, velocity, jerk)):
        way = 1.0 if change > 0.0 else -1.0
        if dt * _landing_way(abs(change), most * dt) > top * _ROUNDING - way * speed:
            falls = way * max(0.0, way * was - most * dt)
            kept = (*kept[:axis], falls, *kept[axis + 1 :])
    return kept


def spare(rates: Rates, acceleration: Rates, way: Rates) -> Rates:
    """What turning leaves of the acceleration limits in the direction of the way."""
    vx, vy, wz = rates[:3]
    return (_left(acceleration[0], -wz * vy, way[0]), _left(acceleration[1], wz * vx, way[1]), *acceleration[2:])


def _landing_rate(way: float, fall: float) -> float:
    """Rate from which steps that fall by `fall` each cover the way (in rate times steps) and end at zero."""
    steps = max(1, ceil(sqrt(0.25 + 2.0 * way / fall) - 0.5 - 1e-9))
    return way / steps + fall * (steps - 1) / 2.0


def _landing_way(rate: float, fall: float) -> float:
    """What steps that fall by `fall` each still cover from a rate on, in rate times steps."""
    steps = floor(rate / fall) + 1
    return steps * (rate - fall * (steps - 1) / 2.0)


def landing_slope(acceleration: Rates, jerk: Rates) -> float:
    """The jerk limit in units of the acceleration limits, 1/s; the slowest axis counts."""
    return min(j / a for j, a in zip(jerk, acceleration, strict=True))


def _left(limit: float, turning: float, way: float) -> float:
    against = turning if way > 0.0 else -turning
    if against <= 0.0:
        return limit
    return max(limit - against, LEAST_SHARE * limit)


def _peak(a: float, to_a: float, b: float, to_b: float) -> float:
    """Largest |a b| while both move in proportion from here to there."""
    da, db = to_a - a, to_b - b
    ends = max(abs(a * b), abs(to_a * to_b))
    if da * db == 0.0:
        return ends
    at = -(a * db + b * da) / (2.0 * da * db)
    return max(ends, abs((a + at * da) * (b + at * db))) if 0.0 < at < 1.0 else ends


def _quotient(value: float, divisor: float) -> float:
    return value / divisor if divisor > 1e-9 else 1e9


def _grows(before: Rates, after: Rates) -> bool:
    return any(abs(new) > abs(old) for old, new in zip(before, after, strict=True))


def scaled(vector: Rates, factor: float) -> Rates:
    """vector times factor"""
    if len(vector) == _UNROLLED:
        x, y, z = vector
        return (x * factor, y * factor, z * factor)
    return tuple([value * factor for value in vector])


def summed(vector: Rates, other: Rates, factor: float) -> Rates:
    """vector + factor * other"""
    if len(vector) == _UNROLLED:
        x, y, z = vector
        other_x, other_y, other_z = other
        return (x + factor * other_x, y + factor * other_y, z + factor * other_z)
    return tuple([one + factor * two for one, two in zip(vector, other, strict=True)])
