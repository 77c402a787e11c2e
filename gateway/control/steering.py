"""Steering by a gyro: PD of the yaw, so that the body turns as it is asked to, whatever its wheels lose of it.

How this works
--------------
e is the turn that is missing, the integral of what is asked for less what the gyro tells. With wheels that follow by
a lag T the loop is T e'' + (1 + Kd) e' + Kp e = 0, stable for every Kp > 0 and Kd >= 0, and without overshoot as long
as 4 T Kp <= (1 + Kd)^2. What it adds comes and goes no faster than the body may turn faster: a gyro that is heard again
while the body spins, or falls silent while it is held back, is no reason for wheels to step.
Source: arXiv 2407.10127 (steering by PD of the yaw); the condition is derived.
"""

from typing import Final, NamedTuple

FARTHEST: Final = 0.2  # rad that is made up for at most: more was lost to something that steering does not cure
SHARE: Final = 0.25  # of the top turning speed that it may use


class SteeringGains(NamedTuple):
    """1/s and 1."""

    yaw: float
    yaw_rate: float

    def objection(self, lag: float) -> str | None:
        """Why wheels that follow by this lag, s, would swing; None: they do not."""
        most = (1.0 + self.yaw_rate) * (1.0 + self.yaw_rate) / (4.0 * lag)
        if self.yaw <= most:
            return None
        return (
            f"yaw = {self.yaw:g}: must be at most {most:.3g}, with yaw_rate = {self.yaw_rate:g} and a lag of {lag:g} s"
        )


class Steering:
    """State owner. Of the body's turning: `top`, rad/s, and `acceleration`, rad/s^2."""

    def __init__(self, gains: SteeringGains, *, top: float, acceleration: float) -> None:
        self._gains = gains
        self._most = SHARE * top
        self._acceleration = acceleration
        self._missing = 0.0  # rad
        self._added = 0.0  # rad/s

    def steered(self, wanted: float, measured: float | None, dt: float) -> float:
        """Rad/s to turn the wheels for, where this is wanted; soon the same while no gyro tells how it turns."""
        more = self._made_up(wanted, measured, dt)
        step = self._acceleration * dt
        if more > self._added + step:
            self._added += step
        elif more < self._added - step:
            self._added -= step
        else:
            self._added = more
        return wanted + self._added

    def forget(self) -> None:
        """It begins anew, as it stands."""
        self._missing = self._added = 0.0

    def _made_up(self, wanted: float, measured: float | None, dt: float) -> float:
        """Rad/s that PD adds."""
        if measured is None:
            self._missing = 0.0
            return 0.0
        error = wanted - measured
        self._missing = max(-FARTHEST, min(FARTHEST, self._missing + error * dt))
        more = self._gains.yaw * self._missing + self._gains.yaw_rate * error
        return max(-self._most, min(self._most, more))
