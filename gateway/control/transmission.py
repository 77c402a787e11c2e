"""Motor shaft <-> output: the one place where gear ratio, mounting direction and joint zero are applied."""

from typing import Final

from drivers.setpoint import CommandKind, MotorCommand
from gateway.control.drive_law import JointCommand

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_VELOCITY: Final = CommandKind.VELOCITY
_TORQUE: Final = CommandKind.TORQUE


class Transmission:
    """`ratio` is motor turns per output turn, signed by the mounting direction; `zero` is at the output, rad.

    Nobody changes it. No named tuple: compiled, its methods are called in a fraction of the time.
    """

    __slots__ = ("ratio", "zero")

    def __init__(self, ratio: float, zero: float) -> None:
        self.ratio: Final = ratio
        self.zero: Final = zero

    def motor_speed(self, output_speed: float) -> float:
        """Rad/s at the shaft."""
        return output_speed * self.ratio

    def motor_torque(self, output_torque: float) -> float:
        """N m at the shaft, for an ideal gear."""
        return output_torque / self.ratio

    def motor_command(self, command: JointCommand) -> MotorCommand:
        """The same at the shaft, where a torque is within its limit; a voltage only has a sign there."""
        kind, value, feed_forward, limit = command.kind, command.value, command.feed_forward, command.limit
        if kind is _VELOCITY:
            helping = 0.0 if feed_forward == 0.0 else self.motor_torque(feed_forward)  # never -0.0: that is other bytes
            bound = None if limit is None else abs(self.motor_torque(limit))
            return MotorCommand(kind, self.motor_speed(value), helping, bound)
        if kind is _TORQUE:
            bounded = value if limit is None else min(max(value, -limit), limit)
            return MotorCommand(kind, self.motor_torque(bounded))
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
