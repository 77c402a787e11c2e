"""Robots on omni wheels in every layout of the papers and some more: robot files made from that of omni4."""

import re
from math import cos, pi, sin
from typing import NamedTuple

from tests.world import robot_text

RADIUS = 0.0762  # m, of every wheel
ARM = 0.2  # m, from the middle


class Wheel(NamedTuple):
    """Where it stands, m, and the angle of its axle from forward to the left, rad."""

    x: float
    y: float
    axis_angle: float


def ring(*degrees: float, arm: float = ARM) -> tuple[Wheel, ...]:
    """Axles that point outward."""
    return tuple(Wheel(arm * cos(a), arm * sin(a), a) for a in (degree * pi / 180.0 for degree in degrees))


LAYOUTS: dict[str, tuple[Wheel, ...]] = {
    "symmetric": ring(60, 120, 240, 300),  # Rojas: 30 degrees from his x, which points to the right
    "diagonal": ring(45, 135, 225, 315),
    "narrow": ring(81, 99, 261, 279),  # 9 degrees
    "asymmetric": ring(57, 135, 225, 303),  # front 33, rear 45 degrees
    # Seed 004: 1 and 2 roll forward at the left and right, 3 and 4 to the left at the back and front.
    "plus": (Wheel(0.0, ARM, -pi / 2), Wheel(0.0, -ARM, -pi / 2), Wheel(-ARM, 0.0, 0.0), Wheel(ARM, 0.0, 0.0)),
    "three": ring(60, 180, 300),
    "five": ring(36, 108, 180, 252, 324),
    "six": ring(30, 90, 150, 210, 270, 330),
    # Neither on a circle nor pointing outward.
    "odd": (Wheel(0.25, 0.1, 0.9), Wheel(-0.1, 0.22, 2.3), Wheel(-0.2, -0.15, 3.9), Wheel(0.15, -0.2, -0.8)),
}


def text(layout: str, *, rate_hz: float = 250.0) -> str:
    """The robot file."""
    wheels, base = LAYOUTS[layout], robot_text("omni4", rate_hz=rate_hz)
    names = [f"w{place}" for place in range(1, len(wheels) + 1)]
    head, rest = base.split("[[robot.wheel]]", 1)
    middle = "[loop]" + rest.split("[loop]", 1)[1]
    front, *motors = re.split(r"(?=\[\[motor\]\])", middle)
    motor, tail = motors[0], "[commands]" + motors[-1].split("[commands]", 1)[1]
    poses = "".join(
        f'[[robot.wheel]]\nmotor = "{name}"\nx = {x!r}\ny = {y!r}\naxis_angle = {angle!r}\nradius = {RADIUS}\n\n'
        for name, (x, y, angle) in zip(names, wheels, strict=True)
    )
    speeds = ", ".join(f"{name} = 45.0" for name in names)
    front = re.sub(r"motor_speed = \{.*\}", f"motor_speed = {{ {speeds} }}", front)
    every = "".join(
        motor.replace("front_left", name).replace("id = 1", f"id = {place}") for place, name in enumerate(names, 1)
    )
    return head + poses + front + every + tail


def editor(layout: str, *, keys: str = "", rate_hz: float = 250.0) -> str:
    """The same with these lines in its section [robot]."""
    return text(layout, rate_hz=rate_hz).replace('name = "omni4"', f'name = "omni4"\n{keys}', 1)
