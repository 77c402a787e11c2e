"""What a drive takes: the force along each of a plant's three speeds, by its own equations, whole drives at once.

How this works
--------------
A robot whose wheels grip has three speeds u, and its joints turn at rows u. What the motors must give along them,
    force = mass(parameters) u' + bends(parameters, u) + friction(parameters, rows u),
is linear in the parameters of every plant here. More than three wheels push in more ways than there are speeds: what
they give beyond that only strains the robot, and says nothing of its parameters.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from gateway.arithmetic import sin_cos
from replay.identify.parameters import RobotSection
from replay.sim.plants import mecanum, offset_caster, offset_differential, omni, rigid_body
from replay.sim.plants.contract import PlantName
from replay.sim.plants.offset_equations import OffsetEquations
from replay.sim.plants.offset_parameters import trailing
from replay.sim.plants.omni_equations import OmniEquations
from replay.sim.plants.omni_parameters import parameters as omni_parameters

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """At instants: s, three speeds and their changes (3, n), rates of the joints (motors, n)."""

    times: Array
    speeds: Array
    changes: Array
    rates: Array


Forces = Callable[[RobotSection, Motion], Array]  # of a robot's section of the robot file, (3, n)
_CHASSIS: Mapping[str, Any] = {"omni": omni, "mecanum": mecanum, "offset_differential": offset_differential}


def rows(robot: RobotSection) -> Array:
    """Joint rates = rows @ u, (motors, 3)."""
    return np.array(_CHASSIS[robot.kind].chassis(robot, robot.body).rows)


def radius(robot: RobotSection) -> float:
    """m, of its largest wheel."""
    radii = _CHASSIS[robot.kind].chassis(robot, robot.body).wheel_radii
    return max(float(one) for one in radii if one is not None)


def forces(robot: RobotSection, plant: PlantName) -> Forces:
    """Raises ValueError where there is none, with the reason."""
    found = _FORCES.get((robot.kind, plant))
    if found is None:
        known = ", ".join(f"{kind} ({name.value})" for kind, name in _FORCES)
        raise ValueError(f"kind {robot.kind} on plant {plant.value!r} cannot be identified; there is {known}")
    return found()


def plants_of(kind: str) -> list[PlantName]:
    """Those by which a robot of this kind can be identified."""
    return [name for of, name in _FORCES if of == kind]


def _rigid(robot: RobotSection, motion: Motion) -> Array:
    """The simple plant of every kind; see `rigid_body`."""
    chassis = _CHASSIS[robot.kind].chassis(robot, robot.body)
    spread, body, u = np.array(chassis.rows), robot.body, motion.speeds
    mass = np.array(chassis.mass) + body.joint_inertia * spread.T @ spread
    drag = body.joint_drag * np.tanh(motion.rates / rigid_body.DRAG_SPEED)
    bends = np.array(np.broadcast_arrays(*chassis.gyroscopic(tuple(u))))
    return np.asarray(mass @ motion.changes - bends + spread.T @ (body.joint_friction * spread @ u + drag))


def _offset() -> Forces:
    """With its caster, which is where it was swept to; no parameter changes that."""
    swept: list[tuple[Motion, tuple[Array, Array]]] = []

    def needs(robot: RobotSection, motion: Motion) -> Array:
        equations = OffsetEquations(offset_caster.parameters(cast("Any", robot)))
        if not swept or swept[0][0] is not motion:
            swept[:] = [(motion, _swivel(equations, motion))]
        return _of_offset(equations, robot.body.joint_drag, motion, *swept[0][1])

    return needs


def _of_offset(of: OffsetEquations, drag: float, motion: Motion, s: Array, c: Array) -> Array:
    """See `OffsetEquations`, whose sums and products take arrays."""
    equations: Any = of
    inertial = equations.resistance_to(s, c, tuple(motion.changes))
    against = equations.resistance(s, c, tuple(motion.speeds))
    dry = equations.driven(*(drag * motion.rates / _softened(motion.rates)))
    return np.array([a + b + d for a, b, d in zip(inertial, against, dry, strict=True)])


def _swivel(equations: OffsetEquations, motion: Motion) -> tuple[Array, Array]:
    """Sine and cosine of the caster's swivel at each instant, beginning as behind a robot that was driven forward."""
    beta, before = trailing(pulled=False), float(motion.times[0])
    found = np.empty((2, len(motion.times)))
    for place, (t, *speeds) in enumerate(zip(motion.times, *motion.speeds, strict=True)):
        beta += (t - before) * equations.caster_rates(*sin_cos(beta), cast("Any", speeds))[0]
        before = t
        found[:, place] = sin_cos(beta)
    return found[0], found[1]


def _omni(robot: RobotSection, motion: Motion) -> Array:
    """With its rollers; see `OmniEquations`."""
    equations: Any = OmniEquations(omni_parameters(cast("Any", robot)))
    body, (vx, vy, w) = robot.body, motion.speeds
    inertial = equations.resistance_to(tuple(motion.changes))
    slowing = body.joint_friction + body.joint_drag / _softened(motion.rates)
    against = equations.driven(tuple(slowing * motion.rates))
    return np.array(
        (
            inertial[0] - body.mass * w * vy + against[0],
            inertial[1] + body.mass * w * vx + against[1],
            inertial[2] + against[2],
        )
    )


def _softened(rates: Array) -> Array:
    speed = offset_caster.DRAG_SPEED
    return np.sqrt(speed * speed + rates * rates)


_FORCES: Mapping[tuple[str, PlantName], Callable[[], Forces]] = {
    ("omni", PlantName.SIMPLE): lambda: _rigid,
    ("omni", PlantName.DYNAMICS): lambda: _omni,
    ("mecanum", PlantName.SIMPLE): lambda: _rigid,
    ("offset_differential", PlantName.SIMPLE): lambda: _rigid,
    ("offset_differential", PlantName.DYNAMICS): _offset,
}
