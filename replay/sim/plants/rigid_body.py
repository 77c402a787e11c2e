"""The simple plant: one rigid model for every chassis, filled by `Chassis`, which each kind makes in a file of its own.

How this works
--------------
A chassis without wheel slip has three quasi-velocities u. Joint rates are `rows` u, so joint torques act on u
through the transposed rows, and rotor inertia J and friction b of the joints appear as rows' J rows, rows' b rows:

    (mass + rows' J rows) du/dt = rows' (torque - b rows u - drag sign(rows u)) + gyroscopic(u) + external

`gyroscopic` does no work (u . gyroscopic(u) = 0), hence energy is kept without torque and friction. Integrated with
the explicit midpoint rule in fixed substeps of plain floats, bit-equal on every run: at the speeds of these robots the
energy drifts by less than 1e-7 per second, and by 3e-6 in a spin of 4 rad/s that swings into a straight line.

Where the ground is slippery (`set_friction`), a wheel has a speed of its own and the ground gives it a traction within
mu times its load: as much as it takes to end the substep without slip, or all there is against the slip. That keeps
momentum, bounds every force exactly, and makes no energy but the 1e-5 of it that a substep in which slip ends may err
by. Only rolling traction can fail: an axle does not slide sideways.
Geometry is derived here from the robot file, independently of `gateway.kinematics`.
"""

from collections.abc import Callable, Container, Sequence
from math import cos, isinf, sin, tanh
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.sections import Body
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S

Vector = tuple[float, float, float]
DRAG_SPEED = 0.05  # rad/s below which dry friction fades, so that a joint at rest stays there
GRAVITY = 9.81  # m/s^2
_NO_SLIP = 1e-6  # rad/s
_SAME_TORQUE = 1e-9  # N m by which traction may still change when it is settled
_MAX_ROUNDS = 30
_ORIGIN = Pose(0.0, 0.0, 0.0)


class Chassis(NamedTuple):
    """What distinguishes a robot kind. Joint angles are measured from the joint's zero."""

    body: Body
    rows: tuple[Vector, ...]  # joint rates = rows @ u
    wheel_radii: tuple[float | None, ...]  # m, per joint; None: drives no wheel
    load_shares: tuple[float, ...]  # of the weight, per joint
    mass: tuple[Vector, Vector, Vector]  # without joints
    across: float  # m/s of the centre of mass across the chassis per unit of u[1]; along it, u[0] is the speed itself
    gyroscopic: Callable[[Vector], Vector]
    body_twist: Callable[[Vector, Sequence[float]], Twist]  # of `base_link`, from u and the joint angles
    chassis_angle: Callable[[float, Sequence[float]], float]  # rad in the world, from heading and joint angles


class _Matrices(NamedTuple):
    """The equation of motion of the body with the joints that are held to it; a free wheel's inertia is its own."""

    mass: NDArray[np.float64]
    inverse: NDArray[np.float64]
    mobility: tuple[tuple[float, ...], ...]
    torque_rows: tuple[tuple[float, ...], ...]
    damping: tuple[tuple[float, ...], ...]


class _Contact(NamedTuple):
    """A wheel on slippery ground, and what 1 N m of traction changes."""

    joint: int
    row: Vector
    reach: Vector  # of du/dt
    yielding: float  # of the slip's rate, rad/s^2
    lever: float  # m: radius times share of the weight


class RigidBody:
    """A plant: quasi-velocities, joint angles and rates, pose. The writer is `step`. `model`: the chassis of a body."""

    def __init__(self, body: Body, model: Callable[[Body], Chassis]) -> None:
        chassis = model(body)
        self._body = body
        self._model = model
        self.external: Vector = (0.0, 0.0, 0.0)  # generalised force on u, e.g. a push in an experiment
        self.push = 0.0
        self.slope = 0.0
        self.pose = _ORIGIN
        self.angles = tuple(0.0 for _ in chassis.rows)
        self._force = self.external
        self._friction: dict[int, float] = {}  # mu of the wheels on slippery ground
        self._spins: dict[int, float] = {}  # rad/s of these
        self._traction: dict[int, float] = {}  # N m that the ground gave these in the last substep
        self._build(chassis)
        self.reflected_inertia = tuple(self._reflected(row) for row in chassis.rows)
        self.set_velocity((0.0, 0.0, 0.0))

    @property
    def velocity(self) -> Vector:
        return self._velocity

    @property
    def twist(self) -> Twist:
        """Body twist of `base_link`."""
        return self._chassis.body_twist(self._velocity, self.angles)

    @property
    def chassis_angle(self) -> float:
        """World angle of the part that carries the wheels."""
        return self._chassis.chassis_angle(self.pose.theta, self.angles)

    @property
    def energy(self) -> float:
        """Kinetic energy, joints included."""
        u = np.array(self._velocity)
        spinning = self._chassis.body.joint_inertia * sum(rate * rate for rate in self._spins.values())
        return float(u @ self._mass @ u + spinning) / 2.0

    @property
    def wheels(self) -> tuple[int, ...]:
        """Joints that drive a wheel."""
        return tuple(joint for joint, radius in enumerate(self._chassis.wheel_radii) if radius is not None)

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip."""
        return tuple(sorted(joint for joint in self._spins if abs(self._slip(joint, self._velocity)) > _NO_SLIP))

    def set_velocity(self, velocity: Vector) -> None:
        """Start an experiment in motion; wheels on slippery ground keep their speed."""
        self._velocity = velocity
        self.rates = self._joint_rates(velocity)

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step."""
        self.angles = tuple(angles)

    def can_slip(self, joint: int) -> bool:
        """Whether the joint drives a wheel that has an inertia of its own."""
        return self._chassis.wheel_radii[joint] is not None and self._chassis.body.joint_inertia > 0.0

    def set_friction(self, joint: int, friction: float) -> None:
        """Coefficient of friction under a wheel; infinite: it never slips, and grips at once if it does."""
        if not self.can_slip(joint):
            raise ValueError(f"joint {joint}: only a wheel with inertia can slip")
        if isinf(friction):
            self._friction.pop(joint, None)
            if joint in self._spins:
                self._grip(joint)
            return
        self._friction[joint] = friction
        self._traction.setdefault(joint, 0.0)
        if joint not in self._spins:
            self._spins[joint] = self.rates[joint]
            self._choose()

    def set_mass(self, mass: float | None) -> None:
        """Another mass from now on: a load put on was at rest before, a load taken off keeps its own momentum."""
        before = self._mass
        self._build(self._model(self._body if mass is None else self._body.model_copy(update={"mass": mass})))
        if np.trace(self._mass) > np.trace(before):
            self.set_velocity(_vector(self._inverse @ before @ np.array(self._velocity)))

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques."""
        self._force = self._outer_force() if self.push or self.slope else self.external
        torques = self._less_drag(torques)
        if self._friction:
            self._step_on_slippery_ground(torques)
            return
        half = STEP_S / 2.0
        drive = tuple(sum(map(mul, row, torques)) for row in self._torque_rows)
        a, b, c = self._velocity
        da, db, dc = self._acceleration((a, b, c), drive)
        middle = (a + half * da, b + half * db, c + half * dc)
        da, db, dc = self._acceleration(middle, drive)
        self._move(middle, self._joint_rates(middle))
        self.set_velocity((a + STEP_S * da, b + STEP_S * db, c + STEP_S * dc))

    # the equation of motion

    def _build(self, chassis: Chassis) -> None:
        self._chassis = chassis
        self._rows = chassis.rows
        self._gyroscopic = chassis.gyroscopic
        self._choose()

    def _choose(self) -> None:
        """The matrices for the wheels that are held to their rows now."""
        matrices = _matrices(self._chassis, self._spins)
        self._mass, self._inverse, self._mobility, self._torque_rows, self._damping = matrices
        self._contacts = tuple(map(self._contact, self._spins))

    def _reflected(self, row: Vector) -> float:
        joint = np.array(row)
        return 1.0 / float(joint @ self._inverse @ joint)

    def _outer_force(self) -> Vector:
        """Push and weight along world x, seen from the chassis."""
        force = self.push - self._total_mass() * GRAVITY * sin(self.slope)
        ea, eb, ec = self.external
        angle = self.chassis_angle
        return ea + force * cos(angle), eb - force * sin(angle) * self._chassis.across, ec

    def _total_mass(self) -> float:
        return self._chassis.mass[0][0]

    def _less_drag(self, torques: Sequence[float]) -> Sequence[float]:
        """Of the joints that are held to the motion."""
        drag = self._chassis.body.joint_drag
        if not drag:
            return torques
        return [
            torque if joint in self._spins else torque - drag * tanh(rate / DRAG_SPEED)
            for joint, (torque, rate) in enumerate(zip(torques, self.rates, strict=True))
        ]

    def _acceleration(self, u: Vector, drive: Sequence[float]) -> Vector:
        ga, gb, gc = self._gyroscopic(u)
        ea, eb, ec = self._force
        ga, gb, gc = ga + ea, gb + eb, gc + ec
        a, b, c = u
        (d11, d12, d13), (d21, d22, d23), (d31, d32, d33) = self._damping
        (m11, m12, m13), (m21, m22, m23), (m31, m32, m33) = self._mobility
        return (
            drive[0] + d11 * a + d12 * b + d13 * c + m11 * ga + m12 * gb + m13 * gc,
            drive[1] + d21 * a + d22 * b + d23 * c + m21 * ga + m22 * gb + m23 * gc,
            drive[2] + d31 * a + d32 * b + d33 * c + m31 * ga + m32 * gb + m33 * gc,
        )

    def _move(self, middle: Vector, rates: Sequence[float]) -> None:
        """Advance angles and pose with the velocity of mid-step, in the heading of mid-step."""
        halfway = [angle + STEP_S / 2.0 * rate for angle, rate in zip(self.angles, rates, strict=True)]
        vx, vy, wz = self._chassis.body_twist(middle, halfway)
        x, y, theta = self.pose
        heading = theta + STEP_S / 2.0 * wz
        c, s = cos(heading) * STEP_S, sin(heading) * STEP_S
        self.pose = Pose(x + vx * c - vy * s, y + vx * s + vy * c, theta + STEP_S * wz)
        self.angles = tuple([angle + STEP_S * rate for angle, rate in zip(self.angles, rates, strict=True)])

    def _joint_rates(self, u: Vector) -> tuple[float, ...]:
        a, b, c = u
        rates = tuple([row_a * a + row_b * b + row_c * c for row_a, row_b, row_c in self._rows])
        if not self._spins:
            return rates
        return tuple(self._spins.get(joint, rate) for joint, rate in enumerate(rates))

    # wheels on slippery ground

    def _step_on_slippery_ground(self, torques: Sequence[float]) -> None:
        half, body = STEP_S / 2.0, self._chassis.body
        before, given = self._velocity, dict(self._traction)
        drive = self._drive([given.get(joint, torque) for joint, torque in enumerate(torques)])
        velocity = _after(before, self._acceleration(before, drive), half)
        velocity = _after(before, self._acceleration(velocity, drive), STEP_S)
        spins = {}
        for joint, rate in self._spins.items():
            # Friction of the mean of both speeds, so that it turns no wheel round, however light it is.
            spare, slowing = torques[joint] - given[joint], body.joint_friction + body.joint_drag / _softened(rate)
            spins[joint] = rate + STEP_S * (spare - slowing * rate) / (body.joint_inertia + half * slowing)
        velocity = self._give_traction(velocity, spins)
        a, b, c = before
        new_a, new_b, new_c = velocity
        self._spins = {joint: (rate + spins[joint]) / 2.0 for joint, rate in self._spins.items()}
        middle_velocity = ((a + new_a) / 2.0, (b + new_b) / 2.0, (c + new_c) / 2.0)
        self._move(middle_velocity, self._joint_rates(middle_velocity))
        self._spins = spins
        self.set_velocity(velocity)

    def _give_traction(self, velocity: Vector, spins: dict[int, float]) -> Vector:
        """Correct the traction, and with it the speeds, wheel by wheel until nothing changes.

        It starts from that of the substep before, and a wheel is light against what it drives: a few rounds are enough.
        """
        inertia = self._chassis.body.joint_inertia
        weight = self._total_mass() * GRAVITY * cos(self.slope)
        a, b, c = velocity
        for _ in range(_MAX_ROUNDS):
            largest = 0.0
            for joint, (row_a, row_b, row_c), (reach_a, reach_b, reach_c), yielding, lever in self._contacts:
                limit = self._friction[joint] * weight * lever
                slip = spins[joint] - (row_a * a + row_b * b + row_c * c)
                given = self._traction[joint]
                change = max(-limit, min(limit, given + slip / (STEP_S * yielding))) - given
                self._traction[joint] = given + change
                impulse = STEP_S * change
                spins[joint] -= impulse / inertia
                a, b, c = a + impulse * reach_a, b + impulse * reach_b, c + impulse * reach_c
                largest = max(largest, abs(change))
            if largest <= _SAME_TORQUE:
                break
        return a, b, c

    def _contact(self, joint: int) -> _Contact:
        a, b, c = (row[joint] for row in self._torque_rows)
        row = self._rows[joint]
        yielding = 1.0 / self._chassis.body.joint_inertia + row[0] * a + row[1] * b + row[2] * c
        lever = self._chassis.load_shares[joint] * (self._chassis.wheel_radii[joint] or 0.0)
        return _Contact(joint, row, (a, b, c), yielding, lever)

    def _drive(self, torques: Sequence[float]) -> tuple[float, ...]:
        return tuple(sum(map(mul, row, torques)) for row in self._torque_rows)

    def _slip(self, joint: int, velocity: Vector) -> float:
        a, b, c = velocity
        row_a, row_b, row_c = self._rows[joint]
        return self._spins[joint] - (row_a * a + row_b * b + row_c * c)

    def _grip(self, joint: int) -> None:
        """The wheel is held to its row again, as in a plastic impact: wheel and body keep their momentum together."""
        spin = self._chassis.body.joint_inertia * self._spins.pop(joint)
        momentum = self._mass @ np.array(self._velocity) + spin * np.array(self._rows[joint])
        self._traction.pop(joint)
        self._choose()
        self.set_velocity(_vector(self._inverse @ momentum))


def _after(velocity: Vector, rate: Sequence[float], seconds: float) -> Vector:
    a, b, c = velocity
    return a + seconds * rate[0], b + seconds * rate[1], c + seconds * rate[2]


def _softened(rate: float) -> float:
    """By what of a motion dry friction is to be divided that fades towards rest."""
    return rate / tanh(rate / DRAG_SPEED) if rate else DRAG_SPEED


def _matrices(chassis: Chassis, free: Container[int]) -> _Matrices:
    rows = np.array(chassis.rows)
    gripping = np.array([row for joint, row in enumerate(chassis.rows) if joint not in free]).reshape(-1, 3)
    mass = np.array(chassis.mass) + chassis.body.joint_inertia * gripping.T @ gripping
    inverse = np.linalg.inv(mass)
    return _Matrices(
        mass=mass,
        inverse=inverse,
        mobility=_rows(inverse),
        torque_rows=_rows(inverse @ rows.T),
        damping=_rows(-chassis.body.joint_friction * inverse @ gripping.T @ gripping),
    )


def _vector(array: NDArray[np.float64]) -> Vector:
    a, b, c = array.tolist()
    return a, b, c


def _rows(matrix: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)
