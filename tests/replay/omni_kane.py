"""The dynamics of a robot on omni wheels by sympy's Kane method, from a description of its bodies: an oracle.

How this works
--------------
What is typed here is a drawing: a base, and per wheel a disc on an axle and the roller that touches the floor, each
with its mass, its inertia and its frame. Wheels roll because the material point of the roller on the floor stands still
(reached from the wheel's centre by the spin of the wheel down to the roller's axle, and by that of the roller from
there down to the floor): two equations per wheel, which make the rates of wheel and roller dependent ones. As in
the paper (Amarasiri et al. 2022), the roller on the floor does not go round with the wheel (another takes its place),
and the others rest in it. No equation of any text is copied. Numbers are put in last.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import NDArray
from sympy.physics.mechanics import KanesMethod, Point, ReferenceFrame, RigidBody, dynamicsymbols, inertia

Array = NDArray[np.float64]


class Wheel(NamedTuple):
    """Place and axle angle, m and rad; masses, kg; inertias about the axle and about the vertical, kg m^2."""

    x: float
    y: float
    axis_angle: float
    radius: float
    mass: float
    axial: float
    upright: float
    roller_radius: float
    roller_mass: float
    roller_axial: float
    roller_upright: float


class Base(NamedTuple):
    """kg, kg m^2 about the vertical; where its centre is, m."""

    mass: float
    upright: float
    x: float
    y: float


class KaneRobot:
    """The derived equations with the numbers of one robot."""

    def __init__(self, base: Base, wheels: tuple[Wheel, ...]) -> None:
        self._numbers = [*base, *[number for wheel in wheels for number in wheel]]
        self._derived = _derived(len(wheels))

    def acceleration(self, heading: float, motion: Array, torques: Array) -> Array:
        """Of all speeds: (vx, vy, w) in body axes, wheels, rollers."""
        speeds = self.speeds(heading, motion)
        mass, forcing = self._derived.dynamics(heading, *speeds, *torques, *self._numbers)
        return np.asarray(np.linalg.solve(mass, np.ravel(forcing)), dtype=np.float64)

    def energy(self, heading: float, motion: Array) -> float:
        """J."""
        return float(self._derived.energy(heading, *self.speeds(heading, motion), *self._numbers))

    def speeds(self, heading: float, motion: Array) -> Array:
        """(vx, vy, w), and what wheels and rollers do while they roll."""
        return np.array([*motion, *self._derived.rolling(heading, *motion, *self._numbers)], dtype=np.float64)


class _Derived(NamedTuple):
    """Functions of heading, speeds (all or the three that are free), torques and numbers, in this order."""

    dynamics: Callable[..., Any]  # M, f of M u' = f
    energy: Callable[..., Any]
    rolling: Callable[..., Any]  # of the three that are free: rates of wheels and rollers


@cache
def _derived(count: int) -> _Derived:
    x, y, heading = dynamicsymbols("x y heading")
    free = dynamicsymbols("vx vy w")
    spins, rolls = dynamicsymbols(f"s:{count}"), dynamicsymbols(f"r:{count}")
    angles, turns = dynamicsymbols(f"a:{count}"), dynamicsymbols(f"b:{count}")
    torques = sp.symbols(f"torque:{count}")
    base, wheels = sp.symbols(Base._fields), [sp.symbols(" ".join(_names(place))) for place in range(count)]

    floor, body, centre, middle = ReferenceFrame("N"), ReferenceFrame("A"), Point("centre"), Point("middle")
    body.orient_axis(floor, heading, floor.z)
    body.set_ang_vel(floor, free[2] * floor.z)
    centre.set_vel(floor, free[0] * body.x + free[1] * body.y)
    middle.set_pos(centre, base[2] * body.x + base[3] * body.y)
    middle.v2pt_theory(centre, floor, body)
    bodies = [RigidBody("base", middle, body, base[0], (inertia(body, 0, 0, base[1]), middle))]
    loads: list[Any] = []
    rolling: list[sp.Expr] = []
    across: list[sp.Expr] = []
    for place in range(count):
        speeds = _Speeds(spins[place], rolls[place], torques[place])
        parts, load, contact = _wheel(_Frames(floor, body, centre), wheels[place], speeds)
        bodies, loads = [*bodies, *parts], [*loads, *load]
        rolling, across = [*rolling, contact[0]], [*across, contact[1]]

    still = [*rolling, *across]
    velocity = centre.vel(floor)
    kane = KanesMethod(
        floor,
        q_ind=[x, y, heading, *angles, *turns],
        u_ind=[*free],
        kd_eqs=[
            x.diff() - velocity.dot(floor.x),
            y.diff() - velocity.dot(floor.y),
            heading.diff() - free[2],
            *[angle.diff() - rate for angle, rate in zip([*angles, *turns], [*spins, *rolls], strict=True)],
        ],
        u_dependent=[*spins, *rolls],
        velocity_constraints=still,
    )
    kane.kanes_equations(bodies, loads)
    held = sp.solve(still, [*spins, *rolls], dict=True)[0]
    energy = sp.Add(*[one.kinetic_energy(floor) for one in bodies])
    every, numbers = [*free, *spins, *rolls], [*base, *[symbol for wheel in wheels for symbol in wheel]]
    return _Derived(
        sp.lambdify([heading, *every, *torques, *numbers], [kane.mass_matrix, kane.forcing], "numpy", cse=True),
        sp.lambdify([heading, *every, *numbers], energy, "numpy", cse=True),
        sp.lambdify([heading, *free, *numbers], [held[one] for one in (*spins, *rolls)], "numpy", cse=True),
    )


class _Frames(NamedTuple):
    """Of floor and body, and the body's origin."""

    floor: ReferenceFrame
    body: ReferenceFrame
    centre: Point


class _Speeds(NamedTuple):
    """Of one wheel and its roller, and the torque of its motor."""

    spin: sp.Expr
    roll: sp.Expr
    torque: sp.Symbol


def _wheel(
    frames: _Frames, wheel: tuple[sp.Symbol, ...], speeds: _Speeds
) -> tuple[list[Any], list[Any], tuple[sp.Expr, sp.Expr]]:
    """Disc and roller, the torques of the motor, and the speed of the point on the floor along and across the wheel.

    The axle looks outward; a wheel that spins forward rolls a quarter turn ahead of it, so about the axle backwards.
    """
    (floor, body, centre), (spin, roll, torque) = frames, speeds
    p = Wheel(*wheel)
    axle, disc, roller = ReferenceFrame(f"F{p.x}"), ReferenceFrame(f"D{p.x}"), ReferenceFrame(f"R{p.x}")
    axle.orient_axis(body, p.axis_angle, body.z)
    axle.set_ang_vel(body, 0)
    disc.orient_axis(axle, 0, axle.x)  # the disc is round: its turn does not show
    disc.set_ang_vel(axle, -spin * axle.x)
    roller.orient_axis(axle, 0, axle.y)
    roller.set_ang_vel(axle, roll * axle.y)
    hub, below = Point(f"H{p.x}"), Point(f"B{p.x}")
    hub.set_pos(centre, p.x * body.x + p.y * body.y)
    hub.v2pt_theory(centre, floor, body)
    below.set_pos(hub, -(p.radius - p.roller_radius) * body.z)
    below.v2pt_theory(hub, floor, body)
    parts = [
        RigidBody(f"disc{p.x}", hub, disc, p.mass, (inertia(axle, p.axial, 0, p.upright), hub)),
        RigidBody(
            f"roller{p.x}", below, roller, p.roller_mass, (inertia(axle, 0, p.roller_axial, p.roller_upright), below)
        ),
    ]
    down = hub.vel(floor) + disc.ang_vel_in(floor).cross(-(p.radius - p.roller_radius) * body.z)
    point = down + (disc.ang_vel_in(floor) + roll * axle.y).cross(-p.roller_radius * body.z)
    drive = -torque * axle.x
    return parts, [(disc, drive), (body, -drive)], (point.dot(axle.y), point.dot(axle.x))


def _names(place: int) -> list[str]:
    return [f"{name}_{place}" for name in Wheel._fields]
