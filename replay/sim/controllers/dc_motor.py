"""The electrical side of a DC motor (or of a brushless one, seen along its torque axis), at the motor's own shaft.

How this works
--------------
One constant k is both the torque of an ampere (N m/A) and the back-EMF of a radian per second (V s/rad):
    voltage = k rate + R i + L di/dt,    torque = k i        (Rojas 2005, sections 7 and 8)
Voltage and rate are held through a substep, so the current goes exponentially, with the time constant L/R, to the one
that flows in the end; the torque of the substep is that of its mean current. Where L/R is below a fifth of the substep
(`NEGLIGIBLE`) the inductance is left out: the current is at its end at once. What switches the voltage, and what limits
it, is the controller's affair.
"""

from typing import NamedTuple

from gateway.arithmetic import exponential
from replay.sim.controllers.contract import STEP_S

NEGLIGIBLE = 0.2  # of the substep: within it the current is to 1 % where it ends anyway (e^-5); source: ours


class DcMotor(NamedTuple):
    """What a data sheet tells, SI."""

    resistance: float  # ohm between the terminals
    constant: float  # N m/A, which is V s/rad
    inductance: float = 0.0  # H between the terminals

    def back_emf(self, rate: float) -> float:
        """V that a shaft at this rate (rad/s) holds against the voltage."""
        return self.constant * rate

    def current(self, voltage: float, rate: float) -> float:
        """A that flow in the end at this voltage and rate."""
        return (voltage - self.constant * rate) / self.resistance

    def voltage(self, current: float, rate: float) -> float:
        """V that keep this current up at this rate."""
        return self.constant * rate + self.resistance * current

    def torque(self, current: float) -> float:
        """N m of so many A."""
        return self.constant * current

    def time_constant(self, inertia: float) -> float:
        """s in which a shaft with this inertia (kg m^2) comes within 1/e of its speed at a voltage, L left out."""
        return inertia * self.resistance / (self.constant * self.constant)


class Winding:
    """The current of one motor from substep to substep. Raises ValueError for what is no motor."""

    def __init__(self, motor: DcMotor, step: float = STEP_S) -> None:
        if not (motor.resistance > 0.0 and motor.constant > 0.0 and motor.inductance >= 0.0):
            raise ValueError(f"{motor}: resistance and constant must be above zero, inductance not below")
        self.motor = motor
        self.current = 0.0  # A now, at the end of the last substep
        self._left, self._mean = _decay(motor, step)

    def step(self, voltage: float, rate: float) -> float:
        """N m, the mean of a substep with this voltage at the terminals and the shaft at this rate."""
        end = self.motor.current(voltage, rate)
        excess = self.current - end
        self.current = end + self._left * excess
        return self.motor.torque(end + self._mean * excess)

    def hold(self, current: float) -> float:
        """N m of a current that the controller keeps up (or 0: open terminals), however it does so."""
        self.current = current
        return self.motor.torque(current)


def _decay(motor: DcMotor, step: float) -> tuple[float, float]:
    """What is left of a deviation of the current after a substep, and what of it there was in the mean."""
    lag = motor.inductance / motor.resistance / step
    if lag < NEGLIGIBLE:
        return 0.0, 0.0
    left = exponential(-1.0 / lag)
    return left, lag * (1.0 - left)
