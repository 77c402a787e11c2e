"""An ODD by MuJoCo: two halves, one of which slides on the other, four wheels, on ball casters or leaning as it likes.

How this works
--------------
MuJoCo has the bodies, the slide with its ends, and the loads; nothing here knows how mecanum wheels make a body move.
Wheels are made in one of two ways. `rollers`: hubs with 16 free rollers each, whose middle is curved as the rim, on
MuJoCo's own friction: good for wheels that grip and for their ripple, not for slip, under which its cone inflates the
loads. Pads: round, without friction of their own; the floor gives exact Coulomb friction along the axle of the roller
below and none across it, as much as ends the step without slip or mu times the load of the step before: for
accelerations and slip. Balls of the casters hang a hair above the floor, so that wheels carry what they can.
"""

from collections.abc import Sequence
from math import atan2, cos, isinf, pi, sin, sqrt
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gateway.chassis.odd import OddRobot
from gateway.types import Attitude, Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of
from replay.sim.plants.odd_bodies import Leaning

Array = NDArray[np.float64]
GRAVITY = 9.81
HUB_MASS = 0.02  # kg; a disc. What joint_inertia has beyond it is a geared rotor's
ROLLERS, ROLLER_RADIUS, ROLLER_MASS = 16, 0.012, 0.0015  # m, kg
STIFFNESS = 10000.0  # N/m of each wheel's suspension, without which the loads are chance
SUSPENSION = f'stiffness="{STIFFNESS}" damping="80" armature="0.3"'  # N s/m, kg
GRIP = 2.0  # coefficient of friction that stands for ground that holds
SETTLING, ROUNDS = 0.5, 60
SAME_FORCE = 1e-9  # N
CREEP = 0.05  # m/s
BALL, REACH = 0.02, 0.15  # m: radius of the ball of a caster, and how far it is from the axle
GAP, ROLLING_GAP = 0.0002, 0.001  # m over the floor; rollers sink and ripple more
CONTACT = f'condim="3" friction="{GRIP} {GRIP} 0 0 0" solref="0.005 1" solreffriction="0 -{0.3 / STEP_S}"'
SMOOTH = 'condim="1" solref="0.005 1"'
LEVEL = (0, 1, 5)  # of the free joint: what a body on casters can do
PITCH = 4


class MujocoOdd:
    """A plant; pads on a floor that grips until told otherwise. `leaning`: None on casters."""

    def __init__(self, robot: OddRobot, leaning: Leaning | None = None, *, rollers: bool = False) -> None:
        self.push = self.slope = 0.0
        self.wheels = (0, 1, 2, 3)
        self._robot, self._rollers = robot, rollers
        self._model: Any = mujoco.MjModel.from_xml_string(_xml(robot, leaning, rollers=rollers))
        self._data: Any = mujoco.MjData(self._model)
        joints = [self._model.joint(f"joint{place}") for place in self.wheels]
        self._hubs = [int(joint.bodyid[0]) for joint in joints]
        self._dofs = [int(joint.dofadr[0]) for joint in joints]
        self._places = [int(joint.qposadr[0]) for joint in joints]
        slide = self._model.joint("slide")
        self._slide, self._slid = int(slide.dofadr[0]), int(slide.qposadr[0])
        self._free = [*LEVEL, *([] if leaning is None else [PITCH]), self._slide, *self._dofs]
        self._friction = [GRIP] * 4
        self._forces = np.zeros(4)  # N along each roller's axle, from the floor
        self._settled(leaning)
        self._origin = self._centre()
        self.reflected_inertia = plant_of(robot).reflected_inertia  # what the controllers were tuned to

    @property
    def width(self) -> float:
        """Between the middles of the halves."""
        return float(self._robot.width + self._data.qpos[self._slid])

    @property
    def width_rate(self) -> float:
        """Of it."""
        return float(self._data.qvel[self._slide])

    @property
    def pitch(self) -> float:
        """Of the halves, forward and down."""
        rotation = self._rotation()
        return atan2(-float(rotation[2, 0]), float(rotation[2, 2]))

    @property
    def pitch_rate(self) -> float:
        """Of it."""
        return float(self._data.qvel[PITCH])

    @property
    def attitude(self) -> Attitude:
        """On a level floor."""
        return Attitude(0.0, self.pitch, *(float(one) for one in self._data.qvel[3:6]))

    @property
    def chassis_angle(self) -> float:
        """Of the heading, within half a turn."""
        along = self._rotation()[:, 1]
        return atan2(-float(along[0]), float(along[1]))

    @property
    def pose(self) -> Pose:
        """Since the start."""
        x, y = self._centre() - self._origin
        return Pose(float(x), float(y), self.chassis_angle)

    @property
    def twist(self) -> Twist:
        """Of the middle of the axle."""
        heading = self.chassis_angle
        forward, left = np.array((cos(heading), sin(heading))), np.array((-sin(heading), cos(heading)))
        turn = float(self._rotation()[2] @ self._data.qvel[3:6])
        velocity = self._data.qvel[:2] - 0.5 * self.width_rate * left + 0.5 * self.width * turn * forward
        return Twist(float(velocity @ forward), float(velocity @ left), turn)

    @property
    def angles(self) -> tuple[float, ...]:
        """Of the wheels against the halves."""
        return tuple(float(self._data.qpos[place]) for place in self._places)

    @property
    def rates(self) -> tuple[float, ...]:
        """Of them."""
        return tuple(float(self._data.qvel[dof]) for dof in self._dofs)

    @property
    def energy(self) -> float:
        """Kinetic energy, J."""
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy[1])

    @property
    def loads(self) -> Array:
        """N under each wheel in the last step."""
        found, force = np.zeros(4), np.zeros(6)
        for place, contact in enumerate(self._data.contact):
            name = self._model.geom(contact.geom[1]).name
            if name.startswith("wheel"):
                mujoco.mj_contactForce(self._model, self._data, place, force)
                found[int(name[5])] += force[0]
        return found

    @property
    def slips(self) -> Array:
        """m/s of each wheel over the floor, along the axle of the roller below."""
        return np.asarray(-self._rows() @ self._data.qvel)

    @property
    def slipping(self) -> tuple[int, ...]:
        """Wheels that do more than creep."""
        return tuple(int(place) for place in np.flatnonzero(np.abs(self.slips) > CREEP))

    def place(self, angles: Sequence[float]) -> None:
        """The joints stand there."""
        self._data.qpos[self._places] = angles

    def lean(self, pitch: float) -> None:
        """From upright at a heading of zero: the halves lean, the wheels stand."""
        self._data.qpos[3:7] = (cos(0.5 * pitch), 0.0, sin(0.5 * pitch), 0.0)
        self._data.qpos[self._places] -= pitch
        mujoco.mj_forward(self._model, self._data)

    def step(self, torques: Sequence[float]) -> None:
        """One substep."""
        data = self._data
        limits = np.array(self._friction) * self.loads
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[self._dofs] = torques
        for half in ("left", "right"):
            data.body(half).xfrc_applied[0] = 0.5 * self.push
        self._model.opt.gravity[:] = (-GRAVITY * sin(self.slope), 0.0, -GRAVITY * cos(self.slope))
        if not self._rollers:
            mujoco.mj_forward(self._model, data)
            rows = self._rows()
            self._settle(rows @ (data.qvel + STEP_S * data.qacc), self._yielding(rows), limits)
            data.qfrc_applied[:] += rows.T @ self._forces
        mujoco.mj_step(self._model, data)

    def can_slip(self, joint: int) -> bool:
        """Every wheel can."""
        return joint in self.wheels

    def set_friction(self, joint: int, friction: float) -> None:
        """Under one wheel; infinite: as much as holds."""
        self._friction[joint] = GRIP if isinf(friction) else friction
        for pair, geom in enumerate(self._model.pair_geom2):
            if self._rollers and self._model.geom(geom).name.startswith(f"wheel{joint}_"):
                self._model.pair_friction[pair, :2] = self._friction[joint]

    def set_mass(self, mass: float | None) -> None:
        """It has its own."""
        raise ValueError("this robot is as it was made")

    def _rotation(self) -> Array:
        return np.array(self._data.body("left").xmat.reshape(3, 3))

    def _centre(self) -> Array:
        heading = self.chassis_angle
        return np.array(self._data.qpos[:2] - 0.5 * self.width * np.array((-sin(heading), cos(heading))))

    def _settled(self, leaning: Leaning | None) -> None:
        """Sunk into its contacts, upright and at rest."""
        for _ in range(round(SETTLING / STEP_S)):
            self._data.qvel[:] *= 0.9
            if leaning is not None:
                self._data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
            mujoco.mj_step(self._model, self._data)
        height = float(self._data.qpos[2])
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[2] = height
        mujoco.mj_forward(self._model, self._data)

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
        """What each rate does to the material points of the wheels on the floor, along the rollers' axles."""
        heading, rows = self.chassis_angle, []
        for hub, angle in zip(self._hubs, self._robot.roller_angles, strict=True):
            jacobian = np.zeros((3, self._model.nv))
            below = self._data.xpos[hub] - (0.0, 0.0, self._robot.radius)
            mujoco.mj_jac(self._model, self._data, jacobian, None, below, hub)
            rows.append(np.array((cos(heading + angle), sin(heading + angle), 0.0)) @ jacobian)
        return np.array(rows)

    def _yielding(self, rows: Array) -> Array:
        """m/s^2 of each slip per N at each wheel."""
        inertia = np.zeros((self._model.nv, self._model.nv))
        for column, unit in zip(inertia, np.eye(self._model.nv), strict=True):
            mujoco.mj_mulM(self._model, self._data, column, unit)
        free = self._free
        return np.asarray(rows[:, free] @ np.linalg.solve(inertia[np.ix_(free, free)], rows[:, free].T))


def _xml(robot: OddRobot, leaning: Leaning | None, *, rollers: bool) -> str:
    """Both halves have their origin on the axle; the right one slides to the right of the left one."""
    left, right = (_half(robot, leaning, wheels, rollers=rollers) for wheels in ((0, 1), (2, 3)))
    names = [f"wheel{place}_{roller}" for place in range(4) for roller in range(ROLLERS if rollers else 1)]
    pairs = [f'<pair geom1="floor" geom2="{name}" {CONTACT if rollers else SMOOTH}/>' for name in names]
    balls = [] if leaning is not None else [f"ball{half}_{end}" for half in (0, 2) for end in (0, 1)]
    pairs += [f'<pair geom1="floor" geom2="{name}" {SMOOTH}/>' for name in balls]
    reach = f"{robot.narrowest - robot.width} {robot.widest - robot.width}"
    return f"""<mujoco><option timestep="{STEP_S}" gravity="0 0 -{GRAVITY}" integrator="implicitfast"
     cone="elliptic" impratio="10"/>
    <default><geom contype="0" conaffinity="0" density="0"/></default>
    <worldbody><geom name="floor" type="plane" size="0 0 1"/>
    <body name="left" pos="0 {0.5 * robot.width} {robot.radius}"><freejoint/>{left}
     <body name="right" pos="0 {-robot.width} 0">
      <joint name="slide" type="slide" axis="0 -1 0" limited="true" range="{reach}"
       solreflimit="0.004 1"/>{right}</body></body>
    </worldbody><contact>{"".join(pairs)}</contact></mujoco>"""


def _half(robot: OddRobot, leaning: Leaning | None, wheels: tuple[int, int], *, rollers: bool) -> str:
    """Its own mass so that with the hubs there is half of the robot's, with the same centre and inertias."""
    body = robot.body
    hub = HUB_MASS + (ROLLERS * ROLLER_MASS if rollers else 0.0)
    mass = 0.5 * body.mass - 2.0 * hub
    height, pitching = (0.02, 0.2) if leaning is None else leaning
    high = 0.5 * body.mass * height / mass
    own = 0.5 * pitching + 0.5 * body.mass * height * height - mass * high * high
    turning = 0.5 * body.inertia - 0.125 * body.mass * robot.width**2
    turning -= 2.0 * hub * (robot.spacing**2 / 4.0 + robot.radius**2 / 4.0)
    inertia = _allowed(own, turning)
    parts = [f'<inertial pos="0 0 {high}" mass="{mass}" diaginertia="{inertia} {own} {turning}"/>']
    for place, side in zip(wheels, (0.5, -0.5), strict=True):
        parts.append(_wheel(robot, place, side * robot.spacing, rollers=rollers, suspended=leaning is None))
    if leaning is None:
        parts += [
            f'<geom name="ball{wheels[0]}_{end}" type="sphere" size="{BALL}"'
            f' pos="{x} 0 {BALL - robot.radius + (ROLLING_GAP if rollers else GAP)}"/>'
            for end, x in enumerate((REACH, -REACH))
        ]
    return "".join(parts)


def _allowed(own: float, turning: float) -> float:
    """Inertia about forward, nobody knows which: as about the axle, within what bodies can have."""
    return min(max(own, abs(own - turning)), own + turning)


def _wheel(robot: OddRobot, place: int, y: float, *, rollers: bool, suspended: bool) -> str:
    body, radius = robot.body, robot.radius
    ring = radius - ROLLER_RADIUS
    spin = HUB_MASS * radius**2 / 2.0
    carried = ROLLERS * ROLLER_MASS * ring**2 if rollers else 0.0
    joint = f'armature="{body.joint_inertia - spin - carried}" damping="{body.joint_friction}"'
    joint += f' frictionloss="{body.joint_drag}"'
    inner = f'<geom name="wheel{place}_0" type="sphere" size="{radius}"/>'
    if rollers:
        inner = "".join(_roller(robot, place, number) for number in range(ROLLERS))
    preload = -0.25 * body.mass * GRAVITY / STIFFNESS
    spring = f'<joint type="slide" axis="0 0 1" springref="{preload}" {SUSPENSION}/>' if suspended else ""
    return f"""<body pos="0 {y} 0">{spring}<joint name="joint{place}" axis="0 1 0" {joint}/>
    <inertial pos="0 0 0" mass="{HUB_MASS}" diaginertia="{spin / 2.0} {spin} {spin / 2.0}"/>{inner}</body>"""


def _roller(robot: OddRobot, place: int, number: int) -> str:
    """Its axle at the roller angle when it is below."""
    angle, turn = robot.roller_angles[place], 2.0 * pi * number / ROLLERS
    ring = robot.radius - ROLLER_RADIUS
    length = sqrt(ring * ROLLER_RADIUS) / abs(cos(angle))
    axle = f"{cos(angle)} {sin(angle)} 0"
    return f"""<body pos="{-ring * sin(turn)} 0 {-ring * cos(turn)}" euler="0 {turn * 180.0 / pi} 0">
    <joint type="hinge" axis="{axle}"/><inertial pos="0 0 0" mass="{ROLLER_MASS}" diaginertia="2e-7 2e-7 2e-7"/>
    <geom name="wheel{place}_{number}" type="ellipsoid" zaxis="{axle}"
     size="{ROLLER_RADIUS} {ROLLER_RADIUS} {length}"/></body>"""
