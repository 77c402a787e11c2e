"""Velocity, acceleration and jerk limits of the body twist; each scales the whole vector, so direction is kept.

How this works
--------------
The setpoint walks towards the target along the straight line between them. Measured in units of the acceleration
limits (seconds at full acceleration, the slowest axis counting), the remaining way is L; rho is the jerk limit in the
same units and h the step. A rate that falls by rho h in each of n steps and ends at zero covers
n r - rho h n (n - 1)/2 steps of way, so with the fewest n that suffice, r = (L/h)/n + rho h (n - 1)/2 lands on the
target exactly: no overshoot at any loop rate.
The acceleration vector then turns and grows no faster than the jerk limits allow.
"""

from math import ceil, sqrt

from gateway.types import ZERO_TWIST, Twist

_ROUNDING = 1.0 + 1e-9  # a rate that has just fallen by a whole step may seem to have fallen by more


def excess(vector: Twist, limits: Twist) -> float:
    """How many times the limit the worst axis takes."""
    x, y, z = vector
    limit_x, limit_y, limit_z = limits
    return max(abs(x) / limit_x, abs(y) / limit_y, abs(z) / limit_z)


def scale_to(vector: Twist, limits: Twist) -> Twist:
    """The vector, shortened until every axis is within its limit."""
    worst = excess(vector, limits)
    return vector if worst <= 1.0 else _scaled(vector, 1.0 / worst)


class TwistLimiter:
    """The moving setpoint: position (a twist) and rate (its acceleration)."""

    def __init__(self, *, velocity: Twist, acceleration: Twist, jerk: Twist) -> None:
        self._velocity = velocity
        self._acceleration = acceleration
        self._jerk = jerk
        self._rho = min(j / a for j, a in zip(jerk, acceleration, strict=True))  # 1/s
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

    def step(self, target: Twist, dt: float, *, effort: float = 1.0) -> tuple[Twist, tuple[str, ...]]:
        """Setpoint after dt seconds and the names of the limits that held it back.

        `effort` (0..1] scales the acceleration that may be used (degraded driving has fewer motors to push with).
        """
        wanted = scale_to(target, self._velocity)
        active: tuple[str, ...] = () if wanted is target else ("velocity",)
        if dt <= 0.0 or (wanted == self.setpoint and self._rate == ZERO_TWIST):
            return self.setpoint, active
        way = _sum(wanted, self.setpoint, -1.0)
        if self._arrives(way, dt):
            self.setpoint, self._rate = wanted, _scaled(way, 1.0 / dt)
            return wanted, active
        self._turn_rate(way, dt, effort)
        self.setpoint = scale_to(_sum(self.setpoint, self._rate, dt), self._velocity)
        return self.setpoint, (*active, "acceleration")

    def _arrives(self, way: Twist, dt: float) -> bool:
        """Whether one step can cover the rest of the way and the next can be at rest, within every limit."""
        if excess(way, self._acceleration) > dt:
            return False
        rate = _scaled(way, 1.0 / dt)
        change = _sum(rate, self._rate, -1.0)
        return excess(rate, self._jerk) <= dt and excess(change, self._jerk) <= dt * _ROUNDING

    def _turn_rate(self, way: Twist, dt: float, effort: float) -> None:
        length = excess(way, self._acceleration) / effort
        gain = min(1.0, self._landing_rate(length / dt, self._rho * dt)) / length if length > 0.0 else 0.0
        change = _sum(_scaled(way, gain), self._rate, -1.0)
        worst = excess(change, self._jerk) / dt
        self._rate = _sum(self._rate, change, 1.0 / worst if worst > 1.0 else 1.0)

    @staticmethod
    def _landing_rate(way: float, fall: float) -> float:
        """Rate from which steps that fall by `fall` each cover the way (in rate times steps) and end at zero."""
        steps = max(1, ceil(sqrt(0.25 + 2.0 * way / fall) - 0.5 - 1e-9))
        return way / steps + fall * (steps - 1) / 2.0


def _scaled(vector: Twist, factor: float) -> Twist:
    x, y, z = vector
    return Twist(x * factor, y * factor, z * factor)


def _sum(vector: Twist, other: Twist, factor: float) -> Twist:
    """vector + factor * other"""
    x, y, z = vector
    other_x, other_y, other_z = other
    return Twist(x + factor * other_x, y + factor * other_y, z + factor * other_z)
