"""PI speed loop on the host, for controllers that take no speed (DJI). All at the motor's output."""


class SpeedLoop:
    """Torque from a speed error, with the integrator held while the torque limit is reached (anti-windup)."""

    def __init__(self, *, kp: float, ki: float, max_torque: float) -> None:
        self._kp = kp
        self._ki = ki
        self._max_torque = max_torque
        self._integral = 0.0  # N m

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
        torque = self._kp * error + integral + feed_forward
        bound = self._max_torque if limit is None else min(limit, self._max_torque)
        if -bound <= torque <= bound:
            self._integral = integral
            return torque
        if torque * error < 0.0:  # saturated, but the error already drives the integrator back
            self._integral = integral
        return bound if torque > 0.0 else -bound

    def reset(self) -> None:
        """Forget the past; called whenever the motor is released."""
        self._integral = 0.0
