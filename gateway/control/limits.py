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

_AXES = range(3)
_ROUNDING = 1.0 + 1e-9  # a rate that has just fallen by a whole step may seem to have fallen by more


def scale_to(vector: Twist, limits: Twist) -> Twist:
    """The vector, shortened until every axis is within its limit."""
    excess = max(abs(vector.vx) / limits.vx, abs(vector.vy) / limits.vy, abs(vector.wz) / limits.wz)
    if excess <= 1.0:
        return vector
    return Twist(vector.vx / excess, vector.vy / excess, vector.wz / excess)


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
        self.setpoint = Twist(*(value * factor for value in self.setpoint))
        self._rate = Twist(*(value * factor for value in self._rate))

    def step(self, target: Twist, dt: float, *, effort: float = 1.0) -> tuple[Twist, tuple[str, ...]]:
        """Setpoint after dt seconds and the names of the limits that held it back.

        `effort` (0..1] scales the acceleration that may be used (degraded driving has fewer motors to push with).
        """
        wanted = scale_to(target, self._velocity)
        active: tuple[str, ...] = () if wanted is target else ("velocity",)
        if dt <= 0.0 or (wanted == self.setpoint and self._rate == ZERO_TWIST):
            return self.setpoint, active
        way = Twist(*(w - s for w, s in zip(wanted, self.setpoint, strict=True)))
        if self._arrives(way, dt):
            self.setpoint, self._rate = wanted, Twist(*(w / dt for w in way))
            return wanted, active
        self._turn_rate(way, dt, effort)
        self.setpoint = scale_to(
            Twist(*(s + r * dt for s, r in zip(self.setpoint, self._rate, strict=True))), self._velocity
        )
        return self.setpoint, (*active, "acceleration")

    def _arrives(self, way: Twist, dt: float) -> bool:
        """Whether one step can cover the rest of the way and the next can be at rest, within every limit."""
        for axis in _AXES:
            rate, step = way[axis] / dt, self._jerk[axis] * dt
            if abs(rate) > min(step, self._acceleration[axis]) or abs(rate - self._rate[axis]) > step * _ROUNDING:
                return False
        return True

    def _turn_rate(self, way: Twist, dt: float, effort: float) -> None:
        limits = self._acceleration
        length = max(abs(way[axis]) / limits[axis] for axis in _AXES) / effort
        gain = min(1.0, self._landing_rate(length / dt, self._rho * dt)) / length if length > 0.0 else 0.0
        change = [way[axis] * gain - self._rate[axis] for axis in _AXES]
        excess = max(abs(change[axis]) / (self._jerk[axis] * dt) for axis in _AXES)
        share = 1.0 / excess if excess > 1.0 else 1.0
        self._rate = Twist(*(rate + delta * share for rate, delta in zip(self._rate, change, strict=True)))

    @staticmethod
    def _landing_rate(way: float, fall: float) -> float:
        """Rate from which steps that fall by `fall` each cover the way (in rate times steps) and end at zero."""
        steps = max(1, ceil(sqrt(0.25 + 2.0 * way / fall) - 0.5 - 1e-9))
        return way / steps + fall * (steps - 1) / 2.0
