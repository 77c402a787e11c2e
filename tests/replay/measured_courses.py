"""Measured courses without a robot: bodies led along a course by true kinematics, and ends measured with tape."""

from math import cos, sin

import numpy as np

from gateway.chassis.contract import Chassis
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import RobotConfig
from gateway.setup.courses import Course, CourseName, Courses, legs
from gateway.types import Twist
from replay.calibrate.ways import Array, Driven

STEP = 0.05  # s


def tape_of(courses: Courses, end: Array, rng: np.random.Generator) -> Array:
    """An end as it is measured: the start was marked a little askew, lengths and direction are read with errors."""
    askew = rng.normal(0.0, courses.angle)
    c, s = cos(askew), sin(askew)
    x, y = c * end[0] + s * end[1], c * end[1] - s * end[0]
    lengths = rng.normal(0.0, courses.tape, 2)
    return np.array([x + lengths[0], y + lengths[1], end[2] - askew + rng.normal(0.0, courses.angle)])


class Body:
    """Told by the kinematics of its file, moved by the true ones. `ratio`: right wheel to left; `zero`: of a joint."""

    def __init__(
        self, given: RobotConfig, true: Chassis, *, phi: float = 0.0, ratio: float = 1.0, zero: float = 0.0
    ) -> None:
        self._config = given
        self._given, self._true = given.robot.kinematics(), true.kinematics()
        self._angles = np.zeros(len(given.robot.motor_names()))
        self._trails = isinstance(given.robot, OffsetDifferentialRobot)
        self._alike = np.ones(len(self._angles))
        self._zero = np.zeros(len(self._angles))
        if self._trails:
            self._angles[2], self._zero[2] = phi, zero
            self._alike = np.array([2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio), 1.0])

    def drive(self, place: int, course: CourseName, length: float = 2.0) -> Driven:
        """With the true end as what was measured."""
        pose, told = np.zeros(3), [self._angles.copy()]
        for leg in legs(course, length, self._config):
            count = round(leg.seconds / STEP)
            for _ in range(count):
                self._step(Twist(*[part * leg.seconds / (count * STEP) for part in leg.twist]), pose)
                told.append(self._angles.copy())
        one = Course(course=course, length=length, begin=0, end=len(told))
        return Driven(f"course {place} ({course.value})", one, np.array(told).T, pose)

    def _step(self, twist: Twist, pose: Array) -> None:
        """By the rates of mid-way; wheels that are one too many turn as the true motion has it, and do not slip."""
        middle = self._angles
        for _ in range(2):
            rates = np.array(self._given.wheel_speeds(twist, list(middle)))
            middle = self._angles + 0.5 * STEP * rates
        found = self._true.twist(list(rates * self._alike), list(middle + self._zero))
        assert found is not None
        moved = found.twist
        half = pose[2] + 0.5 * STEP * moved.wz
        pose += STEP * np.array(
            [cos(half) * moved.vx - sin(half) * moved.vy, sin(half) * moved.vx + cos(half) * moved.vy, moved.wz]
        )
        if not self._trails:
            rates = np.array(self._true.wheel_speeds(moved, ()))
        self._angles = self._angles + STEP * rates
