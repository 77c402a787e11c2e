"""The dynamics of an ODD against MuJoCo: other equations, another geometry, the same robot and the same torques.

Bounds are about twice what was measured with MuJoCo 4.0. What remains: MuJoCo's robot nods between its balls by some
milliradians and rocks on its suspension, and its hubs weigh something; rollers creep, ripple and cost some force.
"""

from collections.abc import Callable
from math import cosh, hypot, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest

from gateway.chassis.odd import OddRobot
from gateway.config import load
from gateway.kinematics.odd import OddKinematics
from gateway.types import ZERO_TWIST, Mode, Pose, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.contract import Plant
from replay.sim.plants.odd_bodies import Leaning, parameters
from replay.sim.plants.odd_dynamics import OddDynamics
from tests.replay.mujoco_odd import REACH, MujocoOdd

ROBOT = Path(__file__).parents[2] / "deploy" / "robots" / "odd.toml"
HEIGHT = 0.0962  # m of the centre of mass on casters, 2 cm above the axle as MuJoCo's has it
TALL = Leaning(0.2, 0.25)
Torques = tuple[float, ...]
MOTIONS: dict[str, Torques] = {
    "forward": (0.5, 0.5, 0.5, 0.5),
    "left": (0.5, -0.5, 0.5, -0.5),
    "turning": (-0.2, -0.2, 0.2, 0.2),
    "apart": (0.1, -0.1, -0.1, 0.1),
    "all": (0.5, -0.06, 0.44, -0.06),
}


def robot(**body: float) -> OddRobot:
    found = load(ROBOT)[0].robot
    assert isinstance(found, OddRobot)
    return found.model_copy(
        update={
            "body": found.body.model_copy(
                update={"joint_friction": 0.0, "joint_drag": 0.0, "centre_height": HEIGHT} | body
            )
        }
    )


def plants(leaning: Leaning | None = None, *, rollers: bool = False) -> tuple[MujocoOdd, OddDynamics]:
    own = robot()
    p = parameters(own, leaning)._replace(caster_reach=None if leaning else REACH)
    return MujocoOdd(own, leaning, rollers=rollers), OddDynamics(p, width=own.width)


def motion(plant: MujocoOdd | OddDynamics) -> list[float]:
    """All four speeds and the width."""
    return [*plant.twist, plant.width_rate, plant.width]


def both(
    torques: Callable[[int], Torques], seconds: float, friction: float, leaning: Leaning | None = None
) -> tuple[MujocoOdd, OddDynamics]:
    contact, plant = plants(leaning)
    for joint in plant.wheels:
        contact.set_friction(joint, friction)
        plant.set_friction(joint, friction)
    for number in range(round(seconds / STEP_S)):
        contact.step(torques(number))
        plant.step(torques(number))
    return contact, plant


# -- grip -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("torques", MOTIONS.values(), ids=MOTIONS.keys())
def test_the_same_torques_give_the_same_motion(torques: Torques) -> None:
    """0.5 s from rest: speeds within 0.5 mm/s or mrad/s, the place within 0.4 mm."""
    contact, plant = both(lambda _: torques, 0.5, 1.0)
    assert plant.slipping == ()
    assert max(map(abs, plant.twist)) > 0.2 or plant.width_rate > 0.2
    assert motion(plant) == pytest.approx(motion(contact), abs=5e-4)
    assert list(plant.pose) == pytest.approx(list(contact.pose), abs=6e-4)
    assert plant.rates == pytest.approx(contact.rates, abs=0.02)
    assert plant.loads == pytest.approx(contact.loads, rel=0.08)


def swinging(number: int) -> Torques:
    """Every axis at a beat of its own, the slides far from their ends."""
    t = number * STEP_S
    x, y, turn, apart = (
        0.6 * sin(5.0 * t),
        0.5 * sin(7.0 * t + 1.0),
        0.25 * sin(4.0 * t + 2.0),
        0.1 * sin(11.0 * t + 1.6),
    )
    return x + y - turn + apart, x - y - turn - apart, x + y + turn - apart, x - y + turn + apart


def test_a_drive_through_everything() -> None:
    contact, plant = both(swinging, 1.5, 1.0)
    assert min(abs(plant.width - end) for end in (0.25, 0.6)) > 0.02
    assert motion(plant) == pytest.approx(motion(contact), abs=1.5e-3)
    assert list(plant.pose) == pytest.approx(list(contact.pose), abs=1e-3)


@pytest.mark.parametrize(("push", "slope"), [(10.0, 0.0), (0.0, 0.03)])
def test_push_and_slope(push: float, slope: float) -> None:
    contact, plant = plants()
    for one in (contact, plant):
        one.push, one.slope = push, slope
        for _ in range(500):
            one.step((0.0,) * 4)
    assert abs(plant.pose.x) > 0.02
    assert plant.pose.x == pytest.approx(contact.pose.x, rel=0.01)


def test_the_slides_end_alike() -> None:
    contact, plant = both(lambda _: (0.1, -0.1, -0.1, 0.1), 1.5, 1.0)
    assert plant.width == 0.6
    assert contact.width == pytest.approx(0.6, abs=1e-3)
    assert contact.width_rate == pytest.approx(0.0, abs=1e-3)


# -- slip -------------------------------------------------------------------------------------------------------------

SPINNING: dict[str, Torques] = {
    "forward": (3.0, 3.0, 3.0, 3.0),
    "left": (3.0, -3.0, 3.0, -3.0),
    "apart": (2.0, -2.0, -2.0, 2.0),
    "one of them": (0.0, 2.5, 0.0, 0.0),
}


@pytest.mark.parametrize("torques", SPINNING.values(), ids=SPINNING.keys())
def test_wheels_that_slip_push_alike(torques: Torques) -> None:
    contact, plant = both(lambda _: torques, 0.2, 0.3)
    assert plant.slipping == ((1,) if torques[0] == 0.0 else (0, 1, 2, 3))
    assert set(plant.slipping) <= set(contact.slipping)
    assert motion(plant)[:4] == pytest.approx(motion(contact)[:4], abs=0.04)
    assert plant.rates == pytest.approx(contact.rates, rel=0.03, abs=4.0)


# -- the pendulum -----------------------------------------------------------------------------------------------------


def test_a_free_fall() -> None:
    """From 0.01 rad: the same way down to 0.5 rad, and at first by the linear law."""
    contact, plant = plants(TALL)
    contact.lean(0.01)
    plant.lean(0.01)
    mass, joints = 20.0, 4.0 * 0.004
    whole, mixed = mass + joints / 0.0762**2, mass * TALL.height - joints / 0.0762
    own = TALL.pitch_inertia + mass * TALL.height**2 + joints - mixed * mixed / whole
    fast = sqrt(mass * 9.81 * TALL.height / own)
    for number in range(1, 500):
        contact.step((0.0,) * 4)
        plant.step((0.0,) * 4)
        if number == 200:
            assert plant.pitch == pytest.approx(0.01 * cosh(fast * 0.2), rel=2e-3)
            assert contact.pitch == pytest.approx(0.01 * cosh(fast * 0.2), rel=6e-3)
        if number % 100 == 99:
            assert plant.pitch == pytest.approx(contact.pitch, rel=0.012)
            assert plant.pitch_rate == pytest.approx(contact.pitch_rate, rel=0.012)
            assert plant.twist.vx == pytest.approx(contact.twist.vx, rel=0.012)
            assert plant.rates == pytest.approx(contact.rates, rel=0.012)
    assert plant.pitch > 0.5


def test_the_motors_throw_the_body_back_alike_while_it_turns_and_widens() -> None:
    contact, plant = plants(TALL)
    for one in (contact, plant):
        one.lean(0.05)
        for _ in range(300):
            one.step((0.2, 0.3, 0.5, 0.4))
    assert plant.pitch < -0.05
    assert abs(plant.twist.wz) > 0.1
    assert plant.pitch == pytest.approx(contact.pitch, abs=4e-3)
    assert plant.pitch_rate == pytest.approx(contact.pitch_rate, abs=0.05)
    assert motion(plant) == pytest.approx(motion(contact), abs=8e-3)
    assert plant.angles == pytest.approx(contact.angles, rel=0.01, abs=0.02)


# -- rollers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "target",
    [(0.4, 0.0, 0.0, 0.0), (0.0, 0.3, 0.0, 0.0), (0.0, 0.0, 0.8, 0.0), (0.0, 0.0, 0.0, 0.08), (0.4, 0.2, 0.3, 0.05)],
    ids=["forward", "left", "turning", "apart", "all"],
)
def test_wheels_with_rollers_move_it_as_the_kinematics_says(target: tuple[float, float, float, float]) -> None:
    """Mean of 1 s under a speed control of the wheels: the width goes by wheels alone. Creep takes 1 %."""
    contact, _ = plants(rollers=True)
    kinematics = robot().kinematics()
    assert isinstance(kinematics, OddKinematics)
    integral, found, told = np.zeros(4), list[list[float]](), list[list[float]]()
    for number in range(1500):
        kinematics.width.metres = contact.width
        due = kinematics.wheel_speeds(tuple(min(1.0, number / 400.0) * one for one in target))
        assert due is not None
        error = np.array(due) - contact.rates
        integral += 20.0 * STEP_S * error
        contact.step((error + integral).tolist())
        estimate = kinematics.twist(contact.rates)
        assert estimate is not None
        if number >= 500:
            found.append(motion(contact)[:4])
            told.append([*estimate.twist, *estimate.more])
    mean = np.mean(found, axis=0)
    assert mean == pytest.approx(np.mean(told, axis=0), rel=0.015, abs=4e-3)
    assert mean == pytest.approx(target, rel=0.03, abs=4e-3)


# -- behind the controllers -------------------------------------------------------------------------------------------

DRIVE = (
    (1.0, ZERO_TWIST, 0.0),
    (1.5, Twist(0.5, 0.0, 0.0), 0.0),
    (1.5, Twist(0.0, 0.4, 0.0), 0.05),
    (1.5, Twist(0.0, 0.0, 0.8), 0.0),
    (2.0, Twist(0.3, -0.2, 0.5), -0.06),
    (1.0, ZERO_TWIST, 0.0),
)


def driven(plant: Plant) -> tuple[list[Pose], Pose]:
    """Where it really was after each part, and where its odometry has it at the end."""
    loop = ClosedLoop(load(ROBOT)[0], plant=plant)
    truths = []
    for seconds, twist, rate in DRIVE:
        for index in range(round(seconds * 250)):
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns, width_rate=rate)
            loop.cycle(commands=[command] if index % 5 == 0 else [])
        truths.append(loop.bus.robot.truth.pose)
    assert loop.engine.mode is Mode.DRIVE
    return truths, loop.cycle()[1].trace.pose


def test_a_drive_of_the_service_ends_where_the_plant_has_it() -> None:
    own = load(ROBOT)[0].robot
    assert isinstance(own, OddRobot)
    plant = OddDynamics(parameters(own), width=own.width)
    contact = MujocoOdd(own)
    (expected, _), (truths, odometry) = driven(plant), driven(contact)
    assert expected[-1].theta > 1.5
    for one, other in zip(expected, truths, strict=True):
        assert hypot(one.x - other.x, one.y - other.y) < 5e-3
        assert abs((one.theta - other.theta + pi) % (2.0 * pi) - pi) < 4e-3
    assert contact.width == pytest.approx(plant.width, abs=2e-3)
    assert hypot(odometry.x - truths[-1].x, odometry.y - truths[-1].y) < 8e-3
