"""Dynamics of the offset-differential robot with its caster: eight coordinates, five rolling constraints.

How this works
--------------
q = (left, right, joint, x, y, platform, swivel, caster): angles of the wheels, of the platform joint phi = platform -
chassis heading, place of the joint, heading of the platform, swivel of the caster's fork against the chassis, angle of
its wheel. Six bodies: chassis, two wheels, platform, fork, caster wheel. With M from their velocities,
    M q'' + c(q, q') = T tau - friction q' + external + A' lambda,    A q' = 0
(preprints202312.1327, Eqs. 27-30, in the signs of science 1.2 and 1.5: the printed caster row has the wrong one).
The constraints leave three velocities, w = (x', y', platform'): q' = B(q) w, with B written down here from geometry. So
the ground's forces drop out of B' (...) = 0, nothing drifts off its constraints, and three equations are solved; the
forces are found afterwards from what the bodies really do.
"""

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay.sim.plants.offset_parameters import (
    CASTER,
    DRIVEN,
    JOINT,
    LEFT,
    PLATFORM,
    RIGHT,
    SETS,
    SWIVEL,
    OffsetParameters,
    X,
    Y,
    trailing,
)

Array = NDArray[np.float64]
Numbers = Sequence[float] | Array

__all__ = (
    "JOINT",
    "SETS",
    "SWIVEL",
    "OffsetDynamics",
    "OffsetParameters",
    "trailing",
)  # what those who come for the equations need


class Moving(NamedTuple):
    """Everything that follows from place and free rates: `rates` q', `spread` B, `bias` q'' where w does not change."""

    rates: Array
    spread: Array
    bias: Array
    mass: Array
    inertial: Array  # c(q, q')


class InverseSolution(NamedTuple):
    """Torques of the motors, N m, the force of the ground on the robot, N, and the acceleration of all coordinates."""

    torques: tuple[float, float, float]
    ground: tuple[float, float]
    acceleration: Array


class OffsetDynamics:
    """The equations of one set of parameters."""

    def __init__(self, parameters: OffsetParameters) -> None:
        p = self.parameters = parameters
        self._friction = np.array(p.friction)
        # Points that carry mass: (kg, ahead of the joint, left of it, along the fork), m.
        half = p.track / 2.0
        self._points = (
            (p.chassis_mass, p.chassis_offset, 0.0, 0.0),
            (p.wheel_mass, -p.axle_offset, half, 0.0),
            (p.wheel_mass, -p.axle_offset, -half, 0.0),
            (p.platform_mass, 0.0, 0.0, 0.0),
            (p.fork_mass, p.caster_position, 0.0, p.fork_share * p.trail),
            (p.caster_mass, p.caster_position, 0.0, p.trail),
        )
        self._spins = _spins(p)

    def moving(self, place: Numbers, free: Numbers) -> Moving:
        """At this place, with these free rates (m/s, m/s, rad/s)."""
        spread = self.spread(place)
        rates = spread @ np.asarray(free, dtype=float)
        mass, inertial = self._mass(place, rates)
        return Moving(rates, spread, self._bias(place, rates), mass, inertial)

    def spread(self, place: Numbers) -> Array:
        """B of q' = B w: what every coordinate does for each of the free rates."""
        p, heading = self.parameters, place[PLATFORM] - place[JOINT]
        along, across, fork, axle = _directions(heading, heading + place[SWIVEL])
        turn = across / p.axle_offset
        lateral = p.trail + p.caster_position * sin(place[SWIVEL])
        rows = np.zeros((8, 3))
        rows[LEFT, :2] = (along - turn * p.track / 2.0) / p.wheel_radius
        rows[RIGHT, :2] = (along + turn * p.track / 2.0) / p.wheel_radius
        rows[JOINT] = (-turn[0], -turn[1], 1.0)
        rows[(X, Y, PLATFORM), (0, 1, 2)] = 1.0
        rows[SWIVEL, :2] = -(axle + lateral * turn) / p.trail
        rows[CASTER, :2] = (fork - p.caster_position * cos(place[SWIVEL]) * turn) / p.caster_radius
        return rows

    def acceleration(
        self,
        place: Numbers,
        free: Numbers,
        torques: Numbers,
        push: Numbers = (0.0, 0.0),
    ) -> Array:
        """w' (forward dynamics), with motor torques, N m, and a force at the joint, N."""
        now = self.moving(place, free)
        force = self._applied(now.rates, torques, push)
        lever = now.spread.T
        inertia, drive = lever @ now.mass @ now.spread, lever @ (force - now.inertial - now.mass @ now.bias)
        return np.asarray(np.linalg.solve(inertia, drive), dtype=np.float64)

    def inverse(self, place: Numbers, free: Numbers, wanted: Numbers) -> InverseSolution:
        """Torques for these free accelerations (m/s^2, m/s^2, rad/s^2), and what the ground then does."""
        now = self.moving(place, free)
        acceleration = now.spread @ np.asarray(wanted, dtype=float) + now.bias
        needed = now.mass @ acceleration + now.inertial + self._friction * now.rates
        motors = np.linalg.solve(now.spread[list(DRIVEN)].T, now.spread.T @ needed)
        left, right, joint = map(float, motors)
        momentum = now.mass @ acceleration + now.inertial
        return InverseSolution((left, right, joint), (float(momentum[X]), float(momentum[Y])), acceleration)

    def energy(self, place: Numbers, free: Numbers) -> float:
        """Of the motion, J."""
        now = self.moving(place, free)
        return float(now.rates @ now.mass @ now.rates) / 2.0

    def power(self, place: Numbers, free: Numbers, torques: Numbers) -> float:
        """What motors and friction give it, W."""
        rates = self.spread(place) @ np.asarray(free, dtype=float)
        return float(self._applied(rates, torques, (0.0, 0.0)) @ rates)

    def step(
        self,
        place: Array,
        free: Array,
        torques: Numbers,
        seconds: float,
        push: Numbers = (0.0, 0.0),
    ) -> tuple[Array, Array]:
        """Place and free rates after so many seconds of these torques (Runge-Kutta of fourth order)."""

        def slope(at: Array, rate: Array) -> tuple[Array, Array]:
            return self.spread(at) @ rate, self.acceleration(at, rate, torques, push)

        h = seconds
        q1, w1 = slope(place, free)
        q2, w2 = slope(place + h / 2 * q1, free + h / 2 * w1)
        q3, w3 = slope(place + h / 2 * q2, free + h / 2 * w2)
        q4, w4 = slope(place + h * q3, free + h * w3)
        return place + h / 6 * (q1 + 2 * q2 + 2 * q3 + q4), free + h / 6 * (w1 + 2 * w2 + 2 * w3 + w4)

    def _applied(self, rates: Array, torques: Numbers, push: Numbers) -> Array:
        force = -self._friction * rates
        force[list(DRIVEN)] += torques
        force[[X, Y]] += push
        return force

    def _mass(self, place: Numbers, rates: Array) -> tuple[Array, Array]:
        """M, and what of the inertial forces comes from velocities alone."""
        heading = place[PLATFORM] - place[JOINT]
        along, across, fork, axle = _directions(heading, heading + place[SWIVEL])
        turning = rates[PLATFORM] - rates[JOINT]
        swinging = turning + rates[SWIVEL]
        mass, inertial = self._spins.copy(), np.zeros(8)
        for kilograms, ahead, left, trailed in self._points:
            lever = ahead * across - left * along + trailed * axle
            rows = np.zeros((2, 8))
            rows[0, X] = rows[1, Y] = 1.0
            rows[:, PLATFORM] = lever
            rows[:, JOINT] = -lever
            rows[:, SWIVEL] = trailed * axle
            centripetal = -turning * turning * (ahead * along + left * across) - swinging * swinging * trailed * fork
            mass += kilograms * rows.T @ rows
            inertial += kilograms * rows.T @ centripetal
        return mass, inertial

    def _bias(self, place: Numbers, rates: Array) -> Array:
        """q'' where the free rates stay as they are: the constraints, differentiated."""
        p, heading = self.parameters, place[PLATFORM] - place[JOINT]
        along, across, fork, axle = _directions(heading, heading + place[SWIVEL])
        velocity = rates[[X, Y]]
        turning = rates[PLATFORM] - rates[JOINT]
        swinging = turning + rates[SWIVEL]
        s, c = sin(place[SWIVEL]), cos(place[SWIVEL])
        turn = -turning * (along @ velocity) / p.axle_offset
        forward = turning * (across @ velocity)
        bias = np.zeros(8)
        bias[LEFT] = (forward - turn * p.track / 2.0) / p.wheel_radius
        bias[RIGHT] = (forward + turn * p.track / 2.0) / p.wheel_radius
        bias[JOINT] = -turn
        lateral = (p.trail + p.caster_position * s) * turn + p.caster_position * c * rates[SWIVEL] * turning
        bias[SWIVEL] = -(-swinging * (fork @ velocity) + lateral) / p.trail
        rolling = swinging * (axle @ velocity) - p.caster_position * (c * turn - s * rates[SWIVEL] * turning)
        bias[CASTER] = rolling / p.caster_radius
        return bias


def _spins(p: OffsetParameters) -> Array:
    """What the bodies' own turning adds to M; it depends on no coordinate."""
    found = np.zeros((8, 8))
    chassis = np.zeros(8)
    chassis[[PLATFORM, JOINT]] = 1.0, -1.0
    fork = chassis.copy()
    fork[SWIVEL] = 1.0
    found += (p.chassis_inertia + 2.0 * p.wheel_radial) * np.outer(chassis, chassis)
    found += (p.fork_inertia + p.caster_radial) * np.outer(fork, fork)
    found[PLATFORM, PLATFORM] += p.platform_inertia
    found[LEFT, LEFT] = found[RIGHT, RIGHT] = p.wheel_axial
    found[CASTER, CASTER] = p.caster_axial
    found[JOINT, JOINT] += p.joint_inertia
    return found


def _directions(heading: float, fork: float) -> tuple[Array, Array, Array, Array]:
    """Unit vectors in the world: along the chassis, to its left, along the fork, along the caster's axle."""
    s, c = sin(heading), cos(heading)
    fork_s, fork_c = sin(fork), cos(fork)
    return np.array((c, s)), np.array((-s, c)), np.array((fork_s, -fork_c)), np.array((fork_c, fork_s))
