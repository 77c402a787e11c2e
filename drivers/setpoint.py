"""What a motor or a joint is told in a cycle."""

from enum import Enum
from typing import Final


class CommandKind(Enum):
    """The ways a motor can be asked to behave; which of them a controller knows is in its `Capabilities`."""

    COAST = "coast"
    BRAKE = "brake"
    VELOCITY = "velocity"
    TORQUE = "torque"
    VOLTAGE = "voltage"


class Setpoint:
    """What a motor or a joint is to do. Nobody changes it; two that say the same are equal.

    No named tuple: every cycle makes two for each motor, and compiled each takes a quarter of the time.
    """

    def __init__(
        self, kind: CommandKind, value: float = 0.0, feed_forward: float = 0.0, limit: float | None = None
    ) -> None:
        self.kind: Final = kind
        self.value: Final = value
        self.feed_forward: Final = feed_forward
        self.limit: Final = limit

    def _fields(self) -> tuple[CommandKind, float, float, float | None]:
        return self.kind, self.value, self.feed_forward, self.limit

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and isinstance(other, Setpoint) and self._fields() == other._fields()

    def __hash__(self) -> int:
        return hash(self._fields())

    def __repr__(self) -> str:
        kind, value, feed_forward, limit = self._fields()
        return f"{type(self).__name__}({kind}, {value}, feed_forward={feed_forward}, limit={limit})"


class MotorCommand(Setpoint):
    """Setpoint of one motor: rad/s, N m or V at the motor shaft; 0.0 for coast and brake.

    The other two are of a velocity only. `feed_forward`: N m at the shaft that the controller's speed loop adds;
    `limit`: N m at the shaft that it may use at most, not negative (None: all that the motor has).
    """


COAST: Final = MotorCommand(CommandKind.COAST)
BRAKE: Final = MotorCommand(CommandKind.BRAKE)
