"""A robot on omni wheels by MuJoCo, whose floor gives exact Coulomb friction along each wheel and none across it.

How this works
--------------
MuJoCo has the bodies and, in contacts without friction of their own, the loads. Friction is added per wheel where it
touches: as much as ends the step without slip, or mu times the load of the step before, against the slip. MuJoCo's own
cone is not used, for under gross slip it inflates the loads. What one newton does to the slips is read from MuJoCo's
inertia matrix, the body level: nothing here knows how omni wheels make a body move.
"""

from collections.abc import Sequence
from math import atan2, hypot, pi
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gateway.chassis.omni import OmniRobot
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of

Array = NDArray[np.float64]
HUB_MASS = 0.01  # kg; a disc. What joint_inertia has beyond it is a geared rotor's, whose spin tips no body
SETTLING, ROUNDS = 0.5, 60
SAME_FORCE = 1e-9  # N
CREEP = 0.05  # m/s
DRAG_SPEED = 0.05  # rad/s below which dry friction fades
LEVEL = (0, 1, 5)  # of the free joint: what a level body can do


class MujocoPads:
    """The robot of a robot file, its centre of mass at `centre_height`, at rest on a floor with this friction."""

    def __init__(self, robot: OmniRobot, friction: float) -> None:
        self._model: Any = mujoco.MjModel.from_xml_string(_xml(robot))
        self._data: Any = mujoco.MjData(self._model)
        self._radii = [wheel.radius for wheel in robot.wheel]
        joints = [self._model.joint(f"joint{place}") for place in range(len(robot.wheel))]
        self._hubs = [int(joint.bodyid[0]) for joint in joints]
        self._dofs = [int(joint.dofadr[0]) for joint in joints]
        self._friction = friction
        self._forces = np.zeros(len(joints))  # N along each wheel, from the floor
        for _ in range(round(SETTLING / STEP_S)):
            self._data.qvel[:] *= 0.95
            mujoco.mj_step(self._model, self._data)
        self._data.qvel[:] = 0.0

    @property
    def twist(self) -> Array:
        """Of the body in its own axes: m/s, rad/s."""
        rotation = self._data.body("body").xmat.reshape(3, 3)
        vx, vy, _ = rotation.T @ self._data.qvel[:3]
        return np.array((vx, vy, self._data.qvel[5]))

    @property
    def rates(self) -> Array:
        """Of the wheels, rad/s."""
        return np.array(self._data.qvel[self._dofs])

    @property
    def loads(self) -> Array:
        """N under each wheel in the last step."""
        found, force = np.zeros(len(self._hubs)), np.zeros(6)
        for place, contact in enumerate(self._data.contact):
            mujoco.mj_contactForce(self._model, self._data, place, force)
            found[int(self._model.geom(contact.geom[1]).name[5:])] += force[0]
        return found

    @property
    def slips(self) -> Array:
        """m/s of each rim over the floor."""
        return np.asarray(-self._rows() @ self._data.qvel)

    def step(self, torques: Sequence[float]) -> None:
        """One step of the motors' torques, N m, and of the floor."""
        limits, data = self._friction * self.loads, self._data
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[self._dofs] = torques
        mujoco.mj_forward(self._model, data)
        rows = self._rows()
        due = rows @ (data.qvel + STEP_S * data.qacc)
        self._settle(due, self._yielding(rows), limits)
        data.qfrc_applied[:] += rows.T @ self._forces
        mujoco.mj_step(self._model, data)

    def _settle(self, due: Array, yielding: Array, limits: Array) -> None:
        """The forces that leave none of the speeds that are due, or as little as they can."""
        left = due + STEP_S * yielding @ self._forces
        for _ in range(ROUNDS):
            before = self._forces.copy()
            for place, limit in enumerate(limits):
                given = self._forces[place]
                wanted = given - left[place] / (STEP_S * yielding[place, place])
                self._forces[place] = max(-limit, min(limit, wanted))
                left += STEP_S * yielding[:, place] * (self._forces[place] - given)
            if np.abs(self._forces - before).max() < SAME_FORCE:
                break

    def _rows(self) -> Array:
        """What each rate does to the material points of the wheels on the floor, along the way they roll."""
        rows = []
        for hub, radius in zip(self._hubs, self._radii, strict=True):
            axle = self._data.xmat[hub].reshape(3, 3)[:, 0]
            along = np.cross((0.0, 0.0, 1.0), axle)
            jacobian = np.zeros((3, self._model.nv))
            below = self._data.xpos[hub] - (0.0, 0.0, radius)
            mujoco.mj_jac(self._model, self._data, jacobian, None, below, hub)
            rows.append(along / np.linalg.norm(along) @ jacobian)
        return np.array(rows)

    def _yielding(self, rows: Array) -> Array:
        """m/s^2 of each slip per N at each wheel."""
        inertia = np.zeros((self._model.nv, self._model.nv))
        for column, unit in zip(inertia, np.eye(self._model.nv), strict=True):
            mujoco.mj_mulM(self._model, self._data, column, unit)
        free = [*LEVEL, *self._dofs]
        return np.asarray(rows[:, free] @ np.linalg.solve(inertia[np.ix_(free, free)], rows[:, free].T))


def _xml(robot: OmniRobot) -> str:
    """Round pads under hubs on axles; a turn of a joint rolls towards its axle turned by 90 degrees."""
    body, count = robot.body, len(robot.wheel)
    assert body.centre_height is not None
    mass = body.mass - count * HUB_MASS
    hubs = sum(HUB_MASS * wheel.radius for wheel in robot.wheel)
    height = (body.mass * body.centre_height - hubs) / mass
    inertia = body.inertia - sum(HUB_MASS * (wheel.x**2 + wheel.y**2 + wheel.radius**2 / 4.0) for wheel in robot.wheel)
    wheels = []
    for place, wheel in enumerate(robot.wheel):
        spin = HUB_MASS * wheel.radius**2 / 2.0
        wheels.append(
            f"""<body pos="{wheel.x} {wheel.y} {wheel.radius}" euler="0 0 {wheel.axis_angle * 180.0 / pi}">
            <joint name="joint{place}" axis="-1 0 0" armature="{body.joint_inertia - spin}"/>
            <inertial pos="0 0 0" mass="{HUB_MASS}" diaginertia="{spin} {spin / 2.0} {spin / 2.0}"/>
            <geom name="wheel{place}" type="sphere" size="{wheel.radius}"/></body>"""
        )
    pairs = [
        f'<pair geom1="floor" geom2="wheel{place}" condim="1" solref="0.005 1"/>' for place in range(len(robot.wheel))
    ]
    return f"""<mujoco><option timestep="{STEP_S}" gravity="0 0 -9.81"/>
    <default><geom contype="0" conaffinity="0" density="0"/></default>
    <worldbody><geom name="floor" type="plane" size="0 0 1"/>
    <body name="body"><freejoint/>
    <inertial pos="0 0 {height}" mass="{mass}" diaginertia="{inertia / 1.5} {inertia / 1.5} {inertia}"/>
    {"".join(wheels)}</body></worldbody><contact>{"".join(pairs)}</contact></mujoco>"""


class PadsPlant:
    """Such a robot as a plant of the simulated world, with the losses of the robot file at the joints."""

    def __init__(self, robot: OmniRobot, friction: float) -> None:
        self._pads = MujocoPads(robot, friction)
        self._model, self._data = self._pads._model, self._pads._data
        self.push = self.slope = 0.0
        self.wheels = tuple(range(len(robot.wheel)))
        self.reflected_inertia = plant_of(robot).reflected_inertia  # what the controllers were tuned to
        self._body = robot.body
        self._places = [int(self._model.joint(f"joint{place}").qposadr[0]) for place in self.wheels]
        self._origin = self._data.qpos[:2].copy()

    @property
    def twist(self) -> Twist:
        """Body twist."""
        return Twist(*map(float, self._pads.twist))

    @property
    def rates(self) -> tuple[float, ...]:
        """Joint rates, rad/s."""
        return tuple(map(float, self._pads.rates))

    @property
    def angles(self) -> tuple[float, ...]:
        """Of the joints, rad."""
        return tuple(float(self._data.qpos[place]) for place in self._places)

    @property
    def chassis_angle(self) -> float:
        """World angle of the body, within half a turn."""
        w, _, _, z = self._data.qpos[3:7]
        return 2.0 * atan2(float(z), float(w))

    @property
    def pose(self) -> Pose:
        """Since the start."""
        x, y = self._data.qpos[:2] - self._origin
        return Pose(float(x), float(y), self.chassis_angle)

    @property
    def energy(self) -> float:
        """Kinetic energy, J."""
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy[1])

    @property
    def slipping(self) -> tuple[int, ...]:
        """Wheels faster or slower over the ground than they creep."""
        return tuple(int(place) for place in np.flatnonzero(np.abs(self._pads.slips) > CREEP))

    def place(self, angles: Sequence[float]) -> None:
        """The joints stand there."""
        self._data.qpos[self._places] = angles

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques."""
        body = self._body
        self._pads.step(
            [
                torque - body.joint_friction * rate - body.joint_drag * rate / hypot(rate, DRAG_SPEED)
                for torque, rate in zip(torques, self.rates, strict=True)
            ]
        )

    def can_slip(self, joint: int) -> bool:
        """All can, on the floor that it was made with."""
        return joint in self.wheels

    def set_friction(self, joint: int, friction: float) -> None:
        """It has one floor."""
        raise ValueError("this floor is as it was made")

    def set_mass(self, mass: float | None) -> None:
        """It has its own."""
        raise ValueError("this robot is as it was made")
