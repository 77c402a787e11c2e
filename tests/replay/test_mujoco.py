"""The simple plant against MuJoCo: other equations, another geometry, the same robot and the same drive.

The bounds are about twice what was measured with MuJoCo 4.0. What remains is the contact's: wheels creep, and rollers
take some rolling resistance, which a speed loop makes up for.
"""

from math import hypot
from pathlib import Path
from typing import NamedTuple

import pytest

from gateway.config import load
from gateway.types import ZERO_TWIST, Mode, Pose, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant
from tests.replay.mujoco_plant import MUJOCO_PLANTS

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
# Seconds and twists: forward, sideways, on the spot, everything at once, back, and to rest; about 3 m of way.
DRIVE = (
    (1.0, ZERO_TWIST),
    (1.5, Twist(0.6, 0.0, 0.0)),
    (1.5, Twist(0.0, 0.5, 0.0)),
    (1.5, Twist(0.0, 0.0, 0.8)),
    (2.0, Twist(0.4, -0.3, 0.6)),
    (1.5, Twist(-0.5, 0.0, 0.0)),
    (1.5, ZERO_TWIST),
)


class Bounds(NamedTuple):
    """Torques that move every axis at once, and how far MuJoCo may be from the simple plant (or the kinematics)."""

    torques: tuple[float, ...]  # N m
    way: float  # m after 1 s under these torques
    turn: float  # rad
    rate: float  # rad/s between a joint and what the kinematics makes of the body twist


BOUNDS = {
    "moby": Bounds((3.0, 5.0, -2.0), way=0.004, turn=0.002, rate=0.008),
    "omni4": Bounds((-1.0, 0.4, 1.2, 0.9), way=0.010, turn=0.045, rate=0.2),
}
every = pytest.mark.parametrize("name", BOUNDS)


def plants(name: str, **body: float) -> tuple[Plant, Plant]:
    robot = load(ROBOTS / f"{name}.toml")[0].robot
    robot = robot.model_copy(update={"body": robot.body.model_copy(update=body)})
    return plant_of(robot), MUJOCO_PLANTS[robot.kind](robot)


def run(plant: Plant, seconds: float, torques: tuple[float, ...] = ()) -> Pose:
    for _ in range(round(seconds / STEP_S)):
        plant.step(torques or (0.0,) * len(plant.angles))
    return plant.pose


def drive(name: str, plant: Plant) -> tuple[list[Pose], Pose]:
    """Where the robot really was after each part of the drive, and where its odometry has it at the end."""
    loop = ClosedLoop(load(ROBOTS / f"{name}.toml")[0], plant=plant)
    truths = []
    for seconds, twist in DRIVE:
        for index in range(round(seconds * 250)):
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)
            loop.cycle(commands=[command] if index % 5 == 0 else [])
        truths.append(loop.bus.robot.truth.pose)
    assert loop.engine.mode is Mode.DRIVE
    return truths, loop.cycle()[1].trace.pose


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Metres and radians."""
    return hypot(one.x - other.x, one.y - other.y), abs(one.theta - other.theta)


@every
def test_a_drive_ends_where_the_simple_plant_has_it(name: str) -> None:
    """The whole chain behind both: within 8 mm and 5 mrad after every part; the odometry as near to the truth."""
    simple, contact = plants(name)
    (expected, _), (truths, odometry) = drive(name, simple), drive(name, contact)
    assert expected[-1].x > 1.5, "it went somewhere"
    assert expected[-1].y > 1.0
    assert expected[-1].theta > 2.0
    for one, other in zip(expected, truths, strict=True):
        way, turn = apart(one, other)
        assert way < 0.008
        assert turn < 0.005
    way, turn = apart(odometry, truths[-1])
    assert way < 0.008
    assert turn < 0.005


@every
def test_the_same_torques_give_the_same_motion(name: str) -> None:
    """No controller in between: masses, inertias, friction and geometry alone.

    Without dry friction: near rest the simple plant lets it fade, and MuJoCo does not.
    """
    bounds = BOUNDS[name]
    simple, contact = plants(name, joint_drag=0.0)
    way, turn = apart(run(simple, 1.0, bounds.torques), run(contact, 1.0, bounds.torques))
    assert min(map(abs, simple.pose)) > 0.03, "every axis moved"
    assert way < bounds.way
    assert turn < bounds.turn
    assert contact.energy == pytest.approx(simple.energy, rel=0.04)


@every
def test_wheels_that_grip_turn_as_the_kinematics_says(name: str) -> None:
    robot = load(ROBOTS / f"{name}.toml")[0].robot
    _, contact = plants(name)
    for _ in range(20):
        run(contact, 0.05, BOUNDS[name].torques)
        assert contact.slipping == ()
        speeds = robot.kinematics().wheel_speeds(contact.twist, contact.angles)
        assert contact.rates == pytest.approx(speeds, abs=BOUNDS[name].rate)


@every
def test_a_placed_joint_turns_the_chassis_under_the_origin(name: str) -> None:
    _, contact = plants(name)
    angles = (0.3, -0.2, 1.1, 0.4)[: len(contact.angles)]
    contact.place(angles)
    run(contact, 0.2)
    assert contact.angles == pytest.approx(angles, abs=1e-3)
    assert contact.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert contact.chassis_angle == pytest.approx(-1.1 if name == "moby" else 0.0, abs=1e-3)


@every
@pytest.mark.parametrize(("mass", "push", "slope"), [(None, 40.0, 0.0), (None, 0.0, 0.04), (300.0, 120.0, 0.0)])
def test_push_slope_and_mass_act_as_on_the_simple_plant(
    name: str, mass: float | None, push: float, slope: float
) -> None:
    simple, contact = plants(name, joint_drag=0.0)
    for plant in (simple, contact):
        plant.set_mass(mass)
        plant.push, plant.slope = push, slope
    assert run(contact, 0.5).x == pytest.approx(run(simple, 0.5).x, rel=0.05)


@every
def test_a_load_in_motion_slows_as_the_simple_plant_and_leaves_the_speed(name: str) -> None:
    """Three times the mass, and a moment for the body to come to rest on its contacts: it sinks and rocks.

    Rolling on the rollers under that weight costs some speed, 4 % until then.
    """
    ways = []
    mass = 3.0 * load(ROBOTS / f"{name}.toml")[0].robot.body.mass
    for plant in plants(name, joint_drag=0.0):
        plant.push = 100.0
        run(plant, 0.3)
        plant.push, fast = 0.0, plant.twist.vx
        plant.set_mass(mass)
        start = run(plant, 0.3).x
        ways.append(run(plant, 0.3).x - start)
        assert 0.28 * fast < ways[-1] / 0.3 < 0.4 * fast
        slow = plant.twist
        plant.set_mass(None)
        assert plant.twist == slow
    assert ways[1] == pytest.approx(ways[0], rel=0.1)


@every
def test_every_wheel_slips_on_ice(name: str) -> None:
    _, contact = plants(name)
    for joint in contact.wheels:
        contact.set_friction(joint, 0.02)
    run(contact, 0.3, {"moby": (60.0, 60.0, 0.0), "omni4": (-8.0, -8.0, 8.0, 8.0)}[name])
    assert contact.slipping == contact.wheels
    assert 0.01 < contact.twist.vx < 0.02 * 9.81 * 0.3 * 1.3, "hardly faster than the ground gives"
