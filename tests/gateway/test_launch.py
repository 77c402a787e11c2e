"""The no-slip launch: on a floor that gives so much and no more, in eight directions, and by what each motor can."""

from collections.abc import Sequence
from itertools import combinations
from math import cos, hypot, pi, sin, sqrt

import numpy as np
import pytest

from drivers.setpoint import CommandKind
from gateway.chassis.omni import OmniRobot
from gateway.config import ConfigError, parse
from gateway.control.decoupled import Decoupled, Saturation
from gateway.control.drive_law import JointCommand, Measured, SpeedLaw
from gateway.control.grip import Grip, part_of
from gateway.control.launch import LaunchLaw, Pusher
from gateway.control.launch_slip import Losses
from gateway.control.limits import TwistLimiter, turning_excess
from gateway.control.transmission import Winding
from gateway.control.wheel_limits import WheelLimits
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.types import ZERO_TWIST, Mode, Twist
from tests.world import World, robot_text

MASS, RADIUS, TOP = 25.0, 0.0762, 1.2  # kg, m; m/s of the course
WHEELS = ("front_left", "rear_left", "rear_right", "front_right")
DT = 0.004


def eager(text: str) -> str:
    """Body limits beyond what any floor here gives; and no height, as this plant shifts no loads."""
    for old, new in (
        ("centre_height", "# centre_height"),
        ("acceleration = { vx = 2.0, vy = 1.5, wz = 6.0 }", "acceleration = { vx = 9.0, vy = 9.0, wz = 30.0 }"),
        ("jerk = { vx = 15.0, vy = 12.0, wz = 40.0 }", "jerk = { vx = 150.0, vy = 150.0, wz = 400.0 }"),
    ):
        assert old in text
        text = text.replace(old, new)
    return text


def gripping(text: str, friction: float = 0.8) -> str:
    return eager(text).replace("[loop]", f"[robot.grip]\nfriction = {friction}\n\n[loop]", 1)


def direction(eighth: int) -> tuple[float, float]:
    return cos(eighth * pi / 4), sin(eighth * pi / 4)


class Course:
    """Launch, drive and stop on a floor of this friction; what really happened."""

    def __init__(self, eighth: int, friction: float, *, told: float | None, seconds: float = 1.5) -> None:
        world = self.world = World("omni4", edit=eager if told is None else lambda text: gripping(text, told))
        world.start()
        for name in WHEELS:
            world.bus.robot.set_friction(name, friction)
        self.speeds: list[float] = []
        self.slips: list[float] = []
        self.limits: set[str] = set()
        x, y = self.direction = direction(eighth)
        self._drive(Twist(TOP * x, TOP * y, 0.0), seconds)
        self.launched = len(self.speeds)
        self._drive(ZERO_TWIST, seconds)

    def _drive(self, twist: Twist, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            outputs = self.world.cycle(commands=[self.world.command(twist)])
            truth = self.world.bus.robot.truth
            rolling = self.world.config.robot.kinematics().wheel_speeds(truth.twist, ())
            assert rolling is not None
            gaps = [abs(rate - roll) for rate, roll in zip(truth.joint_rates, rolling, strict=True)]
            self.speeds.append(hypot(*truth.twist[:2]))
            self.slips.append(RADIUS * max(gaps))
            if outputs.status is not None:
                self.limits |= set(outputs.status.limits_active)

    @property
    def acceleration(self) -> float:
        """m/s^2, from a fifth to four fifths of the speed."""
        times = np.arange(self.launched) * DT
        low, high = np.interp([0.2 * TOP, 0.8 * TOP], self.speeds[: self.launched], times)
        return 0.6 * TOP / float(high - low)

    @property
    def slip(self) -> float:
        """Largest part of the speed by which a wheel slips in the launch, from 0.05 m/s on."""
        pairs = zip(self.slips[: self.launched], self.speeds[: self.launched], strict=True)
        return max(slip / max(speed, 0.05) for slip, speed in pairs)

    @property
    def odometry_error(self) -> float:
        told, true = self.world.last.trace.pose, self.world.bus.robot.truth.pose
        return hypot(told.x - true.x, told.y - true.y)

    @property
    def path_error(self) -> float:
        (x, y), pose = self.direction, self.world.bus.robot.truth.pose
        return abs(x * pose.y - y * pose.x)


def floor(eighth: int, friction: float) -> float:
    """The most that four equally loaded wheels give, by the dual of the linear program over their forces."""
    angles = [pi / 3, 2 * pi / 3, 4 * pi / 3, 5 * pi / 3]
    rows = np.array([(-sin(a), cos(a), 0.2) for a in angles])
    wrench = MASS * np.array([*direction(eighth), 0.0])
    most = friction * MASS * 9.81 / 4.0
    normals = [np.cross(a, b) for a, b in combinations(rows, 2)]
    return min(
        float(most * np.abs(rows @ normal).sum() / abs(normal @ wrench))
        for normal in normals
        if abs(normal @ wrench) > 1e-9
    )


@pytest.mark.parametrize("eighth", range(8))
@pytest.mark.parametrize("friction", [0.8, 0.3])
def test_a_launch_takes_what_the_floor_gives_and_does_not_slip(friction: float, eighth: int) -> None:
    course = Course(eighth, friction, told=friction)
    assert course.acceleration >= 0.95 * floor(eighth, friction)
    assert course.slip < 0.02
    assert course.odometry_error < 0.004
    assert course.path_error < 0.004
    assert "grip" in course.limits
    assert "launch_slipped" not in course.world.codes()


@pytest.mark.parametrize(("eighth", "friction"), [(0, 0.3), (1, 0.8), (1, 0.3), (2, 0.3)])
def test_a_plain_ramp_slips_there_and_loses_its_way(eighth: int, friction: float) -> None:
    plain, careful = Course(eighth, friction, told=None), Course(eighth, friction, told=friction)
    assert plain.slip > 0.02
    assert plain.odometry_error > 10.0 * careful.odometry_error
    assert plain.odometry_error > 0.02


@pytest.mark.parametrize("eighth", [0, 1, 2, 3])
def test_a_launch_that_slips_backs_off_and_learns(eighth: int) -> None:
    """The robot file says 0.8 where the floor gives 0.3."""
    course = Course(eighth, 0.3, told=0.8, seconds=2.0)
    assert course.world.codes().count("launch_slipped") in (1, 2)
    law = course.world.engine._law
    assert isinstance(law, LaunchLaw)
    assert 0.2 < law.friction <= 0.3
    assert course.odometry_error < 0.01
    settled = slice(round(0.4 / DT), course.launched)
    assert max(course.slips[settled]) < 0.01  # m/s; where the ramp ends too
    status = next(out.status for _, out in reversed(course.world.records) if out.status is not None)
    assert status.chassis == {"friction": law.friction, "launch": False}


def test_what_was_learned_is_in_the_snapshot() -> None:
    course = Course(0, 0.3, told=0.8, seconds=0.4)
    engine = course.world.engine
    other = Engine(course.world.config, engine.snapshot())
    assert isinstance(other._law, LaunchLaw)
    assert isinstance(engine._law, LaunchLaw)
    assert other._law.friction == engine._law.friction < 0.8
    for _ in range(100):
        inputs, outputs = course.world.loop.cycle(commands=[course.world.command(Twist(0.5, 0.2, 0.0))])
        assert other.step(inputs) == outputs


def test_on_a_floor_that_grips_nothing_is_learned() -> None:
    world = World("omni4", edit=gripping)
    world.start()
    for twist in (
        Twist(1.0, 0.0, 1.0),
        Twist(-0.8, 0.8, 0.0),
        Twist(0.0, -1.0, -2.0),
        Twist(1.5, 0.3, 0.5),
        ZERO_TWIST,
    ):
        world.run(0.8, twist)
    assert "launch_slipped" not in world.codes()
    assert world.is_in(Mode.DRIVE)


def test_a_heavier_robot_than_told_is_held_back_and_no_slip_is_seen() -> None:
    world = World("omni4", edit=gripping)
    world.start()
    world.bus.robot.set_mass(40.0)
    world.run(1.0, Twist(1.0, 0.0, 0.0))
    world.run(1.0, ZERO_TWIST)
    assert "launch_slipped" not in world.codes()
    assert world.true_speed() < 0.02


def test_a_stop_that_nobody_commanded_is_not_made_longer() -> None:
    """Silence: as fast as the limits say, which is more than the floor would give; and no torque is limited."""
    world = World("omni4", edit=lambda text: gripping(text, 0.1))
    world.start()
    world.run(3.0, Twist(1.0, 0.0, 0.0))
    begun = None
    for index in range(400):
        outputs = world.cycle()
        if outputs.mode is Mode.STOPPING and begun is None:
            begun = index
        if begun is not None and outputs.trace.setpoint == ZERO_TWIST:
            break
    assert begun is not None
    assert (index - begun) * DT < 1.0 / 9.0 + 9.0 / 150.0 + 0.05


def test_without_its_section_nothing_is_new() -> None:
    assert type(build(parse(robot_text("omni4"), "omni4")).law) is SpeedLaw


@pytest.mark.parametrize("friction", ["0.01", "3.0", '"high"'])
def test_friction_has_a_range(friction: str) -> None:
    with pytest.raises(ConfigError, match=r"grip\.friction"):
        parse(gripping(robot_text("omni4"), 0.5).replace("friction = 0.5", f"friction = {friction}"), "omni4")


def test_a_centre_outside_the_wheels_is_a_bad_robot_file() -> None:
    text = gripping(robot_text("omni4"))
    for x in ("0.10", "-0.10"):
        text = text.replace(f"x = {x}\n", f"x = {float(x) + 0.3}\n")
    with pytest.raises(ConfigError, match=r"robot\.grip: wheel \d carries -"):
        build(parse(text, "omni4"))


# the law alone

LIMITS = (9.0, 9.0, 30.0)


def launch_law(pusher: Pusher, *, friction: float = 0.6, height: float = 0.1, inertia: float = 0.0) -> LaunchLaw:
    robot = parse(robot_text("omni4"), "omni4").robot
    assert isinstance(robot, OmniRobot)
    kinematics = robot.kinematics()
    speeds = SpeedLaw(kinematics, top_speeds=[45.0] * 4, velocity=(2.0, 1.5, 4.0), period=DT)
    places = [(wheel.x, wheel.y) for wheel in robot.wheel]
    return LaunchLaw(
        speeds,
        grip=Grip(kinematics.rim_matrix, places, mass=MASS, inertia=0.9, height=height),
        friction=friction,
        radii=[RADIUS] * 4,
        losses=Losses(inertia, 0.0, 0.0),
        acceleration=LIMITS,
        top_speeds=[45.0] * 4,
        pushers=[pusher] * 4,
    )


def measured(speeds: Sequence[float | None], torques: Sequence[float | None] = (None,) * 4) -> Measured:
    return Measured(0, DT, tuple(speeds), (0.0,) * 4, tuple(torques), (0,) * 4, (0.0,) * 4)


def ramp(law: LaunchLaw, rate: float, cycles: int, *, braking: bool = False) -> list[tuple[JointCommand, ...]]:
    """Forward at this acceleration, with wheels that turn as told."""
    found = []
    for cycle in range(cycles + 1):
        setpoint = (rate * DT * cycle, 0.0, 0.0)
        law.ground(whole=True)
        turning = [rate * DT * max(cycle - 1, 0) * part / RADIUS for part in (-sqrt(0.75), -sqrt(0.75), sqrt(0.75))]
        now = measured([turning[0], turning[1], turning[2], turning[2]])
        found.append(law.motion(setpoint, now, braking=braking).commands)
    return found


def test_torque_is_shared_by_load() -> None:
    """Forward at 4 m/s^2 the rear wheels carry 86.3 N and the front ones 36.3 N; together they push 100 N."""
    front, rear = ramp(launch_law(Pusher(True, True, hosted=False)), 4.0, 3)[-1][:2]
    assert front.feed_forward / rear.feed_forward == pytest.approx(-29.46 / -93.16, abs=0.002)  # as loads at the limit
    assert -2.0 * sqrt(0.75) * (front.feed_forward + rear.feed_forward) / RADIUS == pytest.approx(100.0)
    assert front.limit == pytest.approx(0.6 * RADIUS * 36.31, abs=1e-3)
    assert rear.limit == pytest.approx(0.6 * RADIUS * 86.31, abs=1e-3)


def test_a_stop_is_not_limited_and_pushes_no_more_than_the_floor_gives() -> None:
    commands = ramp(launch_law(Pusher(True, True, hosted=False)), 8.0, 3, braking=True)[-1]
    assert {command.limit for command in commands} == {None}
    assert sum(abs(command.feed_forward) for command in commands) == pytest.approx(0.6 * RADIUS * MASS * 9.81)


def test_a_motor_that_takes_only_a_speed_gets_the_ramp() -> None:
    for limit in (False, True):
        commands = ramp(launch_law(Pusher(False, limit, hosted=False)), 4.0, 3)[-1]
        assert {command.kind for command in commands} == {CommandKind.VELOCITY}
        assert {command.feed_forward for command in commands} == {0.0}
        assert all((command.limit is not None) == limit for command in commands)
        assert commands[2].value == pytest.approx(4.0 * 3 * DT * sqrt(0.75) / RADIUS)


def test_a_robot_that_is_not_whole_is_not_pushed() -> None:
    law = launch_law(Pusher(True, True, hosted=False))
    for cycle in range(3):
        setpoint = (0.016 * cycle, 0.0, 0.0)
        law.ground(whole=False)
        commands = law.motion(setpoint, measured([0.0] * 4), braking=False).commands
    assert {(command.feed_forward, command.limit) for command in commands} == {(0.0, None)}


KEPT = {Saturation.BOTH: (), Saturation.TRANSLATION: (0, 1), Saturation.ROTATION: (2,)}  # axes that are never cut


def on_course(saturation: Saturation) -> TwistLimiter:
    robot = parse(robot_text("omni4"), "omni4").robot
    wheels = WheelLimits(robot.kinematics().matrix(), speeds=[45.0] * 4)
    velocity, jerk, course = (2.0, 1.5, 4.0), (150.0, 150.0, 400.0), None
    if saturation is not Saturation.BOTH:
        course = Decoupled(saturation, velocity=velocity, acceleration=LIMITS, jerk=jerk, wheels=wheels)
    return TwistLimiter(velocity=velocity, acceleration=LIMITS, jerk=jerk, course=course)


@pytest.mark.parametrize("saturation", Saturation)
def test_what_the_setpoint_asks_of_the_floor_it_gives(saturation: Saturation) -> None:
    """Through the limiter, in curves too: dv/dt + w x v stays within the polytope of the floor, but for its steps."""
    law = launch_law(Pusher(True, True, hosted=False), friction=0.4)
    limits = [*[cone.limit for cone in law._grip.cones(0.4)], *law._grip.lifting()]
    moving, worst = on_course(saturation), 0.0
    for target in ((1.5, 0.5, 0.0), (0.5, 0.0, 3.0), (-0.5, 1.0, -1.0), (1.5, 1.0, 2.0), (0.0, 0.0, 0.0)):
        for _ in range(400):
            before = moving.rates
            moving.step(target, DT, ground=law.ground(whole=True))
            mean = [0.5 * (a + b) for a, b in zip(before, moving.rates, strict=True)]
            ax, ay, az = [(b - a) / DT for a, b in zip(before, moving.rates, strict=True)]
            worst = max(worst, part_of(limits, (ax - mean[2] * mean[1], ay + mean[2] * mean[0], az)))
        turning = max(law.turning(target), turning_excess(target, LIMITS))
        assert law.turning(moving.rates) == pytest.approx(min(turning, 1.0), abs=1e-6)
        cut = [1.0 / sqrt(max(1.0, turning))] * 3 if saturation is Saturation.BOTH else [1.0 / max(1.0, turning)] * 3
        for axis in KEPT[saturation]:
            cut[axis] = 1.0
        assert moving.rates == pytest.approx([a * b for a, b in zip(target, cut, strict=True)], abs=1e-6)
    assert worst < 1.1


@pytest.mark.parametrize("saturation", [Saturation.TRANSLATION, Saturation.ROTATION])
def test_what_is_first_is_launched_as_hard_as_it_would_be_alone(saturation: Saturation) -> None:
    first = KEPT[saturation]
    alone, beside = on_course(saturation), on_course(saturation)
    law = launch_law(Pusher(True, True, hosted=False), friction=0.4)
    whole = (1.0, 0.4, 1.5)
    part = tuple(axis if index in first else 0.0 for index, axis in enumerate(whole))
    for _ in range(60):
        alone.step(part, DT, ground=law.ground(whole=True))
        beside.step(whole, DT, ground=law.ground(whole=True))
        for axis in first:
            assert abs(beside.rates[axis]) >= 0.9 * abs(alone.rates[axis])


# by voltage

WINDING = Winding(resistance=0.45, back_emf=0.3)
STEPPED = Pusher(False, False, hosted=False, winding=WINDING, supply=24.0)


class Motors:
    """Four DC motors under a quarter of the robot each, driven by voltage or exactly at their speed."""

    def __init__(self, weight: float = 1.0) -> None:
        self.speeds = [0.0] * 4
        self.inertia = weight * MASS * RADIUS * RADIUS / 4.0 / 0.75  # forward, four wheels at 30 degrees

    def obey(self, commands: Sequence[JointCommand]) -> None:
        for index, command in enumerate(commands):
            if command.kind is CommandKind.VOLTAGE:
                torque = (command.value - WINDING.back_emf * self.speeds[index]) / WINDING.volts_per_torque
                self.speeds[index] += DT * torque / self.inertia
            else:
                self.speeds[index] = command.value


def test_voltage_steps_until_the_ramp_ends_then_a_speed_without_a_step() -> None:
    law, motors, speed, kinds, steps = (
        launch_law(STEPPED, height=0.0),
        Motors(1.1),
        0.0,
        [],
        [],
    )
    for cycle in range(150):
        speed += 4.0 * DT if 1 <= cycle < 80 else 0.0
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured(motors.speeds), braking=False)
        speed *= motion.share
        before = list(motors.speeds)
        motors.obey(motion.commands)
        kinds.append(motion.commands[0].kind)
        steps.append(max(abs(a - b) for a, b in zip(before, motors.speeds, strict=True)))
    assert kinds[1:80] == [CommandKind.VOLTAGE] * 79
    assert kinds[80:] == [CommandKind.VELOCITY] * 70
    assert max(steps[80:]) < 0.05  # rad/s: the robot is a tenth heavier than told, so its wheels were behind
    assert speed == pytest.approx(79 * 4.0 * DT / 1.1, rel=0.1)


def test_wheels_that_do_not_follow_their_voltage_are_told_a_speed_until_rest() -> None:
    law, kinds = launch_law(STEPPED, height=0.0), []
    speed = 0.0
    for cycle in range(200):
        speed += 4.0 * DT if cycle >= 1 else 0.0
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured([0.0] * 4), braking=False)  # against a wall
        speed *= motion.share
        kinds.append(motion.commands[0].kind)
    assert CommandKind.VOLTAGE in kinds
    ended = len(kinds) - kinds[::-1].index(CommandKind.VOLTAGE)
    assert kinds[ended:] == [CommandKind.VELOCITY] * (200 - ended)
    assert ended < 80
