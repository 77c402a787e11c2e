"""What there is to know of an offset-differential robot with its caster: coordinates, parameters and their sets."""

from math import pi
from typing import NamedTuple

LEFT, RIGHT, JOINT, X, Y, PLATFORM, SWIVEL, CASTER = range(8)
DRIVEN = (LEFT, RIGHT, JOINT)  # those with a motor


class OffsetParameters(NamedTuple):
    """Lengths in m, masses in kg, inertias in kg m^2, friction in N m s/rad; names as in science 1.1, 1.2 and 1.5."""

    wheel_radius: float  # R
    axle_offset: float  # d1
    track: float  # d2
    trail: float  # d3
    caster_position: float  # d4
    caster_radius: float  # Rc
    chassis_mass: float
    chassis_offset: float  # x_B, of the centre of mass ahead of the joint
    chassis_inertia: float  # about that centre
    wheel_mass: float
    wheel_axial: float  # about its axle
    wheel_radial: float  # about its vertical
    platform_mass: float
    platform_inertia: float
    fork_mass: float
    fork_share: float  # lambda: where on the trail its centre of mass is
    fork_inertia: float
    caster_mass: float
    caster_axial: float
    caster_radial: float
    friction: tuple[float, ...] = (0.0,) * 8  # viscous, per coordinate
    joint_inertia: float = 0.0  # of the motor of the platform joint, at the joint


def _set(*, radius: float, offset: float, track: float, mass: float, centre: float, inertia: float) -> OffsetParameters:
    """Otbot's wheels and platform, a rod and a disc for the caster: what the sets of science 1.7 have in common."""
    trail, caster_radius, fork, caster = 0.05, 0.05, 0.5, 0.7
    return OffsetParameters(
        wheel_radius=radius,
        axle_offset=offset,
        track=track,
        trail=trail,
        caster_position=0.25,
        caster_radius=caster_radius,
        chassis_mass=mass,
        chassis_offset=centre,
        chassis_inertia=inertia,
        wheel_mass=2.0714,
        wheel_axial=0.010357,
        wheel_radial=0.00561007,
        platform_mass=21.94795,
        platform_inertia=2.22223,
        fork_mass=fork,
        fork_share=0.5,
        fork_inertia=fork * trail * trail / 12.0,
        caster_mass=caster,
        caster_axial=caster * caster_radius * caster_radius / 2.0,
        caster_radial=caster * caster_radius * caster_radius / 4.0,
    )


# Science 1.7. A: as published for Otbot-1; B: its centre of mass fitted; C, D: four and three numbers fitted.
SETS = {
    "A": _set(radius=0.10, offset=0.25, track=0.40, mass=105.0, centre=-0.125, inertia=1.06458),
    "B": _set(radius=0.10, offset=0.25, track=0.40, mass=105.0, centre=-0.086, inertia=1.3),
    "C": _set(radius=0.1016, offset=0.25, track=0.15, mass=105.0, centre=-0.086, inertia=1.3),
    "D": _set(radius=0.1043, offset=0.30, track=0.40, mass=105.0, centre=-0.125, inertia=1.3),
}


def trailing(*, pulled: bool) -> float:
    """The swivel at which the caster comes to rest on a straight way: behind its joint, seen along the motion."""
    return pi / 2.0 if pulled else -pi / 2.0
