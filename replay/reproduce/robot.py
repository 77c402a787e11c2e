"""The robot file of the experiments: the paper's robot with controllers that tell as often as its loop asks."""

from typing import NamedTuple

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import RobotConfig, parse
from replay.reproduce.picture import Shape
from replay.sim.plants.offset_caster import OffsetCaster, parameters, total_mass
from replay.sim.plants.offset_dynamics import OffsetParameters

ORIGIN = "the robot file of the experiment"


class Setup(NamedTuple):
    """What differs between experiments. `gain`: of the compensation; None: none. `torque`: of a wheel's motor, N m."""

    wheel_radius: float
    axle_offset: float
    track: float
    rate: float  # Hz, of the loop and of the motors' feedback
    gain: float | None
    mass: float = 132.29
    chassis_inertia: float = 1.3
    torque: float = 75.0
    region: float = 1.57  # rad; the largest for k = 2


def setup_of(p: OffsetParameters, *, rate: float, gain: float | None, torque: float = 75.0) -> Setup:
    """For a set of science 1.7."""
    return Setup(p.wheel_radius, p.axle_offset, p.track, rate, gain, total_mass(p), p.chassis_inertia, torque)


def shape_of(setup: Setup) -> Shape:
    """To draw it; trail, place and radius of the caster are ours (science 1.7), the paper prints none."""
    return Shape(setup.axle_offset, setup.track, setup.wheel_radius, setup.axle_offset, 0.05, 0.05)


def robot_file(setup: Setup) -> tuple[RobotConfig, str]:
    """The configuration and its text. Its limits leave the commands as the experiments give them."""
    text = _ROBOT.format_map(
        setup._asdict()
        | {
            "compensation": "" if setup.gain is None else _COMPENSATION.format_map(setup._asdict()),
            "motors": "".join(
                _MOTOR.format(name=name, number=number, rate=setup.rate, torque=torque, speed=speed, more=more)
                for number, (name, torque, speed, more) in enumerate(_motors(setup), start=1)
            ),
        }
    )
    return parse(text, ORIGIN), text


def plant_of(config: RobotConfig, *, swivel: float) -> OffsetCaster:
    """All bodies of it; the caster stands at this angle at the start, rad."""
    if not isinstance(config.robot, OffsetDifferentialRobot):
        raise TypeError(f"kind = {config.robot.kind!r}: must be offset_differential")
    return OffsetCaster(parameters(config.robot), swivel=swivel)


def _motors(setup: Setup) -> tuple[tuple[str, float, float, str], ...]:
    wheel = (setup.torque, 40.0, "")
    joint = (150.0, 20.0, 'encoder = "absolute"\n')
    return ("left", *wheel), ("right", *wheel), ("platform", *joint)


_COMPENSATION = """
[robot.compensation]
gain = {gain!r}
region = {region!r}
"""

_MOTOR = """
[[bus]]
name = "can{number}"
interface = "socketcan"
channel = "can{number}"
bitrate = 1_000_000

[[motor]]
name = "{name}"
driver = "odrive"
variant = "0.6"
bus = "can{number}"
id = {number}
gear_ratio = 50.0
direction = 1
max_current = 40.0
max_torque = {torque!r}
max_speed = {speed!r}
feedback_rate = {rate!r}
{more}watchdog = {{ timeout = 0.1 }}
options = {{ firmware = "0.6.10", watchdog_enable_endpoint = 188, watchdog_timeout_endpoint = 189 }}
"""

_ROBOT = """# The offset-differential robot of preprints202312.1327, as one of its experiments is driven here. SI units.

[robot]
kind = "offset_differential"
name = "moby_paper"
wheel_radius = {wheel_radius!r}
axle_offset = {axle_offset!r}
track = {track!r}
left = "left"
right = "right"
platform = "platform"
chassis_inertia = {chassis_inertia!r}
caster = {{ trail = 0.05, position = {axle_offset!r}, radius = 0.05 }}
{compensation}
[robot.body]
mass = {mass!r}
inertia = 2.22223
joint_friction = 0.0
joint_drag = 0.0
joint_inertia = 0.010357

[loop]
rate = {rate!r}

[limits]
velocity = {{ vx = 1.3, vy = 1.3, wz = 1.0 }}
acceleration = {{ vx = 1000.0, vy = 1000.0, wz = 1.0 }}
jerk = {{ vx = 10000.0, vy = 10000.0, wz = 5.0 }}
motor_speed = {{ left = 35.0, right = 35.0, platform = 15.0 }}
{motors}
[commands]
source = [{{ name = "experiment", priority = 1, timeout = 0.1 }}]
"""
