"""Dynamics of the offset-differential robot with its caster, forward and inverse, in the coordinates of the paper.

How this works
--------------
q = (left, right, joint, x, y, platform, swivel, caster): angles of the wheels, of the platform joint phi = platform -
chassis heading, place of the joint, heading of the platform, swivel of the caster's fork against the chassis, angle of
its wheel, with
    M q'' + c(q, q') = T tau - friction q' + external + A' lambda,    A q' = 0
(preprints202312.1327, Eqs. 27-30, in the signs of science 1.2 and 1.5: the printed caster row has the wrong one).
The constraints leave three velocities, here (x', y', platform') in the world. What follows from them is in
`OffsetEquations`, in chassis axes; this file only turns its axes, and names all eight coordinates.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.arithmetic import sin_cos
from replay.sim.plants.offset_equations import Motion, OffsetEquations
from replay.sim.plants.offset_parameters import (
    DRIVEN,
    JOINT,
    PLATFORM,
    SETS,
    SWIVEL,
    OffsetParameters,
    trailing,
)

Array = NDArray[np.float64]
Numbers = Sequence[float] | Array

__all__ = ("JOINT", "PLATFORM", "SETS", "SWIVEL", "Array", "OffsetDynamics", "OffsetParameters", "trailing")


class Moving(NamedTuple):
    """Everything that follows from place and free rates: `rates` q', `spread` B, `bias` q'' where w does not change."""

    rates: Array
    spread: Array
    bias: Array


class InverseSolution(NamedTuple):
    """Torques of the motors, N m, the force of the ground on the robot, N, and the acceleration of all coordinates."""

    torques: tuple[float, float, float]
    ground: tuple[float, float]
    acceleration: Array


class _Frame(NamedTuple):
    """Sines and cosines of swivel and chassis heading, and d1."""

    s: float
    c: float
    heading_s: float
    heading_c: float
    offset: float

    def chassis(self, x: float, y: float) -> tuple[float, float]:
        """A vector of the world in chassis axes."""
        return self.heading_c * x + self.heading_s * y, self.heading_c * y - self.heading_s * x

    def world(self, along: float, across: float) -> tuple[float, float]:
        """A vector in chassis axes in the world."""
        return self.heading_c * along - self.heading_s * across, self.heading_s * along + self.heading_c * across

    def motion(self, free: Numbers) -> Motion:
        """The three speeds of `OffsetEquations`."""
        along, across = self.chassis(float(free[0]), float(free[1]))
        return along, across / self.offset, float(free[2])

    def change(self, motion: Motion, wanted: Numbers) -> Motion:
        """How these must change for a change of the free rates: in the chassis' axes, which turn."""
        v, w, _ = motion
        along, across = self.chassis(float(wanted[0]), float(wanted[1]))
        return along + w * self.offset * w, (across - w * v) / self.offset, float(wanted[2])

    def acceleration(self, motion: Motion, change: Motion) -> Array:
        """The change of the free rates: the inverse of `change`."""
        v, w, _ = motion
        x, y = self.world(change[0] - w * self.offset * w, self.offset * change[1] + w * v)
        return np.array((x, y, change[2]))


class OffsetDynamics:
    """The equations of one set of parameters."""

    def __init__(self, parameters: OffsetParameters) -> None:
        self.parameters = parameters
        self._equations = OffsetEquations(parameters)
        self._friction = np.array(parameters.friction)

    def moving(self, place: Numbers, free: Numbers) -> Moving:
        """At this place, with these free rates (m/s, m/s, rad/s)."""
        spread = self.spread(place)
        bias = self.inverse(place, free, (0.0, 0.0, 0.0)).acceleration
        return Moving(spread @ np.asarray(free, dtype=float), spread, bias)

    def spread(self, place: Numbers) -> Array:
        """B of q' = B w: what every coordinate does for each of the free rates."""
        frame = self._frame(place)
        columns = (self._rates(frame, frame.motion(unit), unit) for unit in np.eye(3))
        return np.array(list(columns)).T

    def acceleration(
        self,
        place: Numbers,
        free: Numbers,
        torques: Numbers,
        push: Numbers = (0.0, 0.0),
    ) -> Array:
        """w' (forward dynamics), with motor torques, N m, and a force at the joint, N."""
        frame = self._frame(place)
        motion = frame.motion(free)
        along, turning, platform = self._equations.driven(*map(float, torques))
        ahead, across = frame.chassis(float(push[0]), float(push[1]))
        force = along + ahead, turning + frame.offset * across, platform
        return frame.acceleration(motion, self._equations.acceleration(frame.s, frame.c, motion, force))

    def inverse(self, place: Numbers, free: Numbers, wanted: Numbers) -> InverseSolution:
        """Torques for these free accelerations (m/s^2, m/s^2, rad/s^2), and what the ground then does."""
        frame = self._frame(place)
        motion = frame.motion(free)
        change = frame.change(motion, wanted)
        torques = self._equations.torques_for(frame.s, frame.c, motion, change)
        ground = frame.world(*self._equations.ground(frame.s, frame.c, motion, change))
        acceleration = self._rates(frame, change, wanted)
        acceleration[SWIVEL:] += self._equations.caster_changes(frame.s, frame.c, motion)
        return InverseSolution(torques, ground, acceleration)

    def energy(self, place: Numbers, free: Numbers) -> float:
        """Of the motion, J."""
        frame = self._frame(place)
        return self._equations.energy(frame.s, frame.c, frame.motion(free))

    def power(self, place: Numbers, free: Numbers, torques: Numbers) -> float:
        """What motors and friction give it, W."""
        rates = self.spread(place) @ np.asarray(free, dtype=float)
        return float(np.asarray(torques) @ rates[list(DRIVEN)] - self._friction @ rates**2)

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

    def _frame(self, place: Numbers) -> _Frame:
        heading = float(place[PLATFORM]) - float(place[JOINT])
        return _Frame(*sin_cos(float(place[SWIVEL])), *sin_cos(heading), self.parameters.axle_offset)

    def _rates(self, frame: _Frame, motion: Motion, free: Numbers) -> Array:
        """Of all coordinates, in their order."""
        joints = self._equations.joint_rates(motion)
        return np.array((*joints, *map(float, free), *self._equations.caster_rates(frame.s, frame.c, motion)))
