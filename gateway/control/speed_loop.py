"""PI speed loop on the host, for controllers that take no speed (DJI). All at the motor's output.

How this works
--------------
A wheel that slips or is lifted is lighter than one that carries its share of the robot, so a gain that suits the robot
may be too much for it: in every cycle it overshoots by more than it was off, and swings without end, and a robot on
such wheels slides on instead of coming to rest. So where a wheel is to stand, an error that turns round from one cycle
to the next takes gain from the loop, until it no longer does, and the gain comes back within RECOVERY. A loop that
takes back no more than all of an error in a cycle (`gateway.core.examination`) never turns one round. While the robot
drives its other wheels lead it, and by the swings slip is seen (`gateway.core.slip`).
"""

from typing import Final

SWING: Final = 0.05  # of max_torque, that the gain makes of an error: of less it is no swing
CALMER: Final = 0.7  # of the gain, in each cycle that swings
LEAST_GAIN: Final = 0.1
RECOVERY: Final = 0.5  # s


class SpeedLoop:
    """Torque from a speed error, with the integrator held while the torque limit is reached (anti-windup)."""

    def __init__(self, *, kp: float, ki: float, max_torque: float) -> None:
        self._kp = kp
        self._ki = ki
        self._max_torque = max_torque
        self._integral = 0.0  # N m
        self._share = 1.0  # of the gain
        self._before = 0.0  # rad/s, the error of the last cycle if it was to stand

    def torque(
        self,
        setpoint: float,
        measured: float | None,
        dt: float,
        *,
        feed_forward: float = 0.0,
        limit: float | None = None,
    ) -> float:
        """N m for one cycle of dt seconds; zero while the speed is unknown: driving blind would be worse.

        `feed_forward`: N m added; `limit`: N m that may be used, where that is less than the motor has.
        """
        if measured is None:
            self.reset()
            return 0.0
        error = setpoint - measured
        integral = self._integral + self._ki * error * dt
        torque = self._gain(error, dt, stands=setpoint == 0.0) * error + integral + feed_forward
        bound = self._max_torque if limit is None else min(limit, self._max_torque)
        if -bound <= torque <= bound:
            self._integral = integral
            return torque
        if torque * error < 0.0:  # saturated, but the error already drives the integrator back
            self._integral = integral
        return bound if torque > 0.0 else -bound

    def _gain(self, error: float, dt: float, *, stands: bool) -> float:
        """N m per rad/s: less while the error of a wheel that is to stand turns round in each cycle."""
        before, self._before = self._before, error if stands else 0.0
        kp, least = self._kp, SWING * self._max_torque
        if error * before < 0.0 and kp * abs(error) > least and kp * abs(before) > least:
            self._share = max(LEAST_GAIN, CALMER * self._share)
        elif self._share < 1.0:
            self._share = min(1.0, self._share + dt / RECOVERY)
        return self._share * kp

    def reset(self) -> None:
        """Forget the past; called whenever the motor is released."""
        self._integral = self._before = 0.0
        self._share = 1.0
