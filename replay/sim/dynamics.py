"""How the simulated robot moves: one rigid model for every chassis, and per kind what fills it.

How this works
--------------
A chassis without wheel slip has three quasi-velocities u. Joint rates are `rows` u, so joint torques act on u
through the transposed rows, and rotor inertia J and friction b of the joints appear as rows' J rows, rows' b rows:

    (mass + rows' J rows) du/dt = rows' (torque - b rows u - drag sign(rows u)) + gyroscopic(u) + external

`gyroscopic` does no work (u . gyroscopic(u) = 0), hence energy is kept without torque and friction. Integrated with
the explicit midpoint rule in fixed substeps of plain floats, bit-equal on every run: at the speeds of these robots the
energy drifts by less than 1e-7 per second, and by 3e-6 in a spin of 4 rad/s that swings into a straight line.
Geometry is derived here from the robot file, independently of `gateway.kinematics`.
"""

from collections.abc import Callable, Sequence
from math import cos, sin, tanh
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.config import Body, OffsetDifferentialRobot, OmniRobot
from gateway.types import Pose, Twist
from replay.sim.device import STEP_S

Vector = tuple[float, float, float]
_DRAG_SPEED = 0.05  # rad/s below which dry friction fades, so that a joint at rest stays there
GRAVITY = 9.81  # m/s^2
_ORIGIN = Pose(0.0, 0.0, 0.0)


class Chassis(NamedTuple):
    """What distinguishes a robot kind. Joint angles are measured from the joint's zero."""

    body: Body
    rows: tuple[Vector, ...]  # joint rates = rows @ u
    wheel_radii: tuple[float | None, ...]  # m, per joint; None: drives no wheel
    mass: tuple[Vector, Vector, Vector]  # without joints
    across: float  # m/s of the centre of mass across the chassis per unit of u[1]; along it, u[0] is the speed itself
    gyroscopic: Callable[[Vector], Vector]
    body_twist: Callable[[Vector, Sequence[float]], Twist]  # of `base_link`, from u and the joint angles
    chassis_angle: Callable[[float, Sequence[float]], float]  # rad in the world, from heading and joint angles


def omni(robot: OmniRobot) -> Chassis:
    """u is the body twist; a wheel drives along its axle direction turned by 90 degrees."""
    mass, inertia = robot.body.mass, robot.body.inertia
    rows = []
    for wheel in robot.wheel:
        drive_x, drive_y = -sin(wheel.axis_angle), cos(wheel.axis_angle)
        rows.append(
            (drive_x / wheel.radius, drive_y / wheel.radius, (drive_y * wheel.x - drive_x * wheel.y) / wheel.radius)
        )
    return Chassis(
        body=robot.body,
        rows=tuple(rows),
        wheel_radii=tuple(wheel.radius for wheel in robot.wheel),
        mass=((mass, 0.0, 0.0), (0.0, mass, 0.0), (0.0, 0.0, inertia)),
        across=1.0,
        gyroscopic=lambda u: (mass * u[2] * u[1], -mass * u[2] * u[0], 0.0),
        body_twist=lambda u, _: Twist(*u),
        chassis_angle=lambda heading, _: heading,
    )


def offset_differential(robot: OffsetDifferentialRobot) -> Chassis:
    """u = (speed of the joint along the chassis, chassis rate, platform rate); the whole mass sits at the joint.

    The joint moves with (u0, d1 u1) in chassis axes, so it accelerates with (u0' - d1 u1^2, d1 u1' + u0 u1).
    """
    mass, offset, radius = robot.body.mass, robot.axle_offset, robot.wheel_radius
    lever = robot.track / 2.0
    coupling = mass * offset

    def body_twist(u: Vector, angles: Sequence[float]) -> Twist:
        along, across = u[0], offset * u[1]
        c, s = cos(angles[2]), sin(angles[2])
        return Twist(along * c + across * s, across * c - along * s, u[2])

    return Chassis(
        body=robot.body,
        rows=((1.0 / radius, -lever / radius, 0.0), (1.0 / radius, lever / radius, 0.0), (0.0, -1.0, 1.0)),
        wheel_radii=(radius, radius, None),
        mass=(
            (mass, 0.0, 0.0),
            (0.0, robot.chassis_inertia + coupling * offset, 0.0),
            (0.0, 0.0, robot.body.inertia),
        ),
        across=offset,
        gyroscopic=lambda u: (coupling * u[1] * u[1], -coupling * u[1] * u[0], 0.0),
        body_twist=body_twist,
        chassis_angle=lambda heading, angles: heading - angles[2],
    )


CHASSIS: dict[str, Callable[[Any], Chassis]] = {"omni": omni, "offset_differential": offset_differential}


class Dynamics:
    """Moving state of one robot: quasi-velocities, joint angles and rates, pose. The writer is `step`."""

    def __init__(self, chassis: Chassis) -> None:
        self.external: Vector = (0.0, 0.0, 0.0)  # generalised force on u, e.g. a push in an experiment
        self.push = 0.0  # N at the centre of mass, along world x
        self.slope = 0.0  # rad, rising along world x
        self.pose = _ORIGIN
        self.angles = tuple(0.0 for _ in chassis.rows)
        self._force = self.external
        self._build(chassis)
        self.reflected_inertia = tuple(self._reflected(row) for row in chassis.rows)  # per joint, others free
        self.set_velocity((0.0, 0.0, 0.0))

    def _build(self, chassis: Chassis) -> None:
        rows = np.array(chassis.rows)
        mass = np.array(chassis.mass) + chassis.body.joint_inertia * rows.T @ rows
        inverse = np.linalg.inv(mass)
        self._chassis = chassis
        self._rows = chassis.rows
        self._mass = mass
        self._inverse = inverse
        self._mobility = _rows(inverse)
        self._torque_rows = _rows(inverse @ rows.T)
        self._damping = _rows(-chassis.body.joint_friction * inverse @ rows.T @ rows)
        self._gyroscopic = chassis.gyroscopic

    def _reflected(self, row: Vector) -> float:
        joint = np.array(row)
        return 1.0 / float(joint @ self._inverse @ joint)

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
        return float(u @ self._mass @ u) / 2.0

    def set_velocity(self, velocity: Vector) -> None:
        """Start an experiment in motion."""
        self._velocity = velocity
        self.rates = self._joint_rates(velocity)

    def load(self, chassis: Chassis) -> None:
        """Another mass from now on: a load put on was at rest before, a load taken off keeps its own momentum."""
        before = self._mass
        self._build(chassis)
        if np.trace(self._mass) > np.trace(before):
            a, b, c = (self._inverse @ before @ np.array(self._velocity)).tolist()
            self.set_velocity((a, b, c))

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques."""
        self._force = self._outer_force() if self.push or self.slope else self.external
        half = STEP_S / 2.0
        drive = tuple(sum(map(mul, row, self._less_drag(torques))) for row in self._torque_rows)
        a, b, c = self._velocity
        da, db, dc = self._acceleration((a, b, c), drive)
        middle = (a + half * da, b + half * db, c + half * dc)
        da, db, dc = self._acceleration(middle, drive)
        self._move(middle)
        self.set_velocity((a + STEP_S * da, b + STEP_S * db, c + STEP_S * dc))

    def _outer_force(self) -> Vector:
        """Push and weight along world x, seen from the chassis."""
        mass = self._chassis.mass[0][0]
        force = self.push - mass * GRAVITY * sin(self.slope)
        ea, eb, ec = self.external
        angle = self.chassis_angle
        return ea + force * cos(angle), eb - force * sin(angle) * self._chassis.across, ec

    def _less_drag(self, torques: Sequence[float]) -> Sequence[float]:
        drag = self._chassis.body.joint_drag
        if not drag:
            return torques
        return [torque - drag * tanh(rate / _DRAG_SPEED) for torque, rate in zip(torques, self.rates, strict=True)]

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

    def _move(self, middle: Vector) -> None:
        """Advance angles and pose with the velocity of mid-step, in the heading of mid-step."""
        rates = self._joint_rates(middle)
        halfway = [angle + STEP_S / 2.0 * rate for angle, rate in zip(self.angles, rates, strict=True)]
        vx, vy, wz = self._chassis.body_twist(middle, halfway)
        x, y, theta = self.pose
        heading = theta + STEP_S / 2.0 * wz
        c, s = cos(heading) * STEP_S, sin(heading) * STEP_S
        self.pose = Pose(x + vx * c - vy * s, y + vx * s + vy * c, theta + STEP_S * wz)
        self.angles = tuple([angle + STEP_S * rate for angle, rate in zip(self.angles, rates, strict=True)])

    def _joint_rates(self, u: Vector) -> tuple[float, ...]:
        a, b, c = u
        return tuple([row_a * a + row_b * b + row_c * c for row_a, row_b, row_c in self._rows])


def _rows(matrix: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)
