"""The zero of a steered joint, and which way its encoder counts: from how a person put it, and turned it. Pure.

Only what knows its angle after a power cut has a zero to be written. The encoder is that of the motor, so which way it
counts is `direction`, as it is for a wheel: with it the motor turns as it measures.
"""

from collections import deque
from math import fsum
from typing import Final

from drivers.contract import CanFrame
from gateway.config import Motor, RobotConfig
from gateway.core.assembly import build
from gateway.core.motors import Motors
from gateway.setup.correction import Change

LOOK_NS: Final = 500_000_000
READINGS: Final = 5  # at least, in that time
STILL: Final = 0.02  # rad at the output, within which a joint that stands is told
SAME: Final = 0.005  # rad, by which a zero may be off and stays as it is
DIGITS: Final = 4  # of a zero that is written


class UnreferencedError(ValueError):
    """Why nothing can be said of where a joint stands."""


def steered(config: RobotConfig) -> tuple[Motor, ...]:
    """The motors of its steered joints."""
    motors = config.motors_in_order()
    return tuple([motors[place] for place in build(config).kinematics.steered])


class JointWatch:
    """What the encoder of a joint tells, rad at the shaft."""

    def __init__(self, config: RobotConfig, motor: Motor) -> None:
        robot = build(config)
        self._name = motor.name
        self._place = robot.names.index(motor.name)
        self._gear = robot.transmissions[self._place]
        self._motors = Motors(robot)
        self._readings: deque[tuple[int, float]] = deque()

    def take(self, frame: CanFrame) -> None:
        """What was received, on the bus as the robot file names it."""
        now_ns = frame.received_ns or 0
        self._motors.receive([frame])
        position = self._motors.measure(now_ns, 0.0).positions[self._place]
        if position is not None:
            self._readings.append((now_ns, position))
        while self._readings and self._readings[0][0] < now_ns - LOOK_NS:
            self._readings.popleft()

    def stands(self) -> float:
        """Where it stands, from its zero and in the direction of the robot file. Raises UnreferencedError."""
        told = [position for _, position in self._readings]
        if len(told) < READINGS:
            raise UnreferencedError(f"{self._name}: its encoder tells nothing: power, cable, id, feedback rate?")
        if max(told) - min(told) > STILL:
            raise UnreferencedError(f"{self._name}: it moves by {max(told) - min(told):.3f} rad: hold it still")
        return fsum(told) / len(told)


def referenced(motor: Motor, stands: float, way: float | None) -> list[Change]:
    """What the robot file gets wrong of a joint that was put to its zero, where it told so many rad.

    `way`: rad at the shaft, told while the joint was turned positively; None: it was not.
    """
    direction = motor.direction if way is None else (1 if way > 0.0 else -1)
    zero = round((stands + motor.zero) * motor.direction * direction, DIGITS) + 0.0
    changes = [
        Change(motor.name, "direction", motor.direction, direction),
        Change(motor.name, "zero", motor.zero, zero),
    ]
    return [one for one in changes if abs(one.new - one.old) > SAME]
