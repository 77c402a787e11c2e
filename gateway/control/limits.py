"""Velocity, acceleration and jerk limits of the body twist; each scales the whole vector, so direction is kept.

How this works
--------------
The setpoint walks towards the target along the straight line between them. Measured in units of the acceleration
limits (seconds at full acceleration, the slowest axis counting), the remaining way is L; rho is the jerk limit in the
same units and h the step. A rate that falls by rho h in each of n steps and ends at zero covers
n r - rho h n (n - 1)/2 steps of way, so with the fewest n that suffice, r = (L/h)/n + rho h (n - 1)/2 lands on the
target exactly: no overshoot at any loop rate.
The acceleration vector then turns and grows no faster than the jerk limits allow.

What the floor feels is dv/dt + w x v: whoever drives a curve accelerates. So a twist may turn only as fast as its
w x v stays within TURNING_SHARE of the acceleration limits, and dv/dt gets what w x v leaves of them. The set of such
twists is not convex: where the straight line would leave it, the rates that must fall go first (`_beside`).
"""

from math import ceil, sqrt
from typing import Final

from gateway.types import ZERO_TWIST, Twist

TURNING_SHARE: Final = 0.7  # of the acceleration limits; the rest stays free for braking in a curve
_TURNING_DELAY: Final = 1.4461490724592034  # atanh(sqrt(k))/sqrt(k), k = TURNING_SHARE: see `stopping_time`
LEAST_SHARE: Final = 0.2  # of an acceleration limit that changing speed always has, wherever the setpoint was left
_ROUNDING: Final = 1.0 + 1e-9  # a rate that has just fallen by a whole step may seem to have fallen by more
_LINE_TOLERANCE: Final = 1.02  # of the turning limit, by which the way between two twists on its edge may exceed it


def excess(vector: Twist, limits: Twist) -> float:
    """How many times the limit the worst axis takes."""
    x, y, z = vector
    limit_x, limit_y, limit_z = limits
    return max(abs(x) / limit_x, abs(y) / limit_y, abs(z) / limit_z)


def scale_to(vector: Twist, limits: Twist) -> Twist:
    """The vector, shortened until every axis is within its limit."""
    worst = excess(vector, limits)
    return vector if worst <= 1.0 else _scaled(vector, 1.0 / worst)


def turning_excess(twist: Twist, acceleration: Twist) -> float:
    """How many times the share for turning the acceleration w x v of a steady twist takes, in its worst axis."""
    vx, vy, wz = twist
    return abs(wz) * max(abs(vy) / acceleration.vx, abs(vx) / acceleration.vy) / TURNING_SHARE


def stopping_time(*, velocity: Twist, acceleration: Twist, jerk: Twist) -> float:
    """Longest time to rest from any twist within the limits, s; an upper bound.

    Straight on it is L + 1/rho, or 2 sqrt(L/rho) where full acceleration is never reached. In a curve w x v takes up
    to TURNING_SHARE = k of the limits: with v = s v0, ds/dt = -(1 - k s^2)/L needs atanh(sqrt k)/sqrt k times as long.
    """
    length, slowness = excess(velocity, acceleration), 1.0 / _slope(acceleration, jerk)
    straight = length + slowness if length >= slowness else 2.0 * sqrt(length * slowness)
    return straight * _TURNING_DELAY


def stopping_distance(*, velocity: Twist, acceleration: Twist, jerk: Twist) -> float:
    """Longest way of the origin until rest from any twist within the limits, m; an upper bound.

    Straight on the speed falls along a ramp symmetric about its middle: half of top speed times the time.
    In a curve braking begins more slowly than it ends, by no more than the factor of `stopping_time` again.
    """
    fastest = sqrt(velocity.vx * velocity.vx + velocity.vy * velocity.vy)
    return 0.5 * fastest * stopping_time(velocity=velocity, acceleration=acceleration, jerk=jerk)


class TwistLimiter:
    """The moving setpoint: position (a twist) and rate (its acceleration)."""

    def __init__(self, *, velocity: Twist, acceleration: Twist, jerk: Twist) -> None:
        self._velocity = velocity
        self._acceleration = acceleration
        self._jerk = jerk
        self._rho = _slope(acceleration, jerk)
        self._turn_x = TURNING_SHARE * acceleration.vy  # of |wz vx|, which accelerates along y
        self._turn_y = TURNING_SHARE * acceleration.vx
        self.setpoint = ZERO_TWIST
        self._rate = ZERO_TWIST

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint is exactly zero."""
        return self.setpoint == ZERO_TWIST

    def reset(self, setpoint: Twist = ZERO_TWIST) -> None:
        """Start over from a known motion."""
        self.setpoint = setpoint
        self._rate = ZERO_TWIST

    def scale(self, factor: float) -> None:
        """A later limit shortened the setpoint: continue from what is really driven."""
        self.setpoint = _scaled(self.setpoint, factor)
        self._rate = _scaled(self._rate, factor)

    def step(
        self, target: Twist, dt: float, *, effort: float = 1.0, headroom: float = 1.0
    ) -> tuple[Twist, tuple[str, ...]]:
        """Setpoint after dt seconds and the names of the limits that held it back.

        `effort` (0..1] scales the acceleration that may be used (degraded driving has fewer motors to push with).
        `headroom` [0..1] scales what the setpoint may grow: motors at their torque limit cannot follow. An axis that
        is to fall falls all the same, or a robot that is overloaded would obey no command for less but zero.
        """
        wanted, active = self._holdable(target)
        if dt <= 0.0 or (wanted == self.setpoint and self._rate == ZERO_TWIST):
            return self.setpoint, active
        before = self.setpoint
        aim = self._beside(wanted) if self._line_leaves(wanted) else wanted
        way = _sum(aim, before, -1.0)
        if self._arrives(way, dt):
            after, self._rate = aim, _scaled(way, 1.0 / dt)
        else:
            self._turn_rate(way, dt, effort)
            after = scale_to(_sum(before, self._rate, dt), self._velocity)
            active = (*active, "acceleration")
        if headroom < 1.0 and _grows(before, after):
            after = self._hold_back(before, after, headroom)
        self.setpoint = after
        return after, active

    def _hold_back(self, before: Twist, after: Twist, headroom: float) -> Twist:
        """The step with this much of every axis that grows."""
        shares = [headroom if abs(new) > abs(old) else 1.0 for old, new in zip(before, after, strict=True)]
        self._rate = Twist(*[rate * share for rate, share in zip(self._rate, shares, strict=True)])
        return Twist(*[old + share * (new - old) for old, new, share in zip(before, after, shares, strict=True)])

    def brake(self, dt: float) -> Twist:
        """Setpoint after dt seconds on its way to rest along its own direction: no axis ever grows.

        A rate that led elsewhere is dropped at once; what it had of slowing down is kept.
        """
        x, y, z = self.setpoint
        limit_x, limit_y, limit_z = self._acceleration
        along_x, along_y, along_z = x / limit_x, y / limit_y, z / limit_z
        square = along_x * along_x + along_y * along_y + along_z * along_z
        if dt <= 0.0 or square == 0.0:
            if square == 0.0:
                self.reset()
            return self.setpoint
        a, b, c = self._rate
        falling = -(along_x * a / limit_x + along_y * b / limit_y + along_z * c / limit_z) / square  # 1/s
        self._rate = _scaled(self.setpoint, -max(0.0, falling))
        way = _scaled(self.setpoint, -1.0)
        if self._arrives(way, dt):
            self.reset()
            return self.setpoint
        self._turn_rate(way, dt, effort=1.0)
        a, b, c = self._rate
        left = 1.0 + dt * (along_x * a / limit_x + along_y * b / limit_y + along_z * c / limit_z) / square
        if left <= 0.0:
            self.reset()
            return self.setpoint
        self.setpoint = _scaled(self.setpoint, min(left, 1.0))
        return self.setpoint

    def _holdable(self, target: Twist) -> tuple[Twist, tuple[str, ...]]:
        """The target within top speed and turning limit, and which of them shortened it."""
        wanted = scale_to(target, self._velocity)
        active: tuple[str, ...] = () if wanted is target else ("velocity",)
        turning = turning_excess(wanted, self._acceleration)
        if turning <= 1.0:
            return wanted, active
        return _scaled(wanted, 1.0 / sqrt(turning)), (*active, "turning")

    def _line_leaves(self, wanted: Twist) -> bool:
        """Whether the straight line to a holdable twist passes through twists that are not."""
        vx, vy, wz = self.setpoint
        return (
            _peak(wz, wanted.wz, vx, wanted.vx) > _LINE_TOLERANCE * self._turn_x
            or _peak(wz, wanted.wz, vy, wanted.vy) > _LINE_TOLERANCE * self._turn_y
        )

    def _beside(self, wanted: Twist) -> Twist:
        """What of the wanted twist the present turning limit allows: each of speed and turn, the other as it is."""
        vx, vy, wz = self.setpoint
        turn = min(_quotient(self._turn_x, abs(vx)), _quotient(self._turn_y, abs(vy)))
        speed = min(
            1.0,
            _quotient(_quotient(self._turn_x, abs(wz)), abs(wanted.vx)),
            _quotient(_quotient(self._turn_y, abs(wz)), abs(wanted.vy)),
        )
        return Twist(wanted.vx * speed, wanted.vy * speed, max(-turn, min(turn, wanted.wz)))

    def _arrives(self, way: Twist, dt: float) -> bool:
        """Whether one step can cover the rest of the way and the next can be at rest, within every limit."""
        if excess(way, self._acceleration) > dt:
            return False
        rate = _scaled(way, 1.0 / dt)
        change = _sum(rate, self._rate, -1.0)
        return excess(rate, self._jerk) <= dt and excess(change, self._jerk) <= dt * _ROUNDING

    def _turn_rate(self, way: Twist, dt: float, effort: float) -> None:
        length = excess(way, self._spare(way)) / effort
        gain = min(1.0, self._landing_rate(length / dt, self._rho * dt)) / length if length > 0.0 else 0.0
        change = _sum(_scaled(way, gain), self._rate, -1.0)
        worst = excess(change, self._jerk) / dt
        self._rate = _sum(self._rate, change, 1.0 / worst if worst > 1.0 else 1.0)

    def _spare(self, way: Twist) -> Twist:
        """What turning leaves of the acceleration limits in the direction of the way."""
        vx, vy, wz = self.setpoint
        limit_x, limit_y, limit_z = self._acceleration
        return Twist(_left(limit_x, -wz * vy, way.vx), _left(limit_y, wz * vx, way.vy), limit_z)

    @staticmethod
    def _landing_rate(way: float, fall: float) -> float:
        """Rate from which steps that fall by `fall` each cover the way (in rate times steps) and end at zero."""
        steps = max(1, ceil(sqrt(0.25 + 2.0 * way / fall) - 0.5 - 1e-9))
        return way / steps + fall * (steps - 1) / 2.0


def _slope(acceleration: Twist, jerk: Twist) -> float:
    """The jerk limit in units of the acceleration limits, 1/s; the slowest axis counts."""
    return min(j / a for j, a in zip(jerk, acceleration, strict=True))


def _left(limit: float, turning: float, way: float) -> float:
    against = turning if way > 0.0 else -turning
    return min(limit, max(limit - against, LEAST_SHARE * limit))


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


def _grows(before: Twist, after: Twist) -> bool:
    return any(abs(new) > abs(old) for old, new in zip(before, after, strict=True))


def _scaled(vector: Twist, factor: float) -> Twist:
    x, y, z = vector
    return Twist(x * factor, y * factor, z * factor)


def _sum(vector: Twist, other: Twist, factor: float) -> Twist:
    """vector + factor * other"""
    x, y, z = vector
    other_x, other_y, other_z = other
    return Twist(x + factor * other_x, y + factor * other_y, z + factor * other_z)
