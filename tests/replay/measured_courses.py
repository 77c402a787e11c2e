"""Measured courses: of bodies led by true kinematics, of simulated robots; and ends measured with tape."""

from collections.abc import Sequence
from math import cos, sin
from pathlib import Path

import numpy as np

from gateway.chassis.contract import Chassis
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import RobotConfig, parse
from gateway.setup.courses import Course, CourseName, Courses, legs
from gateway.types import ZERO_TWIST, Mode, Pose, Request, RequestKind, Twist, TwistCommand, TwistFrame
from replay.calibrate.ways import Array, Driven
from replay.drive.closed_loop import ClosedLoop
from replay.drive.recording import SessionRecording
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant

WALL_NS = 1_790_000_000_000_000_000
COMMAND_S = 0.02
REST_S = 1.2  # in which it comes to rest
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


def drive_courses(folder: Path, text: str, plan: Sequence[CourseName], plant: Plant, *, length: float = 1.0) -> Courses:
    """On the simulated robot of a plant, with the robot file of the text, recorded; ends are the plant's own."""
    config = parse(text, "robot file")
    tuned = plant_of(config.robot).reflected_inertia
    loop = ClosedLoop(config, plant=plant, commissioned=tuned)
    folder.mkdir(parents=True, exist_ok=True)
    recording = SessionRecording(config, text, "robot file", directory=folder, started_wall_ns=WALL_NS)
    every = round(COMMAND_S * config.loop.rate)
    number = 0

    def run(twist: Twist, seconds: float, requests: Sequence[Request] = ()) -> None:
        nonlocal number
        for place in range(round(seconds * config.loop.rate)):
            commands = (
                [TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)] if place % every == 0 else []
            )
            cycle = loop.cycle(commands=commands, requests=requests if place == 0 else ())
            assert all(reply.ok for reply in cycle[1].replies), cycle[1].replies
            recording.put(*cycle, loop.engine.snapshot)
            number += 1

    run(ZERO_TWIST, 0.5)
    names = [config.robot.motor_names()[place] for place in config.robot.kinematics().steered]
    joint = next((one.name for one in config.motor if one.encoder == "incremental" and one.name in names), None)
    run(ZERO_TWIST, 3.0, [Request(RequestKind.REFERENCE, 7, loop.next_ns, joint, 0.0)] if joint else [])
    assert loop.engine.mode is Mode.DRIVE
    found = []
    for name in plan:
        begin, start = number - 1, loop.bus.robot.truth.pose
        for leg in legs(name, length, config):
            run(leg.twist, leg.seconds)
            run(ZERO_TWIST, REST_S)
        x, y, turn = relative(start, loop.bus.robot.truth.pose)
        found.append(
            Course(
                course=name,
                length=length,
                session=str(recording.session),
                begin=begin,
                end=number - 1,
                x=x,
                y=y,
                turn=turn,
            )
        )
    recording.close()
    return Courses(robot=config.robot.name, course=found)


def relative(start: Pose, end: Pose) -> tuple[float, float, float]:
    """The end in the frame of the start."""
    c, s = cos(start.theta), sin(start.theta)
    x, y = end.x - start.x, end.y - start.y
    return c * x + s * y, c * y - s * x, end.theta - start.theta


def with_tape(courses: Courses, rng: np.random.Generator) -> Courses:
    """The same courses as a person measures them."""
    measured = []
    for one in courses.course:
        x, y, turn = map(float, tape_of(courses, np.array([one.x, one.y, one.turn]), rng))
        measured.append(one.model_copy(update={"x": x, "y": y, "turn": turn}))
    return courses.model_copy(update={"course": measured})
