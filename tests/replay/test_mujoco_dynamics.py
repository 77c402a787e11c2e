"""The dynamics of the offset-differential robot with its caster against MuJoCo, which has bodies and no equations.

Masses and inertias are read out of the model that MuJoCo compiled. Without contacts both are the same to rounding;
contacts creep, and bodies rock on them.
"""

from math import hypot, pi
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import load
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.offset_dynamics import JOINT, SWIVEL, OffsetDynamics, OffsetParameters
from tests.replay.mujoco_plant import MujocoOffsetPlant, offset_differential

Array = NDArray[np.float64]
MOBY = Path(__file__).parents[2] / "deploy" / "robots" / "moby.toml"


def plant() -> tuple[OffsetDifferentialRobot, MujocoOffsetPlant]:
    """Without dry friction, and without the rotor of the joint's motor, which OffsetParameters does not have."""
    robot = load(MOBY)[0].robot
    assert isinstance(robot, OffsetDifferentialRobot)
    robot = robot.model_copy(update={"body": robot.body.model_copy(update={"joint_drag": 0.0})})
    found = offset_differential(robot)
    found._model.joint("joint2").armature[:] = 0.0
    return robot, found


def parameters(robot: OffsetDifferentialRobot, model: "mujoco.MjModel") -> OffsetParameters:
    """Lengths of the robot file, everything else from the bodies; rotors of motors turn with the wheels."""
    mass = {name: float(model.body(name).mass[0]) for name in ("chassis", "wheel0", "fork", "caster", "body")}
    inertia = {name: _about_axes(model, name) for name in mass}
    damping = {name: float(model.joint(name).damping[0]) for name in ("joint0", "joint1", "joint2", "swivel", "roll")}
    assert robot.caster is not None
    friction = tuple(damping[name] for name in ("joint0", "joint1", "joint2"))
    return OffsetParameters(
        wheel_radius=robot.wheel_radius,
        axle_offset=robot.axle_offset,
        track=robot.track,
        trail=robot.caster.trail,
        caster_position=robot.caster.position,
        caster_radius=robot.caster.radius,
        chassis_mass=mass["chassis"],
        chassis_offset=float(model.body("chassis").ipos[0]),
        chassis_inertia=inertia["chassis"][2],
        wheel_mass=mass["wheel0"],
        wheel_axial=inertia["wheel0"][1] + float(model.joint("joint0").armature[0]),
        wheel_radial=inertia["wheel0"][2],
        platform_mass=mass["body"],
        platform_inertia=inertia["body"][2],
        fork_mass=mass["fork"],
        fork_share=-float(model.body("fork").ipos[0]) / robot.caster.trail,
        fork_inertia=inertia["fork"][2],
        caster_mass=mass["caster"],
        caster_axial=inertia["caster"][1],
        caster_radial=inertia["caster"][2],
        friction=(*friction, 0.0, 0.0, 0.0, damping["swivel"], damping["roll"]),
    )


def _about_axes(model: "mujoco.MjModel", name: str) -> tuple[float, ...]:
    """Of a body, about the axes of its joint: MuJoCo keeps principal inertias in an order of its own."""
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, model.body(name).iquat)
    matrix = turned.reshape(3, 3) @ np.diag(model.body(name).inertia) @ turned.reshape(3, 3).T
    assert matrix == pytest.approx(np.diag(np.diag(matrix)), abs=1e-12)
    return tuple(map(float, np.diag(matrix)))


def together(robot: OffsetDifferentialRobot, found: MujocoOffsetPlant) -> tuple[OffsetDynamics, Array]:
    """The same robot by our equations, and what each of its rates does to MuJoCo's: (nv, 8)."""
    model = found._model
    spread = np.zeros((model.nv, 8))
    spread[0, 3] = spread[1, 4] = 1.0
    spread[5, [5, 2]] = 1.0, -1.0  # the root is the chassis
    for name, column, sign in (
        ("joint0", 0, 1.0),
        ("joint1", 1, 1.0),
        ("joint2", 2, 1.0),
        ("swivel", 6, 1.0),
        ("roll", 7, -1.0),  # about the axle, which looks to the right of the fork's way
    ):
        spread[int(model.joint(name).dofadr[0]), column] = sign
    return OffsetDynamics(parameters(robot, model)), spread


@pytest.mark.parametrize("seed", range(20))
def test_mass_matrix_and_inertial_forces(seed: int) -> None:
    """No contact is in it: bodies alone, upright, in random places, at random rates and accelerations that roll.

    What MuJoCo's bodies resist along the three free rates is what ours ask of their motors.
    """
    robot, found = plant()
    smooth, spread = together(robot, found)
    ours = OffsetDynamics(smooth.parameters._replace(friction=(0.0,) * 8))
    model, data, random = found._model, found._data, np.random.default_rng(seed)
    place = random.uniform(-pi, pi, 8)
    free = random.uniform(-3.0, 3.0, 3)
    moving = ours.moving(place, free)
    heading = place[5] - place[JOINT]
    data.qpos[:7] = place[3], place[4], 0.0, np.cos(heading / 2.0), 0.0, 0.0, np.sin(heading / 2.0)
    for name, angle in (
        ("joint0", place[0]),
        ("joint1", place[1]),
        ("joint2", place[2]),
        ("swivel", place[SWIVEL] + pi / 2.0),
        ("roll", -place[7]),
    ):
        data.joint(name).qpos[0] = angle
    data.qvel[:] = spread @ moving.rates
    mujoco.mj_forward(model, data)
    inertia = spread.T @ found._inertia() @ spread
    energy = moving.rates @ inertia @ moving.rates / 2.0
    assert ours.energy(place, free) == pytest.approx(float(energy), rel=1e-11)
    wanted = random.uniform(-3.0, 3.0, 3)
    forces = inertia @ (moving.spread @ wanted + moving.bias) + spread.T @ data.qfrc_bias
    torques = np.array(ours.inverse(place, free, wanted).torques)
    along = moving.spread.T @ forces
    assert np.abs(moving.spread[:3].T @ torques - along).max() <= 1e-11 * np.abs(along).max()


class Course(NamedTuple):
    """Torques, a start, and how far MuJoCo 4.0 was from the equations at the most; twice as much passes."""

    seconds: float
    torques: tuple[float, float, float]  # N m
    joint: float  # rad
    swivel: float
    way: float  # m, of the platform's joint
    turn: float  # rad, of platform and chassis
    swivelled: float  # rad


COURSES = {
    "pushed": Course(3.0, (3.0, 4.0, 0.5), 0.3, -1.3, way=0.0164, turn=0.0098, swivelled=0.0101),
    "pushed, the caster ahead": Course(3.0, (3.0, 2.5, -0.5), -0.4, 1.3, way=0.0126, turn=0.0078, swivelled=0.0705),
    "pulled": Course(2.0, (-4.0, -4.0, 0.2), 0.1, 1.3, way=0.0039, turn=0.0409, swivelled=0.0499),
    "pulled, the caster ahead": Course(2.0, (-4.0, -3.8, 0.0), 0.3, -1.2, way=0.0093, turn=0.0701, swivelled=0.0774),
    "about itself": Course(3.0, (-4.0, 4.0, 1.0), 1.2, 0.5, way=0.0361, turn=0.0389, swivelled=0.0124),
}


@pytest.mark.parametrize("name", COURSES)
def test_the_same_torques_give_the_same_motion(name: str) -> None:
    """Nothing corrects either; what differs early is carried along, and grows where the chassis is pulled."""
    course = COURSES[name]
    robot, found = plant()
    ours, _ = together(robot, found)
    found.place((0.0, 0.0, course.joint))
    found.set_swivel(course.swivel)
    place, free = np.zeros(8), np.zeros(3)
    place[JOINT], place[SWIVEL] = course.joint, course.swivel
    way = turn = swivelled = 0.0
    for _ in range(round(course.seconds / (4.0 * STEP_S))):
        for _ in range(4):
            found.step(course.torques)
        place, free = ours.step(place, free, course.torques, 4.0 * STEP_S)
        x, y, platform = place[3:6]
        way = max(way, hypot(found.pose.x - x, found.pose.y - y))
        turn = max(turn, abs(found.pose.theta - platform), abs(found.chassis_angle - (platform - place[JOINT])))
        swivelled = max(swivelled, abs(found.swivel - place[SWIVEL]))
    assert way < 2.0 * course.way
    assert turn < 2.0 * course.turn
    assert swivelled < 2.0 * course.swivelled
    assert found.energy == pytest.approx(ours.energy(place, free), rel=0.04)
