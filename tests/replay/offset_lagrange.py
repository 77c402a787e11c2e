"""The dynamics of the offset-differential robot by sympy, from a description of its bodies: an oracle.

How this works
--------------
What is typed here is a drawing in three dimensions: where each body is, how it is turned, what it weighs. Velocities
and angular velocities are derivatives of those, the kinetic energy follows, and from it Lagrange's equations. Wheels
roll because the material point of each that touches the floor stands still: two equations per contact, six in all, of
which one says nothing new (an axle has one sideways speed), and six forces that the floor exerts there. No equation of
any text is copied, so no sign of one is; numbers are put in last.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from replay.sim.plants.offset_dynamics import OffsetParameters

Array = NDArray[np.float64]
COORDINATES = sp.symbols("left right joint x y platform swivel caster", real=True)
RATES = sp.symbols("left_ right_ joint_ x_ y_ platform_ swivel_ caster_", real=True)
PARAMETERS = {name: sp.Symbol(name, positive=True) for name in OffsetParameters._fields if name != "friction"}


class Body(NamedTuple):
    """Centre (3) and orientation (3 x 3) in the world; inertia about the centre in the body's own axes (3 x 3)."""

    mass: sp.Expr
    centre: sp.Matrix
    orientation: sp.Matrix
    inertia: sp.Matrix


class Derived(NamedTuple):
    """By the names of Lagrange's equations M q'' + c = Q + A' lambda, A q' = 0, A q'' + drift = 0; symbols.

    `joint`, `caster_joint`: how the places where somebody may push move (3 x 8).
    """

    mass: sp.Matrix
    inertial: sp.Matrix
    contacts: sp.Matrix
    drift: sp.Matrix
    joint: sp.Matrix
    caster_joint: sp.Matrix


def bodies() -> tuple[list[Body], list[tuple[Body, sp.Expr]], dict[str, sp.Matrix]]:
    """All six; those that roll, with their radii; the places of the two joints that can be pushed."""
    p = PARAMETERS
    left, right, joint, x, y, platform, swivel, caster = COORDINATES
    upright = _about(2, platform - joint)
    pivot = sp.Matrix([x, y, 0])
    # The fork looks along its axle; the wheel trails a quarter turn to the right of that.
    fork = upright * _about(2, swivel)
    hinge = pivot + upright * sp.Matrix([p["caster_position"], 0, 0])

    wheels = [
        Body(
            p["wheel_mass"],
            pivot + upright * sp.Matrix([-p["axle_offset"], side * p["track"] / 2, 0]),
            upright * _about(1, spin),
            sp.diag(p["wheel_radial"], p["wheel_axial"], p["wheel_radial"]),
        )
        for side, spin in ((1, left), (-1, right))
    ]
    castor = Body(
        p["caster_mass"],
        hinge + fork * sp.Matrix([0, -p["trail"], 0]),
        fork * _about(0, caster),
        sp.diag(p["caster_axial"], p["caster_radial"], p["caster_radial"]),
    )
    others = [
        Body(
            p["chassis_mass"],
            pivot + upright * sp.Matrix([p["chassis_offset"], 0, 0]),
            upright,
            sp.diag(0, 0, p["chassis_inertia"]),  # what only turns about the vertical has no other inertia that counts
        ),
        Body(p["platform_mass"], pivot, _about(2, platform), sp.diag(0, 0, p["platform_inertia"])),
        Body(
            p["fork_mass"],
            hinge + fork * sp.Matrix([0, -p["fork_share"] * p["trail"], 0]),
            fork,
            sp.diag(0, 0, p["fork_inertia"]),
        ),
    ]
    rolling = [(wheel, p["wheel_radius"]) for wheel in wheels] + [(castor, p["caster_radius"])]
    return [*others, *wheels, castor], rolling, {"joint": pivot, "caster_joint": hinge}


@cache
def derived() -> Derived:
    """Lagrange's equations of the bodies, and the contacts."""
    every, rolling, places = bodies()
    energy = sp.Add(*map(_energy, every))
    slopes = sp.Matrix([energy]).jacobian(RATES)
    inertial = slopes.jacobian(COORDINATES) * sp.Matrix(RATES) - sp.Matrix([energy]).jacobian(COORDINATES).T
    slip = sp.Matrix.vstack(*[_touching(body, radius)[:2, :] for body, radius in rolling])
    contacts = slip.jacobian(RATES)
    drift = slip.jacobian(COORDINATES) * sp.Matrix(RATES)
    pushed = [places[name].jacobian(COORDINATES) for name in ("joint", "caster_joint")]
    return Derived(slopes.jacobian(RATES), inertial, contacts, drift, *pushed)


class LagrangeRobot:
    """The derived equations with the numbers of one robot."""

    def __init__(self, parameters: OffsetParameters) -> None:
        self._friction = np.array(parameters.friction)
        self._numbers = parameters._asdict()
        del self._numbers["friction"]

    def terms(self, q: Array, rates: Array) -> list[Array]:
        """In the order of `Derived`."""
        return [np.array(term, dtype=float) for term in _numeric()(*q, *rates, **self._numbers)]

    def accelerations(self, q: Array, rates: Array, torques: Array, pushes: tuple[Array, Array]) -> tuple[Array, Array]:
        """q'' (8), and what the floor does at the three contacts, N (3, 2).

        `torques`: of left wheel, right wheel and joint; `pushes`: N along the floor at the joint and the caster's.
        """
        mass, inertial, contacts, drift, joint, caster_joint = self.terms(q, rates)
        applied = joint[:2].T @ pushes[0] + caster_joint[:2].T @ pushes[1] - self._friction * rates
        applied[:3] += torques
        system = np.block([[mass, -contacts.T], [contacts, np.zeros((6, 6))]])
        given = np.concatenate([applied - inertial.ravel(), -drift.ravel()])
        solved = np.asarray(np.linalg.lstsq(system, given, rcond=1e-12)[0], dtype=np.float64)
        return solved[:8], solved[8:].reshape(3, 2)

    def inverse(self, q: Array, rates: Array, accelerations: Array) -> tuple[Array, Array]:
        """Motor torques (3) for these coordinate accelerations, and what the floor does at the contacts, N (3, 2)."""
        mass, inertial, contacts, *_ = self.terms(q, rates)
        needed = mass @ accelerations + inertial.ravel() + self._friction * rates
        system = np.hstack([np.eye(8)[:, :3], contacts.T])
        solved = np.asarray(np.linalg.lstsq(system, needed, rcond=1e-12)[0], dtype=np.float64)
        return solved[:3], solved[3:].reshape(3, 2)


@cache
def _numeric() -> Callable[..., Any]:
    symbols = [*COORDINATES, *RATES, *PARAMETERS.values()]
    found: Callable[..., Any] = sp.lambdify(symbols, list(derived()), modules="numpy", cse=True)
    return found


def _about(axis: int, angle: sp.Expr) -> sp.Matrix:
    """Rotation by the right hand."""
    return (sp.rot_axis1, sp.rot_axis2, sp.rot_axis3)[axis](-angle)


def _rate(of: sp.Matrix) -> sp.Matrix:
    """d/dt."""
    return sum((of.diff(one) * rate for one, rate in zip(COORDINATES, RATES, strict=True)), sp.zeros(*of.shape))


def _spin(body: Body) -> sp.Matrix:
    """Angular velocity in the body's axes, from the rotation itself: R' R_ is the cross product with it."""
    cross = body.orientation.T * _rate(body.orientation)
    return sp.Matrix([cross[2, 1], cross[0, 2], cross[1, 0]])


def _energy(body: Body) -> sp.Expr:
    velocity, spin = _rate(body.centre), _spin(body)
    return (body.mass * velocity.dot(velocity) + (spin.T * body.inertia * spin)[0]) / 2


def _touching(body: Body, radius: sp.Expr) -> sp.Matrix:
    """Velocity of the material point at the floor, straight below the centre."""
    spin = body.orientation * _spin(body)
    return _rate(body.centre) + spin.cross(sp.Matrix([0, 0, -radius]))
