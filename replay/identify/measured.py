"""What the motors of a recorded drive told, each number with the instant at which it arrived; the drivers read it."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.contract import MotorFeedback
from gateway.config import RobotConfig
from gateway.control.transmission import Transmission
from gateway.core.assembly import build
from gateway.types import Inputs

Array = NDArray[np.float64]


class Series(NamedTuple):
    """Of one motor at its output: s since the first cycle, rad, rad/s and N m. Torques may be told more seldom."""

    name: str
    times: Array
    angles: Array
    rates: Array
    torque_times: Array
    torques: Array


def measured(inputs: Iterable[Inputs], config: RobotConfig) -> tuple[Series, ...]:
    """Of all motors in chassis order. Raises ConfigError."""
    robot = build(config)
    told = [_Told(gear) for gear in robot.transmissions]
    first_ns = None
    for one in inputs:
        first_ns = one.now_ns if first_ns is None else first_ns
        for frame in one.frames:
            for group in robot.groups:
                if group.bus == frame.bus and group.driver.receive(frame):
                    at_ns = one.now_ns if frame.received_ns is None else frame.received_ns
                    for index, feedback in zip(group.indices, group.driver.feedback(now_ns=at_ns), strict=True):
                        told[index].take(feedback, at_ns, first_ns)
                    break
    return tuple(one.series(name) for name, one in zip(robot.names, told, strict=True))


class _Told:
    """Of one motor."""

    def __init__(self, gear: Transmission) -> None:
        self._gear = gear
        self._motion: list[tuple[float, float, float]] = []
        self._torque: list[tuple[float, float]] = []
        self._motion_ns: int | None = None
        self._torque_ns: int | None = None

    def take(self, feedback: MotorFeedback, at_ns: int, first_ns: int) -> None:
        """What is new of it; ages count back from `at_ns`."""
        rate, angle = self._gear.output(feedback.velocity, feedback.position)
        torque = self._gear.output_torque(feedback.torque)
        age_ns, torque_age_ns = feedback.age_ns, feedback.torque_age_ns
        if age_ns is not None and rate is not None and angle is not None and self._motion_ns != at_ns - age_ns:
            self._motion_ns = at_ns - age_ns
            self._motion.append(((self._motion_ns - first_ns) * 1e-9, angle, rate))
        if torque_age_ns is not None and torque is not None and self._torque_ns != at_ns - torque_age_ns:
            self._torque_ns = at_ns - torque_age_ns
            self._torque.append(((self._torque_ns - first_ns) * 1e-9, torque))

    def series(self, name: str) -> Series:
        """All of it."""
        motion, torque = np.array(self._motion).reshape(-1, 3).T, np.array(self._torque).reshape(-1, 2).T
        return Series(name, *motion, *torque)
