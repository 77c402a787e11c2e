"""The dynamics of the offset-differential robot once more, with Lagrange multipliers: what the product's are held to.

Written by somebody else from the same text, before the two were compared; it shares no code with the product's.

How this works
--------------
Coordinates: wheel angles left and right, platform joint, x and y of the pivot, platform heading, caster fork, caster
wheel (MOBY, order of its Eq. 5). Every body gives its mass, the Jacobian of its centre and the acceleration that the
centre has at zero coordinate accelerations; mass matrix and bias are sums of those, the constraints are velocities of
wheel centres along given directions. No matrix is typed, so no sign of the paper is (its Eq. 6 has a wrong one).
`rates` makes all velocities from the motion of the platform (x, y, heading), three numbers that the constraints leave
free: who integrates those instead of all eight has no drift to correct, the constraints hold to rounding.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEFT, RIGHT, JOINT, X, Y, HEADING, FORK, CASTER = range(8)
MOTORS = [LEFT, RIGHT, JOINT]
FREE = [X, Y, HEADING]
_DEPENDENT = [LEFT, RIGHT, JOINT, FORK, CASTER]


class OffsetParameters(NamedTuple):
    """Lengths in m, masses in kg, inertias in kg m^2 about the centre of each body, friction in N m s/rad.

    `offset`, `track`: pivot to axle, wheel to wheel; `reach`, `trail`: pivot to caster joint, joint to caster wheel.
    """

    radius: float
    offset: float
    track: float
    chassis_mass: float
    chassis_centre: float  # along the chassis, ahead of the pivot
    chassis_inertia: float
    trail: float = 0.05
    reach: float = 0.25
    caster_radius: float = 0.05
    wheel_mass: float = 2.0714
    wheel_axial: float = 0.0103570
    wheel_radial: float = 0.00561007
    platform_mass: float = 21.94795
    platform_inertia: float = 2.22223
    fork_mass: float = 0.5
    fork_centre: float = 0.5  # share of the trail
    fork_inertia: float = 0.5 * 0.05**2 / 12.0  # a rod
    caster_mass: float = 0.7
    caster_axial: float = 0.7 * 0.05**2 / 2.0  # a disc
    caster_radial: float = 0.7 * 0.05**2 / 4.0
    friction: tuple[float, ...] = (0.0,) * 8  # viscous, per coordinate


# A: the published Otbot-1; B: its centre of mass fitted; C, D: more is fitted, they agree with the paper by that alone.
PRESETS = {
    "A": OffsetParameters(0.10, 0.25, 0.40, 105.0, -0.125, 1.065),
    "B": OffsetParameters(0.10, 0.25, 0.40, 105.0, -0.086, 1.3),
    "C": OffsetParameters(0.1016, 0.25, 0.15, 105.0, -0.086, 1.3),
    "D": OffsetParameters(0.1043, 0.30, 0.40, 105.0, -0.125, 1.3),
}


class Inverse(NamedTuple):
    """Motor torques (left, right, joint), N m; force of the ground on the whole robot in the world, N."""

    torques: Array
    ground: Array


class OffsetDynamics:
    """The robot of one parameter set. Angles in rad, world frame, coordinates in the order of the module."""

    def __init__(self, parameters: OffsetParameters) -> None:
        self._p = parameters
        self._friction = np.array(parameters.friction)

    def rates(self, q: Array, free: Array) -> Array:
        """All coordinate rates (8) of a motion of the platform (x, y, heading)."""
        return self._completed(self._constraints(q, np.zeros(8))[0], free, np.zeros(5))

    def residual(self, q: Array, rates: Array) -> Array:
        """How fast each constraint is violated (5), m/s."""
        return np.asarray(self._constraints(q, rates)[0] @ rates)

    def energy(self, q: Array, rates: Array) -> float:
        """Kinetic, J."""
        return float(rates @ self._mass(q, rates)[0] @ rates / 2.0)

    def forward(self, q: Array, rates: Array, torques: Array, force: Array | None = None) -> tuple[Array, Array]:
        """Coordinate accelerations (8) and multipliers (5); `force`: generalised, from outside (8)."""
        mass, bias = self._mass(q, rates)
        rows, drift = self._constraints(q, rates)
        system = np.block([[mass, rows.T], [rows, np.zeros((5, 5))]])
        solved = np.linalg.solve(system, np.concatenate([self._applied(rates, torques, force) - bias, -drift]))
        return solved[:8], solved[8:]

    def accelerations(self, q: Array, rates: Array, free: Array) -> Array:
        """All coordinate accelerations (8) of an acceleration of the platform (x, y, heading)."""
        rows, drift = self._constraints(q, rates)
        return self._completed(rows, free, drift)

    def inverse(self, q: Array, rates: Array, accelerations: Array, force: Array | None = None) -> Inverse:
        """What the motors and the ground must do for it (MOBY Eq. 30 with its missing inverse)."""
        mass, bias = self._mass(q, rates)
        rows, _ = self._constraints(q, rates)
        needed = mass @ accelerations + bias - self._applied(rates, np.zeros(3), force)
        solved = np.asarray(np.linalg.solve(np.hstack([np.eye(8)[:, MOTORS], -rows.T]), needed), dtype=np.float64)
        return Inverse(solved[:3], np.asarray(-(rows.T @ solved[3:])[[X, Y]]))

    def _applied(self, rates: Array, torques: Array, force: Array | None) -> Array:
        applied = -self._friction * rates if force is None else force - self._friction * rates
        applied[MOTORS] += torques
        return applied

    @staticmethod
    def _completed(rows: Array, free: Array, drift: Array) -> Array:
        whole = np.zeros(8)
        whole[FREE] = free
        whole[_DEPENDENT] = np.linalg.solve(rows[:, _DEPENDENT], -rows[:, FREE] @ free - drift)
        return whole

    def _mass(self, q: Array, rates: Array) -> tuple[Array, Array]:
        p = self._p
        mass, bias = np.zeros((8, 8)), np.zeros(8)
        bodies = (
            (p.chassis_mass, p.chassis_centre, 0.0, 0.0),
            (p.wheel_mass, -p.offset, p.track / 2.0, 0.0),
            (p.wheel_mass, -p.offset, -p.track / 2.0, 0.0),
            (p.platform_mass, 0.0, 0.0, 0.0),
            (p.fork_mass, p.reach, 0.0, p.fork_centre * p.trail),
            (p.caster_mass, p.reach, 0.0, p.trail),
        )
        for kilograms, ahead, left, out in bodies:
            jacobian, centripetal = _point(q, rates, ahead, left, out)
            mass += kilograms * jacobian.T @ jacobian
            bias += kilograms * jacobian.T @ centripetal
        for inertia, turning in (
            (p.chassis_inertia + 2.0 * p.wheel_radial, _CHASSIS_TURNS),
            (p.fork_inertia + p.caster_radial, _FORK_TURNS),
        ):
            mass += inertia * np.outer(turning, turning)
        for index, inertia in (
            (LEFT, p.wheel_axial),
            (RIGHT, p.wheel_axial),
            (CASTER, p.caster_axial),
            (HEADING, p.platform_inertia),
        ):
            mass[index, index] += inertia
        return mass, bias

    def _constraints(self, q: Array, rates: Array) -> tuple[Array, Array]:
        """Rows (5, 8) and their change times the rates (5): left and right roll, axle, caster sideways and rolling."""
        p = self._p
        heading, axle = q[HEADING] - q[JOINT], q[HEADING] - q[JOINT] + q[FORK]
        turn, fork_turn = float(_CHASSIS_TURNS @ rates), float(_FORK_TURNS @ rates)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        across = np.array([np.cos(axle), np.sin(axle)])
        rolls = (
            (-p.offset, p.track / 2.0, 0.0, ahead, turn, LEFT, p.radius),
            (-p.offset, -p.track / 2.0, 0.0, ahead, turn, RIGHT, p.radius),
            (-p.offset, 0.0, 0.0, _turned(ahead), turn, LEFT, 0.0),
            (p.reach, 0.0, p.trail, across, fork_turn, CASTER, 0.0),
            (p.reach, 0.0, p.trail, -_turned(across), fork_turn, CASTER, p.caster_radius),
        )
        rows, drift = np.zeros((5, 8)), np.zeros(5)
        for row, (along, left, out, way, way_turn, wheel, radius) in enumerate(rolls):
            jacobian, centripetal = _point(q, rates, along, left, out)
            rows[row] = way @ jacobian
            rows[row, wheel] -= radius
            drift[row] = way @ centripetal + way_turn * (_turned(way) @ (jacobian @ rates))
        return rows, drift


_CHASSIS_TURNS = np.zeros(8)
_CHASSIS_TURNS[[HEADING, JOINT]] = 1.0, -1.0
_FORK_TURNS = _CHASSIS_TURNS.copy()
_FORK_TURNS[FORK] = 1.0


def _turned(vector: Array) -> Array:
    """A quarter turn to the left."""
    return np.array([-vector[1], vector[0]])


def _point(q: Array, rates: Array, ahead: float, left: float, out: float) -> tuple[Array, Array]:
    """Jacobian (2, 8) and centripetal acceleration of a point so far along the chassis, and so far out on the fork."""
    heading = q[HEADING] - q[JOINT]
    c, s = np.cos(heading), np.sin(heading)
    arm = np.array([c * ahead - s * left, s * ahead + c * left])
    fork = out * np.array([np.sin(heading + q[FORK]), -np.cos(heading + q[FORK])])
    jacobian = np.outer(_turned(arm), _CHASSIS_TURNS) + np.outer(_turned(fork), _FORK_TURNS)
    jacobian[0, X] = jacobian[1, Y] = 1.0
    turn, fork_turn = _CHASSIS_TURNS @ rates, _FORK_TURNS @ rates
    return jacobian, -(turn**2) * arm - fork_turn**2 * fork
