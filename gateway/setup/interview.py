"""Questions that lead to a robot file, and the file: chassis, body, bus, controllers, limits. Pure.

How this works
--------------
`robot_file` asks one question after the other by calling `ask`, which gets the answer from wherever and checks it by
the question's field. What was answered before decides what is asked, and the defaults. Directions and ids are guesses:
`drivegate setup directions` finds them.
"""

import json
from collections.abc import Callable
from math import pi
from typing import Final, NamedTuple

from gateway.arithmetic import sin_cos
from gateway.chassis.odd import OddRobot
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot, OmniWheel
from gateway.config import Bus, Motor, SpeedLoop, Winding
from gateway.sections import Body
from gateway.setup.fields import Field, Value, choice, field, number, whole, words

BANDWIDTH: Final = 50.0  # rad/s of a speed loop of ours with the robot on its wheels; a fifth of a cycle at 250 Hz
INTEGRATOR: Final = 4.0  # 1/s
SHARE: Final = 0.9  # of max_speed, that limits.motor_speed has
JERK: Final = 8.0  # 1/s, of the acceleration
SOON: Final = 1.0  # s to top speed


class Question(NamedTuple):
    """What is asked. `default` None: there is none."""

    key: str
    words: str
    field: Field
    default: Value | None = None


Ask = Callable[[Question], Value]


class _Axis(NamedTuple):
    """One beyond the twist, with the speed that it usually has, m/s."""

    name: str
    words: str
    usual: float


class _Chassis(NamedTuple):
    """`lines` of [robot]; `wheels`: so many motors drive one; `radius`: of those, m; `more`: axes beyond the twist."""

    lines: list[str]
    motors: tuple[str, ...]
    wheels: int
    radius: float
    more: tuple[_Axis, ...] = ()


class _Controller(NamedTuple):
    """A kind of controller with what its motors usually are; None: that depends on the motor."""

    driver: str
    variant: str
    bitrate: int
    gear_ratio: float | None
    max_current: float | None
    max_torque: float | None
    max_speed: float | None
    feedback_rate: float
    asks: Callable[["_Drafting", "_Controller"], list[str]]


class _Drafting:
    """The answers that later questions need."""

    def __init__(self, ask: Ask) -> None:
        self._ask = ask
        self.inertia = 0.0  # kg m^2 that a wheel feels of the robot

    def text(self, key: str, words: str, of: Field, default: Value | None = None) -> str:
        return str(self._ask(Question(key, words, of, default)))

    def number(self, key: str, words: str, of: Field, default: Value | None = None) -> float:
        return float(self._ask(Question(key, words, of, default)))

    def whole(self, key: str, words: str, of: Field, default: Value | None = None) -> int:
        return int(self._ask(Question(key, words, of, default)))


def robot_file(ask: Ask) -> str:
    """The text of a robot file. `ask` may raise whatever it likes."""
    draft = _Drafting(ask)
    kind = draft.text("robot.kind", "What kind of chassis?", choice(tuple(_CHASSIS)))
    name = draft.text("robot.name", "Its name?", field(OmniRobot, "name"))
    chassis = _CHASSIS[kind](draft)
    body = _body(draft, chassis)
    which = draft.text("motor.controller", "Which motor controllers?", choice(tuple(_CONTROLLERS)))
    controller = _CONTROLLERS[which]
    bus = _bus(draft, controller)
    motors, top = _motors(draft, controller, chassis)
    limits = _limits(draft, chassis, top)
    head = [f"# {name}, as answered to `drivegate setup new`. Everything in SI: m, rad, s, kg, A, V, N m.", ""]
    robot = ["[robot]", f"kind = {_toml(kind)}", f"name = {_toml(name)}", *chassis.lines]
    # Tables within [robot] come after its own keys, so [robot.body] after those of the chassis that are none.
    split = next((at for at, line in enumerate(robot) if line.startswith("[[")), len(robot))
    parts = [*robot[:split], "", *body, "", *robot[split:], *limits, "", *bus, "", *motors, *_COMMANDS]
    return "\n".join([*head, *parts]) + "\n"


_COMMANDS: Final = [
    "[commands]               # of several sources that are not silent the one with the highest priority drives",
    "source = [",
    '  { name = "teleop", priority = 100, timeout = 0.3 },',
    '  { name = "autonomy", priority = 10, timeout = 0.2 },',
    "]",
]


# -- chassis ----------------------------------------------------------------------------------------------------------


def _offset_differential(draft: _Drafting) -> _Chassis:
    model = OffsetDifferentialRobot
    radius = draft.number("robot.wheel_radius", "Radius of the driven wheels, m?", field(model, "wheel_radius"))
    offset = draft.number(
        "robot.axle_offset", "How far is their axle behind the platform joint, m?", field(model, "axle_offset")
    )
    track = draft.number("robot.track", "How far apart are they, m?", field(model, "track"))
    inertia = draft.number(
        "robot.chassis_inertia",
        "Inertia of what carries the platform, about its own vertical, kg m^2?",
        field(model, "chassis_inertia"),
        _short(10.0 * radius * track),
    )
    lines = [
        f"chassis_inertia = {inertia}   # of what carries the platform, about its own vertical",
        f"wheel_radius = {radius}",
        f"axle_offset = {offset}     # axle behind the platform joint",
        f"track = {track}           # between the wheels",
        'left = "left"',
        'right = "right"',
        'platform = "platform"',
    ]
    return _Chassis(lines, ("left", "right", "platform"), 2, radius)


def _omni(draft: _Drafting) -> _Chassis:
    count = draft.whole("robot.wheels", "How many omni wheels, evenly around the centre?", whole(3, 8, "wheels"))
    reach = draft.number("robot.reach", "How far from the centre do they touch the floor, m?", number(0.01, 5.0, "m"))
    radius = draft.number("robot.radius", "Radius of the wheels, m?", field(OmniWheel, "radius"))
    first = draft.number(
        "robot.first_axle",
        "Where is the axle of the first, degrees counter-clockwise from forward?",
        number(-180.0, 180.0, "degrees"),
        180.0 / count,
    )
    lines = []
    for place in range(count):
        angle = (first / 180.0 + 2.0 * place / count) * pi
        angle -= 2.0 * pi * round(angle / (2.0 * pi))
        sine, cosine = sin_cos(angle)
        lines += ["[[robot.wheel]]", f'motor = "wheel_{place + 1}"', f"x = {_place(reach * cosine)}"]
        lines += [
            f"y = {_place(reach * sine)}",
            f"axis_angle = {angle!r}   # of its axle, outward, from forward; turned positively it drives to its left",
            *(f"radius = {radius}", ""),
        ]
    return _Chassis(lines, tuple(f"wheel_{place + 1}" for place in range(count)), count, radius)


def _mecanum(draft: _Drafting) -> _Chassis:
    length = draft.number(
        "robot.wheelbase",
        "From a front to a rear wheel, m?",
        number(0.02, 10.0, "m between where they touch the floor"),
    )
    width = draft.number("robot.track", "From left to right, m?", number(0.02, 10.0, "m, the same"))
    radius = draft.number("robot.radius", "Radius of the wheels, m?", field(OmniWheel, "radius"))
    lines = []
    for name, ahead, left in (
        ("front_left", 0.5, 0.5),
        ("rear_left", -0.5, 0.5),
        ("rear_right", -0.5, -0.5),
        ("front_right", 0.5, -0.5),
    ):
        angle = -pi / 4 if ahead * left > 0.0 else pi / 4
        lines += [
            "[[robot.wheel]]",
            f'motor = "{name}"',
            f"x = {_short(ahead * length)}",
            f"y = {_short(left * width)}",
        ]
        lines += [f"roller_angle = {angle!r}   # of the roller on the floor: on top, from above, they make an X"]
        lines += [f"radius = {radius}", ""]
    return _Chassis(lines, ("front_left", "rear_left", "rear_right", "front_right"), 4, radius)


def _odd(draft: _Drafting) -> _Chassis:
    radius = draft.number("robot.radius", "Radius of the wheels, m?", field(OddRobot, "radius"))
    spacing = draft.number(
        "robot.spacing", "From the middle of one wheel of a pair to the other, m?", field(OddRobot, "spacing")
    )
    least = draft.number(
        "robot.narrowest",
        "From the middle of one pair to the other, m, where they are nearest?",
        number(spacing, 10.0, "m; leave some mm to the stops of the slides"),
    )
    most = draft.number(
        "robot.widest", "And where they are farthest apart, m?", number(least, 10.0, "m; leave some mm to the stops")
    )
    width = draft.number(
        "robot.width",
        "How far apart are they when the service starts, m?",
        number(least, most, "m"),
        _short(0.5 * (least + most)),
    )
    side = draft.text(
        "robot.rollers",
        "The roller on the floor, of the wheel at the far left: from its middle, where does its front end point?",
        choice(("left", "right")),
        "left",
    )
    slant = 0.25 * pi if side == "left" else -0.25 * pi
    angles = ", ".join(repr(sign * slant) for sign in (1.0, -1.0, 1.0, -1.0))
    lines = [
        *(f"radius = {radius}", f"spacing = {spacing}         # of the two wheels of a pair"),
        *(f"narrowest = {least}       # between the middles of the pairs", f"widest = {most}"),
        f"width = {width}          # at the start; the wheels add up from there, unless width_sensor tells it",
        f"roller_angles = [{angles}]   # of the rollers on the floor; on top they lie mirrored",
        'wheels = ["outer_left", "inner_left", "inner_right", "outer_right"]   # from left to right',
        'yields = "width"        # where the wheels cannot turn for all of a command: "width", "motion" or "all"',
        '# width_sensor = 0      # which [[sensor]] of kind "range" tells the width, from 0',
    ]
    motors = ("outer_left", "inner_left", "inner_right", "outer_right")
    rate = _Axis("width_rate", "How fast may the pairs go apart, m/s?", _short(0.5 * (most - least) / SOON))
    return _Chassis(lines, motors, len(motors), radius, (rate,))


_CHASSIS: Final[dict[str, Callable[[_Drafting], _Chassis]]] = {
    "offset_differential": _offset_differential,
    "omni": _omni,
    "mecanum": _mecanum,
    "odd": _odd,
}


def _body(draft: _Drafting, chassis: _Chassis) -> list[str]:
    mass = draft.number("robot.body.mass", "How heavy is the robot, kg?", field(Body, "mass"))
    inertia = draft.number(
        "robot.body.inertia",
        "Its inertia about the vertical, kg m^2?",
        field(Body, "inertia"),
        _short(mass * 0.04),
    )
    draft.inertia = mass * chassis.radius * chassis.radius / chassis.wheels
    drag = _short(0.02 * mass * 9.81 * chassis.radius / chassis.wheels)
    return [
        "[robot.body]             # for the simulated robot, and to find a wheel that slips",
        f"mass = {mass}",
        f"inertia = {inertia}",
        "joint_friction = 0.02",
        f"joint_drag = {drag}        # 2 % of the weight at the wheels",
        f"joint_inertia = {_short(0.1 * draft.inertia)}     # of a wheel with its motor, at the output; a guess",
    ]


# -- bus and controllers ----------------------------------------------------------------------------------------------


def _bus(draft: _Drafting, controller: _Controller) -> list[str]:
    interface = draft.text("bus.interface", "Interface of python-can?", field(Bus, "interface"), "socketcan")
    channel = draft.text("bus.channel", "Channel?", field(Bus, "channel"), "can0")
    bitrate = draft.whole("bus.bitrate", "Bit rate, bit/s?", field(Bus, "bitrate"), controller.bitrate)
    return [
        *("[[bus]]", 'name = "can0"', f"interface = {_toml(interface)}", f"channel = {_toml(channel)}"),
        f"bitrate = {bitrate}         # as in every controller",
    ]


def _motors(draft: _Drafting, controller: _Controller, chassis: _Chassis) -> tuple[list[str], float]:
    """All alike but for name and id; and their top speed, rad/s at the output."""
    ratio = draft.number(
        "motor.gear_ratio", "Motor turns per turn of the wheel?", field(Motor, "gear_ratio"), controller.gear_ratio
    )
    current = draft.number(
        "motor.max_current", "Largest current, A?", field(Motor, "max_current"), controller.max_current
    )
    torque = draft.number(
        "motor.max_torque", "Torque at the wheel with that, N m?", field(Motor, "max_torque"), controller.max_torque
    )
    speed = draft.number(
        "motor.max_speed", "Top speed of the wheel, rad/s?", field(Motor, "max_speed"), controller.max_speed
    )
    rate = draft.number(
        "motor.feedback_rate",
        "How often does the controller report, Hz, as set there?",
        number(10.0, 1000.0, "Hz"),
        controller.feedback_rate,
    )
    common = [
        *(f"gear_ratio = {ratio}", "direction = 1            # `drivegate setup directions` finds it"),
        *(f"max_current = {current}", f"max_torque = {torque}         # at the wheel"),
        *(f"max_speed = {speed}         # rad/s at the wheel", f"feedback_rate = {rate}"),
        *controller.asks(draft, controller),
    ]
    lines = []
    for place, name in enumerate(chassis.motors):
        at = draft.whole(f"motor.{name}.id", f"Id of the controller of {name}?", field(Motor, "id"), place + 1)
        lines += ["[[motor]]", f"name = {_toml(name)}", f"driver = {_toml(controller.driver)}"]
        lines += [f"variant = {_toml(controller.variant)}", 'bus = "can0"', f"id = {at}", *common]
        lines += [f"zero = 0.0              # where {name} stands when it looks ahead"] if name == "platform" else []
        lines += [""]
    return lines, speed


def _waived(draft: _Drafting, why: str) -> str:
    reason = draft.text("motor.watchdog_waiver", "Why have they no command timeout?", words(20, 300), why)
    return f"watchdog_waiver = {_toml(reason)}"


def _odrive_06(draft: _Drafting, _of: _Controller) -> list[str]:
    known = draft.text(
        "motor.watchdog",
        "Do you know the endpoints of exactly their firmware by number? (else `drivegate setup prepare` reads them)",
        choice(("yes", "no")),
        "no",
    )
    if known == "no":
        return [_waived(draft, "not set up yet: `drivegate setup prepare` does, with --endpoints and --watchdog")]
    version = draft.text("motor.options.firmware", "Which version, as 0.6.10?", words(5, 11))
    enable = draft.whole(
        "motor.options.watchdog_enable_endpoint", "Endpoint of enable_watchdog?", whole(1, 65535, "id")
    )
    timeout = draft.whole("motor.options.watchdog_timeout_endpoint", "Of watchdog_timeout?", whole(1, 65535, "id"))
    numbers = f"watchdog_enable_endpoint = {enable}, watchdog_timeout_endpoint = {timeout}"
    return ["watchdog = { timeout = 0.1 }", f"options = {{ firmware = {_toml(version)}, {numbers} }}"]


def _odrive_05(draft: _Drafting, _of: _Controller) -> list[str]:
    return [_waived(draft, "firmware 0.5 cannot be asked over CAN; set over USB, and the e-stop relay cuts the power")]


def _loop(draft: _Drafting) -> str:
    gain = _short(BANDWIDTH * 1.1 * draft.inertia)
    kp = draft.number("motor.speed_loop.kp", "Gain of the speed loop, N m per rad/s?", field(SpeedLoop, "kp"), gain)
    ki = draft.number(
        "motor.speed_loop.ki", "And of its integrator, N m per rad?", field(SpeedLoop, "ki"), _short(INTEGRATOR * kp)
    )
    return f"speed_loop = {{ kp = {kp}, ki = {ki} }}"


def _esc(draft: _Drafting, of: _Controller) -> list[str]:
    return [
        _waived(draft, f"{of.variant} has no command timeout on CAN; the e-stop relay cuts motor power"),
        _loop(draft),
    ]


def _gm6020(draft: _Drafting, of: _Controller) -> list[str]:
    mode = draft.text("motor.options.mode", "Mode as set in DJI's tool?", choice(("voltage", "current")), "voltage")
    lines = [*_esc(draft, of), f"options = {{ mode = {_toml(mode)} }}"]
    if mode == "current":
        return lines
    supply = draft.number("motor.winding.voltage", "Supply, V?", field(Winding, "voltage"), 24.0)
    return [*lines, f"winding = {{ resistance = 8.7, back_emf = 0.741, voltage = {supply} }}"]


def _vesc(draft: _Drafting, _of: _Controller) -> list[str]:
    pairs = draft.whole("motor.options.pole_pairs", "Pole pairs: half of the magnets?", whole(1, 100, "pole pairs"))
    least = draft.whole("motor.options.min_erpm", "Minimum ERPM, as in VESC Tool?", whole(1, 65535, "ERPM"), 900)
    timeout = draft.number("motor.watchdog.timeout", "Command timeout, s, as there?", number(0.05, 1.0, "s"), 0.1)
    return [
        f"watchdog = {{ timeout = {timeout} }}",
        f"options = {{ pole_pairs = {pairs}, min_erpm = {least} }}",
    ]


# What the makers say of their motors, as in the bundled robot files; torques are those that last.
_CONTROLLERS: Final[dict[str, _Controller]] = {
    "odrive-0.6": _Controller("odrive", "0.6", 250_000, None, None, None, None, 100.0, _odrive_06),
    "odrive-0.5": _Controller("odrive", "0.5", 250_000, None, None, None, None, 100.0, _odrive_05),
    "c620": _Controller("dji", "c620", 1_000_000, 3591 / 187, 20.0, 4.5, 48.0, 1000.0, _esc),
    "c610": _Controller("dji", "c610", 1_000_000, 36.0, 10.0, 1.0, 50.0, 1000.0, _esc),
    "gm6020": _Controller("dji", "gm6020", 1_000_000, 1.0, 1.62, 1.2, 26.0, 1000.0, _gm6020),
    "vesc": _Controller("vesc", "vesc", 500_000, None, None, None, None, 50.0, _vesc),
}


# -- limits -----------------------------------------------------------------------------------------------------------


def _limits(draft: _Drafting, chassis: _Chassis, top: float) -> list[str]:
    """Careful ones: half of what one wheel can at most."""
    usual = _short(min(1.0, 0.5 * SHARE * top * chassis.radius))
    linear = draft.number("limits.velocity", "Top speed of the robot, m/s?", number(0.001, 20.0, "m/s"), usual)
    turning = draft.number("limits.turning", "And turning, rad/s?", number(0.001, 50.0, "rad/s"), _short(linear))
    more = {
        axis.name: draft.number(f"limits.{axis.name}", axis.words, number(0.001, 20.0, "m/s"), axis.usual)
        for axis in chassis.more
    }
    lines = ["[limits]"]
    for key, factor, note in (
        ("velocity", 1.0, ""),
        ("acceleration", 1.0 / SOON, "   # to top speed within a second"),
        ("jerk", JERK / SOON, ""),
    ):
        x = _short(factor * linear)
        rates = {"vx": x, "vy": x, "wz": _short(factor * turning)}
        rates |= {axis: _short(factor * rate) for axis, rate in more.items()}
        lines.append(f"{key} = {{ {', '.join(f'{axis} = {rate}' for axis, rate in rates.items())} }}{note}")
    speeds = ", ".join(f"{name} = {_short(SHARE * top)}" for name in chassis.motors)
    return [*lines, f"motor_speed = {{ {speeds} }}   # rad/s at the wheels"]


def _short(value: float) -> float:
    """To four digits, as a person would write it; never 0 for what is not."""
    return float(f"{value:.4g}")


def _place(value: float) -> float:
    """The same of a place, m: what is less than a micrometre is 0."""
    return _short(round(value, 6)) + 0.0  # -0.0 becomes 0.0


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
