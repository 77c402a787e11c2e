"""What `<robot>/reachable` tells of moby after each loss, driven: by the simple plant and by MuJoCo.

The whole path: the loss is found from feedback, the published twists are commanded forwards and backwards, and the true
body twist is held to what the core told, cycle by cycle. Bounds are twice what was measured.
"""

from collections.abc import Callable, Sequence
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np
import pytest

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import parse
from gateway.edges import messages
from gateway.kinematics.reachable import JointUse, reachable
from gateway.types import ZERO_TWIST, AbilityStatus, Mode, Outputs, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.offset_differential import plant as simple_plant
from replay.sim.plants.rigid_body import RigidBody
from tests.replay.mujoco_plant import offset_differential
from tests.world import robot_text

MOTORS = ("left", "right", "platform")
LIMP = '[degraded]\nmotor_lost = "limp"\nspeed = 0.3\n\n[limits]'
D1 = 0.25  # m


class Braked:
    """The simple plant with a brake: a torque against whatever turns a joint."""

    def __init__(self, plant: RigidBody) -> None:
        self._plant = plant
        self._held: int | None = None

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever the plant has
        return getattr(self._plant, name)

    def brake(self, joint: int) -> None:
        self._held = joint

    def step(self, torques: Sequence[float]) -> None:
        acting = list(torques)
        if self._held is not None:
            acting[self._held] -= 300.0 * self._plant.reflected_inertia[self._held] * self._plant.rates[self._held]
        self._plant.step(acting)


def simple(robot: OffsetDifferentialRobot) -> Any:  # noqa: ANN401 - a Plant that forwards what it does not change
    return Braked(simple_plant(robot))


PLANTS: dict[str, Callable[[OffsetDifferentialRobot], Any]] = {"simple": simple, "mujoco": offset_differential}


class Loss(NamedTuple):
    """A motor, what becomes of its joint, the angle of the platform's joint at the start, rad.

    `extreme`, `mixed`: how far the truth was from what was told at the most, m/s and rad/s, along a published way and
    along a twist that has something of all ways; None: nobody drives that.
    """

    motor: str
    use: str
    joint: float
    extreme: tuple[float, float | None]
    mixed: tuple[float, float | None]

    @property
    def name(self) -> str:
        return f"{self.motor}-{self.use}"


LOSSES = (
    Loss("platform", "free", 0.5, extreme=(0.011, None), mixed=(0.011, None)),
    Loss("platform", "held", 2.0, extreme=(0.007, 0.026), mixed=(0.008, 0.026)),
    Loss("left", "free", 0.5, extreme=(0.042, 0.132), mixed=(0.036, 0.118)),
    Loss("left", "held", 0.5, extreme=(0.006, 0.023), mixed=(0.022, 0.078)),
)
MIRRORED = (
    Loss("right", "free", 2.5, extreme=(0.032, 0.134), mixed=(0.032, 0.111)),
    Loss("right", "held", 2.5, extreme=(0.006, 0.023), mixed=(0.034, 0.106)),
)
DRIVEN = [(loss, plant) for loss in LOSSES for plant in PLANTS] + [(loss, "mujoco") for loss in MIRRORED]
DRAGGED = 0.01  # rad/s by which a platform that is dragged may be faster than what drags it
Driven = tuple[Outputs, Twist]  # a cycle and the true twist after it
ALONG = (Twist(-0.3, 0.3, 0.3), Twist(0.3, 0.3, -0.3), Twist(0.3, -0.3, 0.3), Twist(-0.3, -0.3, -0.3))


def moby(text: str) -> OffsetDifferentialRobot:
    robot = parse(text, "moby").robot
    assert isinstance(robot, OffsetDifferentialRobot)
    return robot


class Limping:
    """moby in DEGRADED, at rest, and what it published of itself."""

    def __init__(self, loss: Loss, plant: str) -> None:
        text = robot_text("moby").replace("[limits]", LIMP, 1)
        named = f'name = "{loss.motor}"\n'
        text = text.replace(named, f'{named}when_lost = "{loss.use}"\n', 1)
        one = PLANTS[plant](moby(text))
        self.loop = ClosedLoop(parse(text, "moby"), plant=one, joint_angles={"platform": loss.joint})
        self.drive(1.0, ZERO_TWIST)
        self.loop.bus.robot.drivetrain(loss.motor).gain = 0.0
        if loss.use == "held":
            one.brake(MOTORS.index(loss.motor))
        for twist in ALONG * 2:
            if self.loop.engine.mode is Mode.DRIVE:
                self.drive(1.0, twist)
        assert self.loop.engine.mode is Mode.DEGRADED

    def drive(self, seconds: float, twist: Twist) -> list[Driven]:
        """Every cycle, and the true twist in it."""
        found = []
        for index in range(round(seconds * 250.0)):
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, self.loop.next_ns)
            _, outputs = self.loop.cycle(commands=[command] if index % 5 == 0 else [])
            found.append((outputs, self.loop.bus.robot.truth.twist))
        return found

    def rest(self) -> AbilityStatus:
        """Come to rest; what is published there, as somebody who listens reads it."""
        drive = self.drive(1.5, ZERO_TWIST)
        status = next(outputs.status for outputs, _ in reversed(drive) if outputs.status)
        told = messages.decode_ability(messages.encode_ability(status.ability, self.loop.now_ns))
        assert told is not None
        return told.ability


@pytest.mark.parametrize(("loss", "plant"), DRIVEN, ids=lambda one: one if isinstance(one, str) else one.name)
def test_the_robot_drives_what_it_says_it_can_and_misses_what_it_says_it_misses(loss: Loss, plant: str) -> None:
    """Each published way, forwards and backwards, at its end; nothing along the way that is lost; and some of all.

    The error told is target less setpoint, the error seen target less truth: they differ by setpoint less truth.
    A wheel that rolls along carries what it has gained: there the truth lags furthest behind what is told.
    """
    robot = Limping(loss, plant)
    for way in range(2):
        for sign in (1.0, -1.0):
            ability = robot.rest()
            assert ability.rank == len(ability.reachable) == 2
            drive = robot.drive(1.2, Twist(*[sign * part for part in ability.reachable[way]]))
            assert max(used(outputs.trace.setpoint) for outputs, _ in drive) > 0.75, "it gets to the end of it"
            assert_told(drive, *loss.extreme)
    (lost,) = robot.rest().lost
    drive = robot.drive(1.2, lost)
    assert max(abs(part) for outputs, _ in drive for part in outputs.trace.setpoint) < 1e-3
    if loss.extreme[1] is not None:  # else the platform may still turn on from before
        assert max(abs(part) for _, truth in drive for part in truth) < 2e-3  # measured 8e-4
    for twist in (Twist(0.3, 0.2, 0.25), Twist(-0.2, 0.3, -0.25)):
        robot.rest()
        drive = robot.drive(1.2, twist)
        gaps = [abs(a - b) for outputs, _ in drive[100:] for a, b in zip(twist, outputs.trace.setpoint, strict=True)]
        assert max(gaps) > 0.025, "something is missing once the ramp is over"
        assert_told(drive, *loss.mixed)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("use", [JointUse.FREE, JointUse.HELD])
@pytest.mark.parametrize("lost", range(3), ids=MOTORS)
def test_whatever_the_motors_left_push_leads_into_the_reachable_twists(lost: int, use: JointUse, plant: str) -> None:
    """From rest, 40 ms of random torques, no friction: of the energy at most 0.16 % lies outside (measured)."""
    robot = moby(robot_text("moby"))
    robot = robot.model_copy(update={"body": robot.body.model_copy(update={"joint_drag": 0.0, "joint_friction": 0.0})})
    random = np.random.default_rng(lost)
    for angle in np.linspace(-3.0, 3.0, 8):
        one = PLANTS[plant](robot)
        one.place((0.0, 0.0, float(angle)))
        if use is JointUse.HELD:
            one.brake(lost)
        torques = random.uniform(-1.0, 1.0, 3) * (20.0, 20.0, 40.0)
        torques[lost] = 0.0
        for _ in range(round(0.04 / STEP_S)):
            one.step(tuple(torques))
        inertia = robot.inertia(one.angles)
        uses = [use if joint == lost else JointUse.USABLE for joint in range(3)]
        nearest = reachable(robot.kinematics().matrix(one.angles), uses, inertia).nearest(one.twist)
        outside = np.subtract(one.twist, nearest)
        assert outside @ np.array(inertia) @ outside < 0.0032 * (np.array(one.twist) @ inertia @ one.twist)


def used(setpoint: Twist) -> float:
    """Share of the limits of a limping moby: 0.3 of 1.2 m/s and of 1 rad/s."""
    return max(abs(setpoint.vx) / 0.36, abs(setpoint.vy) / 0.36, abs(setpoint.wz) / 0.3)


def assert_told(drive: list[Driven], way: float, turn: float | None) -> None:
    """The truth is what is told. Yaw that nobody drives is dragged by the chassis, and never faster than that."""
    dragging = abs(drive[0][1].wz)
    for outputs, truth in drive:
        setpoint, angle = outputs.trace.setpoint, outputs.trace.wheel_positions[2]
        assert outputs.mode is Mode.DEGRADED
        assert setpoint[:2] == pytest.approx(truth[:2], abs=2.0 * way)
        if turn is not None:
            assert setpoint.wz == pytest.approx(truth.wz, abs=2.0 * turn)
            continue
        assert angle is not None
        assert setpoint.wz == pytest.approx(0.0, abs=1e-9)
        dragging = max(dragging, abs(sin(angle) * truth.vx + cos(angle) * truth.vy) / D1)
        assert abs(truth.wz) < dragging + DRAGGED
