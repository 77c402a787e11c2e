"""The simple plant of an ODD: two equal bodies on slides, over four mecanum wheels in line.

How this works
--------------
Quasi-velocities u = (vx, vy, wz, width rate); joint rates are R(d) u with rows that change with the width d. The halves
stand at +-d/2, so the inertia about the vertical is I(d) = I0 + m/4 (d^2 - d0^2), and with I' its derivative

    m (dvx - wz vy) = Fx          I dwz + I' d' wz = N
    m (dvy + wz vx) = Fy          m/4 d'' - I'/2 wz^2 = Fd

(science: equations 9 to 11 corrected, for equal halves, summed). Wheels add their inertia along their rows and what the
rows' change takes of it. Explicit midpoint rule. A wheel on slippery ground has a speed of its own, as in `rigid_body`.
At an end of its range the width stops dead: what moved it there is lost.
"""

from collections.abc import Sequence
from math import cos, isinf, sin, tan, tanh

import numpy as np
from numpy.typing import NDArray

from gateway.chassis.odd import OddRobot
from gateway.types import Pose, Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import odd_dynamics
from replay.sim.plants.contract import Plant
from replay.sim.plants.rigid_body import GRAVITY

Array = NDArray[np.float64]
_WIDTH = 3  # place of its rate in u
_DRAG_SPEED = 0.05  # rad/s below which dry friction fades
_NO_SLIP = 1e-6  # rad/s
_SAME_TORQUE = 1e-9  # N m
_MAX_ROUNDS = 60
_CHANGE = (-0.5, -0.5, 0.5, 0.5)  # of a row's wz per metre of width


def plant(robot: OddRobot) -> Plant:
    """Of this robot; one that balances leans, which is nothing simple: it gets its dynamics."""
    return OddPlant(robot) if robot.balance is None else odd_dynamics.plant(robot)


class OddPlant:
    """A plant; the writer is `step`. `width`, m, and its rate beside what every plant has."""

    def __init__(self, robot: OddRobot) -> None:
        if robot.body.inertia <= 0.25 * robot.body.mass * (robot.width**2 - robot.narrowest**2):
            raise ValueError("robot.body.inertia: too small for halves that slide so far")
        self._robot = robot
        self._body = robot.body
        self._mass = robot.body.mass
        tangents = np.array([tan(angle) for angle in robot.roller_angles])
        columns = (np.ones(4), tangents, np.zeros(4), tangents * [0.5, 0.5, -0.5, -0.5])
        self._fixed: Array = np.column_stack(columns) / robot.radius  # but for the turning
        self._grips = [robot.radius * abs(cos(angle)) / 4.0 for angle in robot.roller_angles]  # levers, m
        self.push = 0.0
        self.slope = 0.0
        self.pose = Pose(0.0, 0.0, 0.0)
        self.width = robot.width
        self.angles: tuple[float, ...] = (0.0,) * 4
        self._u: Array = np.zeros(4)
        self._friction: dict[int, float] = {}
        self._spins: dict[int, float] = {}
        self._traction: dict[int, float] = {}
        rows, inverse = self._rows(self.width), np.linalg.inv(self._inertia(self.width))
        self.reflected_inertia = tuple(float(1.0 / (row @ inverse @ row)) for row in rows)

    @property
    def wheels(self) -> tuple[int, ...]:
        """All of them."""
        return (0, 1, 2, 3)

    @property
    def twist(self) -> Twist:
        """Body twist of `base_link`."""
        vx, vy, wz, _ = self._u.tolist()
        return Twist(vx, vy, wz)

    @property
    def width_rate(self) -> float:
        """By which the pairs go apart, m/s."""
        return float(self._u[_WIDTH])

    @property
    def rates(self) -> tuple[float, ...]:
        """Joint rates, rad/s."""
        return self._rates(self._u, self.width)

    @property
    def chassis_angle(self) -> float:
        """The body carries its wheels."""
        return self.pose.theta

    @property
    def energy(self) -> float:
        """Kinetic energy, joints included, J."""
        spinning = self._body.joint_inertia * sum(rate * rate for rate in self._spins.values())
        return float(self._u @ self._inertia(self.width) @ self._u + spinning) / 2.0

    @property
    def slipping(self) -> tuple[int, ...]:
        """Joints whose wheels slip."""
        rolled = self._rows(self.width) @ self._u
        return tuple(sorted(joint for joint, spin in self._spins.items() if abs(spin - rolled[joint]) > _NO_SLIP))

    def place(self, angles: Sequence[float]) -> None:
        """Where the joints stand before the first step."""
        self.angles = tuple(angles)

    def can_slip(self, joint: int) -> bool:
        """A wheel with an inertia of its own can."""
        return self._body.joint_inertia > 0.0

    def set_friction(self, joint: int, friction: float) -> None:
        """Coefficient of friction under a wheel; infinite: it grips."""
        if not self.can_slip(joint):
            raise ValueError(f"joint {joint}: only a wheel with inertia can slip")
        if isinf(friction):
            self._friction.pop(joint, None)
            if joint in self._spins:
                self._grip(joint)
            return
        self._friction[joint] = friction
        self._traction.setdefault(joint, 0.0)
        self._spins.setdefault(joint, self.rates[joint])

    def set_mass(self, mass: float | None) -> None:
        """Another mass: a load put on was at rest before, one taken off keeps its own momentum."""
        before, old = self._inertia(self.width), self._mass
        self._mass = self._body.mass if mass is None else mass
        if self._mass > old:
            self._u = np.asarray(np.linalg.solve(self._inertia(self.width), before @ self._u), np.float64)

    def step(self, torques: Sequence[float]) -> None:
        """One substep under constant joint torques, N m."""
        half, before, width = STEP_S / 2.0, self._u.tolist(), self.width + STEP_S / 2.0 * float(self._u[_WIDTH])
        rows = self._rows(width).tolist()  # of mid-step serve both halves to second order
        inverse = np.linalg.inv(self._inertia(width)).tolist()
        change = self._acceleration(before, width, torques, rows, inverse)
        middle = [old + half * rate for old, rate in zip(before, change, strict=True)]
        change = self._acceleration(middle, width, torques, rows, inverse)
        after = np.array([old + STEP_S * rate for old, rate in zip(before, change, strict=True)])
        if self._spins:
            spins = self._spun(torques)
            after = self._give_traction(after, spins, width)
            self._spins = {joint: (spin + spins[joint]) / 2.0 for joint, spin in self._spins.items()}
            self._move([(old + new) / 2.0 for old, new in zip(before, after.tolist(), strict=True)], rows)
            self._spins = spins
        else:
            self._move(middle, rows)
        self._u = self._stopped(after)

    # the equation of motion

    def _rows(self, width: float) -> Array:
        far, near = 0.5 * (width + self._robot.spacing), 0.5 * (width - self._robot.spacing)
        rows = self._fixed.copy()
        rows[:, 2] = -far, -near, near, far
        rows[:, 2] /= self._robot.radius
        return rows

    def _inertia(self, width: float) -> Array:
        """Of the body and of the wheels that are held to it."""
        mass = self._mass
        gripping = self._gripping(self._rows(width))
        together: Array = self._body.joint_inertia * (gripping.T @ gripping)
        together[0, 0] += mass
        together[1, 1] += mass
        together[2, 2] += self._body.inertia + 0.25 * self._body.mass * (
            width * width - self._robot.width * self._robot.width
        )
        together[3, 3] += 0.25 * self._body.mass
        return together

    def _gripping(self, rows: Array) -> Array:
        return rows[[joint for joint in range(4) if joint not in self._spins]] if self._spins else rows

    def _acceleration(
        self,
        u: Sequence[float],
        width: float,
        torques: Sequence[float],
        rows: Sequence[Sequence[float]],
        inverse: Sequence[Sequence[float]],
    ) -> list[float]:
        vx, vy, wz, rate = u
        mass, body = self._mass, self._body
        slope = 0.5 * body.mass * width  # of the inertia over the width; what is loaded is over the middle
        force = self.push - mass * GRAVITY * sin(self.slope)
        fx, fy = force * cos(self.pose.theta) + mass * wz * vy, -force * sin(self.pose.theta) - mass * wz * vx
        turning, apart = -slope * rate * wz, 0.5 * slope * wz * wz
        changing = body.joint_inertia * rate * wz / self._robot.radius
        for joint, (a, b, c, d) in enumerate(rows):
            if joint in self._spins:
                given = self._traction[joint]
            else:
                spin = a * vx + b * vy + c * wz + d * rate
                given = torques[joint] - body.joint_drag * tanh(spin / _DRAG_SPEED) - body.joint_friction * spin
                given -= _CHANGE[joint] * changing
            fx, fy, turning, apart = fx + a * given, fy + b * given, turning + c * given, apart + d * given
        return [a * fx + b * fy + c * turning + d * apart for a, b, c, d in inverse]

    def _rates(self, u: Array, width: float) -> tuple[float, ...]:
        rates = (self._rows(width) @ u).tolist()
        return tuple(self._spins.get(joint, rate) for joint, rate in enumerate(rates))

    def _move(self, middle: Sequence[float], rows: Sequence[Sequence[float]]) -> None:
        vx, vy, wz, rate = middle
        x, y, theta = self.pose
        heading = theta + STEP_S / 2.0 * wz
        c, s = cos(heading) * STEP_S, sin(heading) * STEP_S
        rolled = [a * vx + b * vy + f * wz + d * rate for a, b, f, d in rows]
        self.angles = tuple(
            angle + STEP_S * self._spins.get(joint, rolled[joint]) for joint, angle in enumerate(self.angles)
        )
        self.pose = Pose(x + vx * c - vy * s, y + vx * s + vy * c, theta + STEP_S * wz)
        self.width = min(max(self.width + STEP_S * rate, self._robot.narrowest), self._robot.widest)

    def _stopped(self, u: Array) -> Array:
        """Without what of it goes on beyond an end of the range: an impact that takes the width's rate."""
        ends = (self._robot.widest, 1.0), (self._robot.narrowest, -1.0)
        if not any(self.width == end and u[_WIDTH] * outward > 0.0 for end, outward in ends):
            return u
        reach = np.linalg.inv(self._inertia(self.width))[_WIDTH]
        stopped: Array = u - reach * (u[_WIDTH] / reach[_WIDTH])
        stopped[_WIDTH] = 0.0
        return stopped

    # wheels on slippery ground

    def _spun(self, torques: Sequence[float]) -> dict[int, float]:
        half, body = STEP_S / 2.0, self._body
        spins = {}
        for joint, rate in self._spins.items():
            softened = rate / tanh(rate / _DRAG_SPEED) if rate else _DRAG_SPEED
            slowing = body.joint_friction + body.joint_drag / softened
            spare = torques[joint] - self._traction[joint]
            spins[joint] = rate + STEP_S * (spare - slowing * rate) / (body.joint_inertia + half * slowing)
        return spins

    def _give_traction(self, u: Array, spins: dict[int, float], width: float) -> Array:
        """Correct the traction wheel by wheel until nothing changes."""
        rows, inertia = self._rows(width), self._body.joint_inertia
        reaches = np.linalg.solve(self._inertia(width), rows.T).T
        weight = self._mass * GRAVITY * cos(self.slope)
        for _ in range(_MAX_ROUNDS):
            largest = 0.0
            for joint in self._spins:
                row, reach, given = rows[joint], reaches[joint], self._traction[joint]
                limit = self._friction[joint] * weight * self._grips[joint]
                yielding = 1.0 / inertia + float(row @ reach)
                slip = spins[joint] - float(row @ u)
                change = max(-limit, min(limit, given + slip / (STEP_S * yielding))) - given
                self._traction[joint] = given + change
                spins[joint] -= STEP_S * change / inertia
                u = u + STEP_S * change * reach
                largest = max(largest, abs(change))
            if largest <= _SAME_TORQUE:
                break
        return u

    def _grip(self, joint: int) -> None:
        """The wheel is held to its row again: wheel and body keep their momentum together."""
        spin = self._body.joint_inertia * self._spins[joint]
        momentum = self._inertia(self.width) @ self._u + spin * self._rows(self.width)[joint]
        del self._spins[joint], self._traction[joint]
        self._u = np.linalg.solve(self._inertia(self.width), momentum)
