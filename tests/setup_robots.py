"""Three robots that are not bundled, as their true robot files, and in the hands of somebody who got them wrong."""

from collections.abc import Mapping, Sequence
from math import pi
from typing import NamedTuple

import tomlkit

ODRIVE = """driver = "odrive"
variant = "0.6"
gear_ratio = {gear}
max_current = 30.0
max_torque = 12.0
max_speed = 30.0
feedback_rate = 250.0
watchdog = {{ timeout = 0.1 }}
options = {{ firmware = "0.6.10", watchdog_enable_endpoint = 188, watchdog_timeout_endpoint = 189 }}
"""
M3508 = """driver = "dji"
variant = "c620"
gear_ratio = 19.203208556149733   # 3591/187
max_current = 20.0
max_torque = 4.5
max_speed = 48.0
feedback_rate = 1000.0
watchdog_waiver = "C620 has no command timeout on CAN; the e-stop relay cuts motor power"
speed_loop = {{ kp = 3.5, ki = 14.0 }}
"""
BODY = """
[robot.body]
mass = {mass}
inertia = {inertia}
joint_friction = 0.02
joint_drag = {drag}
joint_inertia = 0.004
"""
REST = """
[limits]
velocity = {{ vx = 1.0, vy = 1.0, wz = 2.0 }}
acceleration = {{ vx = 1.0, vy = 1.0, wz = 2.0 }}
jerk = {{ vx = 8.0, vy = 8.0, wz = 16.0 }}
motor_speed = {{ {speeds} }}

[[bus]]
name = "can0"
interface = "socketcan"
channel = "can0"
bitrate = 1_000_000

[commands]
source = [{{ name = "teleop", priority = 100, timeout = 0.3 }}]
"""


class Mounted(NamedTuple):
    """One motor as it really is."""

    name: str
    id: int
    direction: int


def _motors(mounted: Sequence[Mounted], kind: str, gear: float) -> str:
    return "".join(
        f'\n[[motor]]\nname = "{name}"\nbus = "can0"\nid = {at}   # as its switch says\n'
        f"direction = {direction}\n{kind.format(gear=gear)}"
        for name, at, direction in mounted
    )


def _file(robot: str, mounted: Sequence[Mounted], kind: str, *, gear: float = 1.0, speed: float = 24.0) -> str:
    speeds = ", ".join(f"{one.name} = {speed}" for one in mounted)
    return f"# Ours, not the maker's.\n{robot}{REST.format(speeds=speeds)}{_motors(mounted, kind, gear)}"


def kiwi() -> str:
    """Three omni wheels, ODrive S1 on a gear of 5 whose stage turns the motors the other way round."""
    wheels = "".join(
        f'\n[[robot.wheel]]\nmotor = "{name}"\nx = {x}\ny = {y}\naxis_angle = {angle}\nradius = 0.05\n'
        for name, x, y, angle in (
            ("front", 0.15, 0.0, 0.0),
            ("rear_left", -0.075, 0.13, 2 * pi / 3),
            ("rear_right", -0.075, -0.13, -2 * pi / 3),
        )
    )
    robot = f'[robot]\nkind = "omni"\nname = "kiwi"\n{BODY.format(mass=9.0, inertia=0.12, drag=0.05)}{wheels}'
    mounted = [Mounted("front", 5, -1), Mounted("rear_left", 2, -1), Mounted("rear_right", 9, -1)]
    return _file(robot, mounted, ODRIVE, gear=5.0)


def mobyish() -> str:
    """Two offset wheels, mounted mirrored, and a platform joint."""
    robot = (
        '[robot]\nkind = "offset_differential"\nname = "mobyish"\nwheel_radius = 0.08\naxle_offset = 0.2\n'
        'track = 0.35\nleft = "left"\nright = "right"\nplatform = "platform"\nchassis_inertia = 0.9\n'
        + BODY.format(mass=40.0, inertia=0.8, drag=0.3)
    )
    mounted = [Mounted("left", 1, -1), Mounted("right", 3, 1), Mounted("platform", 2, -1)]
    return _file(robot, mounted, ODRIVE, gear=12.0, speed=16.0)


def rectangular() -> str:
    """Four mecanum wheels in a rectangle on M3508."""
    wheels = "".join(
        f'\n[[robot.wheel]]\nmotor = "{name}"\nx = {x}\ny = {y}\nroller_angle = {angle}\nradius = 0.0762\n'
        for name, x, y, angle in (
            ("front_left", 0.2, 0.18, -pi / 4),
            ("front_right", 0.2, -0.18, pi / 4),
            ("rear_left", -0.2, 0.18, pi / 4),
            ("rear_right", -0.2, -0.18, -pi / 4),
        )
    )
    robot = f'[robot]\nkind = "mecanum"\nname = "rectangular"\n{BODY.format(mass=20.0, inertia=0.8, drag=0.09)}{wheels}'
    mounted = [
        Mounted("front_left", 1, 1),
        Mounted("front_right", 2, -1),
        Mounted("rear_left", 4, 1),
        Mounted("rear_right", 7, -1),
    ]
    return _file(robot, mounted, M3508)


TRUE = {"kiwi": kiwi, "mobyish": mobyish, "rectangular": rectangular}


def wronged(text: str, ids: Mapping[str, int], directions: Mapping[str, int]) -> str:
    """The same file with other ids and directions by motor."""
    document = tomlkit.parse(text)
    for motor in document["motor"]:
        name = str(motor["name"])
        motor["id"] = ids.get(name, motor["id"])
        motor["direction"] = directions.get(name, motor["direction"])
    return tomlkit.dumps(document)
