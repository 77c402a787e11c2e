"""Motor shaft <-> output: the one place where gear ratio, mounting direction and joint zero are applied.

And the one place where a torque becomes a voltage, for a controller that takes nothing else: it is a matter of the
shaft, as the gear is, and a torque takes this way wherever it comes from, a speed loop of the host or a drive law.
"""

from typing import Final

from drivers.setpoint import CommandKind, MotorCommand
from gateway.control.drive_law import JointCommand

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_VELOCITY: Final = CommandKind.VELOCITY
_TORQUE: Final = CommandKind.TORQUE
_VOLTAGE: Final = CommandKind.VOLTAGE


class Winding:
    """A DC motor at its terminals and shaft: V = R i + k w and torque = k i, of one constant in SI. Nobody changes it.

    `resistance` R, ohm; `back_emf` k, V s/rad, which is N m/A. The inductance is left out: what is told once in a cycle
    does not see it.
    """

    __slots__ = ("back_emf", "volts_per_torque")

    def __init__(self, resistance: float, back_emf: float) -> None:
        self.back_emf: Final = back_emf
        self.volts_per_torque: Final = resistance / back_emf

    def voltage(self, torque: float, speed: float) -> float:
        """V that give this torque, N m, at this speed, rad/s."""
        return torque * self.volts_per_torque + self.back_emf * speed


class Transmission:
    """`ratio` is motor turns per output turn, signed by the mounting direction; `zero` is at the output, rad.

    `winding`: of a motor that is told voltages in place of torques. Nobody changes it. No named tuple: compiled, its
    methods are called in a fraction of the time.
    """

    __slots__ = ("ratio", "winding", "zero")

    def __init__(self, ratio: float, zero: float, winding: Winding | None = None) -> None:
        self.ratio: Final = ratio
        self.zero: Final = zero
        self.winding: Final = winding

    def motor_speed(self, output_speed: float) -> float:
        """Rad/s at the shaft."""
        return output_speed * self.ratio

    def motor_torque(self, output_torque: float) -> float:
        """N m at the shaft, for an ideal gear."""
        return output_torque / self.ratio

    def torque_command(self, output_torque: float, output_speed: float | None) -> MotorCommand:
        """A torque as the controller takes it. No voltage while the speed is unknown: driving blind would be worse."""
        torque, winding = self.motor_torque(output_torque), self.winding
        if winding is None:
            return MotorCommand(_TORQUE, torque)
        return MotorCommand(
            _VOLTAGE, 0.0 if output_speed is None else winding.voltage(torque, self.motor_speed(output_speed))
        )

    def motor_command(self, command: JointCommand, output_speed: float | None) -> MotorCommand:
        """The same at the shaft, where a torque is within its limit; a voltage only has a sign there.

        `output_speed`: rad/s as measured; None: unknown.
        """
        kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
        if kind is _VELOCITY:
            helping = 0.0 if feed_forward == 0.0 else self.motor_torque(feed_forward)  # never -0.0: that is other bytes
            bound = None if limit is None else abs(self.motor_torque(limit))
            return MotorCommand(kind, self.motor_speed(value), helping, bound)
        if kind is _TORQUE:
            bounded = value if limit is None else min(max(value, -limit), limit)
            return self.torque_command(bounded, output_speed)
        return MotorCommand(kind, value if self.ratio > 0.0 else -value)

    def output(self, motor_speed: float | None, motor_position: float | None) -> tuple[float | None, float | None]:
        """Rad/s and rad (from its zero) at the output."""
        ratio = self.ratio
        return (
            None if motor_speed is None else motor_speed / ratio,
            None if motor_position is None else motor_position / ratio - self.zero,
        )

    def output_torque(self, motor_torque: float | None) -> float | None:
        """N m at the output, for an ideal gear."""
        return None if motor_torque is None else motor_torque * self.ratio
