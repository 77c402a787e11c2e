"""What there is to know of a robot on omni wheels: masses, inertias and wheels, of a robot file or of the paper.

[A]: Amarasiri, Barhorst and Gottumukkala, ASME Letters in Dynamic Systems and Control 2(4), 040902, 2022.
"""

from math import pi
from typing import NamedTuple

from gateway.chassis.omni import OmniRobot, OmniWheel

INCH = 0.0254  # m
SLUG = 14.593902937206365  # kg
ROLLER_SHARE = 0.4 / 3.0  # radius of a roller in that of its wheel; [A] Table 3
_ROLLER_LENGTH = 3.0  # in radii of the roller; [A] Table 3
_RUBBER = 1522.0  # kg/m^3; [A] Table 4, 0.00171 slug/in^3 (printed beside "aluminium", which the masses contradict)


class WheelParameters(NamedTuple):
    """Contact point (m), angle of the axle from forward (rad), lengths in m, inertias in kg m^2."""

    x: float
    y: float
    axis_angle: float
    radius: float
    spin_inertia: float  # of everything that turns with the wheel, about its axle
    roller_radius: float
    roller_inertia: float  # of the roller on the floor, about its own axle; the others rest


class OmniParameters(NamedTuple):
    """The whole robot; its centre of mass is over the origin of the wheels' places."""

    mass: float  # kg, everything
    inertia: float  # kg m^2 about the vertical, everything
    wheels: tuple[WheelParameters, ...]
    centre_height: float | None = None  # m; None: unknown, no load is shifted
    friction: float = 0.0  # N m s/rad at every wheel
    drag: float = 0.0  # N m of dry friction at every wheel


def parameters(robot: OmniRobot) -> OmniParameters:
    """As the robot file has it. A roller is solid; where the file does not tell its mass, it is of rubber.

    Its proportions are then those of [A]: 2/15 of the wheel's radius and three radii long.
    """
    body = robot.body
    return OmniParameters(
        mass=body.mass,
        inertia=body.inertia,
        wheels=tuple(_wheel(wheel, body.joint_inertia) for wheel in robot.wheel),
        centre_height=body.centre_height,
        friction=body.joint_friction,
        drag=body.joint_drag,
    )


def _wheel(wheel: OmniWheel, spin_inertia: float) -> WheelParameters:
    radius = wheel.radius * ROLLER_SHARE
    mass = wheel.roller_mass
    if mass is None:
        mass = _RUBBER * pi * radius * radius * radius * _ROLLER_LENGTH
    return WheelParameters(
        x=wheel.x,
        y=wheel.y,
        axis_angle=wheel.axis_angle,
        radius=wheel.radius,
        spin_inertia=spin_inertia,
        roller_radius=radius,
        roller_inertia=mass * radius * radius / 2.0,
    )


def kane_robot(lever: float = 8.0 * INCH) -> OmniParameters:
    """The robot of [A] (Tables 1 to 3 as printed, the axes as errata E-004-4 and 5 of science 5 put them), in SI.

    Wheels 1 and 2 roll forward, left and right of the centre; 3 and 4 roll to the left, behind and before it (signs of
    science 4). `lever`: from the centre to the wheels, m; the paper's 8 in are also its width (E-004-9).
    """
    wheel, torus, roller = 0.025257, 0.013697, 0.00100613  # slug
    upright = 0.0781416 + 0.000221784  # slug in^2 about the vertical: torus and roller; the disc's is in `spins`
    spins = ((0.121937, 0.0628245), (0.121937, 0.0628245), (0.117613, 0.0606622), (0.117613, 0.0606622))
    turning = 1.39817
    for _, disc in spins:
        turning += disc + upright
    square_inch = SLUG * INCH * INCH
    carried = SLUG * (wheel + torus + roller)
    poses = ((0.0, lever, -pi / 2.0), (0.0, -lever, -pi / 2.0), (-lever, 0.0, 0.0), (lever, 0.0, 0.0))
    return OmniParameters(
        mass=SLUG * 0.0951426 + 4.0 * carried,
        inertia=square_inch * turning + 4.0 * carried * lever * lever,
        wheels=tuple(
            WheelParameters(
                *pose,
                radius=3.0 * INCH,
                spin_inertia=square_inch * (disc + 0.0946465),
                roller_radius=0.4 * INCH,
                roller_inertia=square_inch * 0.000110892,
            )
            for pose, (disc, _) in zip(poses, spins, strict=True)
        ),
    )
