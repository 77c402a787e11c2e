"""A plant of rigid bodies in contact, by MuJoCo: independent of the simple plant and of the kinematics of the core.

How this works
--------------
The robot file becomes bodies, joints and contacts, and nothing here knows how wheels make a body move: an omni wheel
is a hub with 16 free rollers on its rim, the offset robot's wheels and its caster roll on the floor. Contact is soft,
so wheels creep a little (some per mille of their speed) and rolling costs something; friction is an elliptic cone.
Good for wheels that grip and for their ripple; under gross slip this cone inflates the load of the wheels, so
slip is not to be measured with it.
The robot files tell no heights and no masses of wheels: those are chosen below, light wheels on low bodies.
"""

from collections.abc import Callable, Mapping, Sequence
from math import atan2, cos, isinf, pi, sin, sqrt
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot
from gateway.sections import Body
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of

Matrix = NDArray[np.float64]
GRAVITY = 9.81  # m/s^2
GRIP = 2.0  # coefficient of friction that stands for ground that holds
SETTLING = 0.5  # s in which the robot sinks into its contacts before it is put at the origin
BRAKED = 1e4  # N m s/rad
SLIP = 0.05  # m/s at the rim beyond which a wheel slips and does not only creep

ROLLERS = 16
ROLLER_RADIUS = 0.012  # m
ROLLER_MASS = 0.004  # kg
HUB_MASS = 0.1  # kg
BODY_HEIGHT = 0.10  # m, centre of mass of a robot on omni wheels
CHASSIS_HEIGHT, PLATFORM_HEIGHT = 0.20, 0.40  # m
CHASSIS_SHARE = 0.25  # of the mass of an offset robot; the rest is the platform
WHEEL_MASS, FORK_MASS, CASTER_MASS = 0.5, 0.1, 0.2  # kg

# Normal contact: time constant and damping ratio. Friction: no spring, and a slip rate that decays within 3 steps.
CONTACT = f'condim="3" friction="{GRIP} {GRIP} 0 0 0" solref="0.005 1" solreffriction="0 -{0.3 / STEP_S}"'
HEAD = f"""
<option timestep="{STEP_S}" gravity="0 0 -{GRAVITY}" integrator="implicitfast" cone="elliptic" impratio="10"/>
<default><geom contype="0" conaffinity="0" density="0"/></default>
"""


class MujocoPlant:
    """A plant of a model with joints `joint<i>`, a `body` that carries the load, and geoms `wheel<i>_<j>` on the floor.

    `wheels`: radius of the wheel, per joint that drives one, m.
    """

    def __init__(self, robot: OmniRobot | OffsetDifferentialRobot, xml: str, *, wheels: Mapping[int, float]) -> None:
        self.push = 0.0
        self.slope = 0.0
        self.wheels = tuple(wheels)
        self._radii = dict(wheels)
        self.reflected_inertia = plant_of(robot).reflected_inertia  # what the controllers were tuned to
        self._model: Any = mujoco.MjModel.from_xml_string(xml)
        self._data: Any = mujoco.MjData(self._model)
        joints = [self._model.joint(f"joint{index}") for index in range(len(robot.motor_names()))]
        self._places = [int(joint.qposadr[0]) for joint in joints]
        self._dofs = [int(joint.dofadr[0]) for joint in joints]
        self._body = self._model.body("body").id
        self._mass = float(self._model.body_mass[self._body])
        self._pairs = {joint: self._pairs_of(joint) for joint in wheels}
        self._turns_platform = robot.kind == "offset_differential"
        self._settle()

    @property
    def angles(self) -> tuple[float, ...]:
        """Of the joints, rad."""
        return tuple(float(self._data.qpos[place]) for place in self._places)

    @property
    def rates(self) -> tuple[float, ...]:
        """Of the joints, rad/s."""
        return tuple(float(self._data.qvel[dof]) for dof in self._dofs)

    @property
    def chassis_angle(self) -> float:
        """World angle of the body with the wheels, unwrapped by `step`."""
        return self._heading

    @property
    def pose(self) -> Pose:
        """Of `base_link`."""
        x, y = self._data.qpos[:2]
        return Pose(float(x), float(y), self._heading + self._platform(self._data.qpos, self._places))

    @property
    def twist(self) -> Twist:
        """Of `base_link`, in its own axes."""
        vx, vy = self._data.qvel[:2]
        c, s = cos(self.pose.theta), sin(self.pose.theta)
        turn = float(self._data.qvel[5]) + self._platform(self._data.qvel, self._dofs)
        return Twist(float(c * vx + s * vy), float(c * vy - s * vx), turn)

    @property
    def energy(self) -> float:
        """Kinetic energy, J."""
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy[1])

    @property
    def slipping(self) -> tuple[int, ...]:
        """Wheels whose rim is faster or slower over the ground than they creep."""
        return tuple(joint for joint in self.wheels if abs(self._slip(joint)) > SLIP)

    def place(self, angles: Sequence[float]) -> None:
        """The joints stand there; `base_link` stays at the origin."""
        self._data.qpos[self._places] = angles
        self._heading = -self._platform(self._data.qpos, self._places)
        heading = np.array([cos(self._heading / 2.0), 0.0, 0.0, sin(self._heading / 2.0)])
        mujoco.mju_mulQuat(self._data.qpos[3:7], heading, self._tilt)
        mujoco.mj_forward(self._model, self._data)

    def step(self, torques: Sequence[float]) -> None:
        """One substep."""
        self._data.qfrc_applied[self._dofs] = torques
        self._data.xfrc_applied[self._body, 0] = self.push
        self._model.opt.gravity[:] = (-GRAVITY * sin(self.slope), 0.0, -GRAVITY * cos(self.slope))
        mujoco.mj_step(self._model, self._data)
        w, _, _, z = self._data.qpos[3:7]
        turned = 2.0 * atan2(z, w) - self._heading
        self._heading += (turned + pi) % (2.0 * pi) - pi

    def brake(self, joint: int) -> None:
        """Its brake holds from now on, as stiff as a gear that jams."""
        self._model.dof_damping[self._dofs[joint]] = BRAKED

    def can_slip(self, joint: int) -> bool:
        """Every wheel can."""
        return joint in self._pairs

    def set_friction(self, joint: int, friction: float) -> None:
        """Under one wheel; infinite: as much as holds."""
        if joint not in self._pairs:
            raise ValueError(f"joint {joint}: only a wheel can slip")
        self._model.pair_friction[self._pairs[joint], :2] = GRIP if isinf(friction) else friction

    def set_mass(self, mass: float | None) -> None:
        """Total mass, the change in the body; a load put on was at rest before and does not tip the robot."""
        before = self._inertia()
        own, total = float(self._model.body_mass[self._body]), float(self._model.body_mass.sum())
        wanted = self._mass if mass is None else mass - (total - own)
        self._model.body_mass[self._body] = wanted
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
        mujoco.mj_forward(self._model, self._data)
        if wanted > own:
            self._data.qvel[2:5] = 0.0
            level = np.r_[0:2, 5 : self._model.nv]
            within = np.ix_(level, level)
            momentum = before[within] @ self._data.qvel[level]
            self._data.qvel[level] = np.linalg.solve(self._inertia()[within], momentum)

    def _inertia(self) -> Matrix:
        """Of all degrees of freedom, column by column."""
        columns = np.zeros((self._model.nv, self._model.nv))
        for column, unit in zip(columns, np.eye(self._model.nv), strict=True):
            mujoco.mj_mulM(self._model, self._data, column, unit)
        return columns

    def _slip(self, joint: int) -> float:
        """Rim speed less that of the hub in the direction in which the wheel rolls, m/s."""
        hub = self._model.joint(f"joint{joint}")
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(
            self._model, self._data, mujoco.mjtObj.mjOBJ_BODY, self._model.jnt_bodyid[hub.id], velocity, 0
        )
        rolling = np.cross(self._data.xaxis[hub.id], (0.0, 0.0, 1.0))
        return float(self._radii[joint] * self._data.qvel[self._dofs[joint]] - rolling @ velocity[3:])

    def _platform(self, values: Sequence[float], places: Sequence[int]) -> float:
        """Of the joint that turns `base_link` on the chassis, where there is one."""
        return float(values[places[2]]) if self._turns_platform else 0.0

    def _pairs_of(self, joint: int) -> list[int]:
        names = [self._model.geom(geom).name for geom in self._model.pair_geom2]
        return [pair for pair, name in enumerate(names) if name.startswith(f"wheel{joint}_")]

    def _settle(self) -> None:
        self._heading = 0.0
        for _ in range(round(SETTLING / STEP_S)):
            self._data.qvel[:] *= 0.95
            mujoco.mj_step(self._model, self._data)
        height, self._tilt = float(self._data.qpos[2]), self._data.qpos[3:7].copy()
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[2], self._data.qpos[3:7] = height, self._tilt
        mujoco.mj_forward(self._model, self._data)


class MujocoOffsetPlant(MujocoPlant):
    """With its caster to look at; its joints are `swivel` and `roll`."""

    @property
    def swivel(self) -> float:
        """beta of the fork, rad: it trails behind a pushed chassis at -pi/2."""
        return float(self._data.joint("swivel").qpos[0]) - pi / 2.0

    def set_swivel(self, beta: float) -> None:
        """The fork stands there, at rest."""
        self._data.joint("swivel").qpos[0] = beta + pi / 2.0
        mujoco.mj_forward(self._model, self._data)

    def set_motion(self, velocity: tuple[float, float], joints: Sequence[float]) -> None:
        """From now on: the platform joint at this velocity in the world, the caster still; rates of the motors' joints.

        `base_link` does not turn, so the chassis does against its joint.
        """
        self._data.qvel[:] = 0.0
        self._data.qvel[:2], self._data.qvel[5] = velocity, -joints[2]
        self._data.qvel[self._dofs] = joints
        mujoco.mj_forward(self._model, self._data)


def omni(robot: OmniRobot) -> MujocoPlant:
    """Hubs with free rollers: ellipsoids whose middle is curved as the rim, so that the wheel is round."""
    body, wheels = robot.body, "".join(_omni_wheel(robot, place) for place in range(len(robot.wheel)))
    wheel_mass = HUB_MASS + ROLLERS * ROLLER_MASS
    carried = sum(wheel_mass * (wheel.x**2 + wheel.y**2) for wheel in robot.wheel)
    inertia = body.inertia - carried
    xml = f"""<mujoco>{HEAD}<worldbody><geom name="floor" type="plane" size="0 0 1"/>
    <body name="body"><freejoint/>
    <inertial pos="0 0 {BODY_HEIGHT}" mass="{body.mass - len(robot.wheel) * wheel_mass}"
     diaginertia="{inertia / 1.5} {inertia / 1.5} {inertia}"/>{wheels}</body></worldbody>
    <contact>{
        "".join(
            f'<pair geom1="floor" geom2="wheel{place}_{roller}" {CONTACT}/>'
            for place in range(len(robot.wheel))
            for roller in range(ROLLERS)
        )
    }</contact></mujoco>"""
    return MujocoPlant(robot, xml, wheels={place: wheel.radius for place, wheel in enumerate(robot.wheel)})


def _omni_wheel(robot: OmniRobot, place: int) -> str:
    """Local x of the hub is the axle, outward; a turn of the joint rolls towards the axle turned by 90 degrees."""
    wheel, ring = robot.wheel[place], robot.wheel[place].radius - ROLLER_RADIUS
    length = sqrt(wheel.radius * ROLLER_RADIUS)
    spin = HUB_MASS * ring**2 / 2.0
    armature = max(robot.body.joint_inertia - spin - ROLLERS * ROLLER_MASS * ring**2, 0.0)
    rollers = "".join(
        f"""<body pos="0 {ring * cos(angle)} {ring * sin(angle)}" euler="{angle * 180.0 / pi} 0 0">
        <joint type="hinge" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{ROLLER_MASS}" diaginertia="4e-7 4e-7 3e-7"/>
        <geom name="wheel{place}_{roller}" type="ellipsoid" size="{ROLLER_RADIUS} {ROLLER_RADIUS} {length}"/></body>"""
        for roller, angle in enumerate(2.0 * pi * index / ROLLERS for index in range(ROLLERS))
    )
    return f"""<body pos="{wheel.x} {wheel.y} {wheel.radius}" euler="0 0 {wheel.axis_angle * 180.0 / pi}">
    <joint name="joint{place}" type="hinge" axis="-1 0 0" {_joint(robot.body, armature)}/>
    <inertial pos="0 0 0" mass="{HUB_MASS}" diaginertia="{spin} {spin / 2.0} {spin / 2.0}"/>{rollers}</body>"""


def offset_differential(robot: OffsetDifferentialRobot) -> MujocoOffsetPlant:
    """Chassis with two wheels and a caster on a fork, platform on a vertical joint; the masses over the joint."""
    assert robot.caster is not None
    body, caster, radius = robot.body, robot.caster, robot.wheel_radius
    small = 2.0 * WHEEL_MASS + FORK_MASS + CASTER_MASS
    chassis = CHASSIS_SHARE * body.mass - small
    spin = WHEEL_MASS * radius**2 / 2.0
    carried = (
        2.0 * WHEEL_MASS * (robot.axle_offset**2 + robot.track**2 / 4.0)
        + FORK_MASS * caster.position**2
        + CASTER_MASS * (caster.position - caster.trail) ** 2
    )
    wheels = "".join(
        f"""<body name="wheel{place}" pos="{-robot.axle_offset} {side * robot.track / 2.0} {radius}">
        <joint name="joint{place}" type="hinge" axis="0 1 0" {_joint(body, body.joint_inertia - spin)}/>
        <inertial pos="0 0 0" mass="{WHEEL_MASS}" diaginertia="{spin / 2.0} {spin} {spin / 2.0}"/>
        <geom name="wheel{place}_0" type="sphere" size="{radius}"/></body>"""
        for place, side in ((0, 1.0), (1, -1.0))
    )
    xml = f"""<mujoco>{HEAD}<worldbody><geom name="floor" type="plane" size="0 0 1"/>
    <body name="chassis"><freejoint/>
    <inertial pos="0 0 {CHASSIS_HEIGHT}" mass="{chassis}"
     diaginertia="1 1 {robot.chassis_inertia - carried}"/>{wheels}
    <body name="fork" pos="{caster.position} 0 {caster.radius}">
     <joint name="swivel" type="hinge" axis="0 0 1" damping="0.01"/>
     <inertial pos="0 0 0" mass="{FORK_MASS}" diaginertia="1e-4 1e-4 1e-4"/>
     <body name="caster" pos="{-caster.trail} 0 0"><joint name="roll" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="{CASTER_MASS}" diaginertia="1e-4 2e-4 1e-4"/>
      <geom name="caster" type="sphere" size="{caster.radius}"/></body></body>
    <body name="body"><joint name="joint2" type="hinge" axis="0 0 1" {_joint(body, body.joint_inertia)}/>
     <inertial pos="0 0 {PLATFORM_HEIGHT}" mass="{(1.0 - CHASSIS_SHARE) * body.mass}"
      diaginertia="{body.inertia} {body.inertia} {body.inertia}"/></body></body></worldbody>
    <contact>{
        "".join(f'<pair geom1="floor" geom2="{geom}" {CONTACT}/>' for geom in ("wheel0_0", "wheel1_0", "caster"))
    }</contact></mujoco>"""
    return MujocoOffsetPlant(robot, xml, wheels={0: radius, 1: radius})


def _joint(body: Body, armature: float) -> str:
    return f'armature="{armature}" damping="{body.joint_friction}" frictionloss="{body.joint_drag}"'


MUJOCO_PLANTS: dict[str, Callable[[Any], MujocoPlant]] = {"omni": omni, "offset_differential": offset_differential}
