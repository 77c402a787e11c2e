"""The robot file: TOML, everything in SI, unknown keys rejected. What people type is checked here, once."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from gateway.chassis import AnyRobot
from gateway.sections import Limit, Name, NonNegative, Positive, Rate, Section
from gateway.types import PLANAR, Rates, SensorKind, Twist

Bytes = Annotated[int, Field(ge=1_000_000, le=10**13)]
SENSOR_PERIODS = 3  # of a sensor on a bus until it may count as silent
_WORDS = {"missing": "missing", "extra_forbidden": "unknown key"}  # by type of error; the others have good ones
_File = TypeVar("_File", bound=BaseModel)


def _plain(value: object) -> object:
    if isinstance(value, int | float) and -1e15 <= value <= 1e15:
        return value
    if isinstance(value, str) and len(value) <= 256:
        return value
    message = "must be a number from -1e15 to 1e15, a text of at most 256 characters, true or false"
    raise ValueError(message)


def _with_port(endpoint: str) -> str:
    """An endpoint of Zenoh; only its form is looked at here."""
    protocol, _, address = endpoint.partition("/")
    port = re.split("[?#]", address)[0].rpartition(":")[2]
    numbered = port.isascii() and port.isdigit() and int(port) <= 65535
    if not (protocol and address and (numbered or protocol not in _WITH_PORT)):
        message = "must be a protocol and an address, with a port up to 65535: tcp/127.0.0.1:7447"
        raise ValueError(message)
    return endpoint


_WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
Endpoint = Annotated[str, Field(max_length=128), AfterValidator(_with_port)]
Option = Annotated[bool | int | float | str, BeforeValidator(_plain)]


class ConfigError(ValueError):
    """A robot file that must not be driven with; each problem names file, key, value and the allowed range."""

    def __init__(self, origin: str, problems: Iterable[str]) -> None:
        self.origin = origin
        self.problems = tuple(problems)
        super().__init__("\n".join(f"{origin}: {problem}" for problem in self.problems))


class Axes(Section):
    """One number per axis of the body: vx and vy in m, wz in rad (per s, s^2 or s^3); and of what axes it has more.

    Which those are `RobotConfig` asks the chassis.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Limit]

    vx: Limit
    vy: Limit
    wz: Limit

    def as_twist(self) -> Twist:
        """The three numbers in the order of the core."""
        return Twist(self.vx, self.vy, self.wz)

    def as_rates(self, axes: Sequence[str]) -> Rates:
        """Those of these axes, vx, vy and wz first."""
        return (*self.as_twist(), *[self.__pydantic_extra__[axis] for axis in axes[len(PLANAR) :]])


class Loop(Section):
    rate: Annotated[float, Field(ge=10.0, le=1000.0, description="Hz")] = 250.0


class Limits(Section):
    """Limits of the body twist, and of each motor's output (after the gear): rad/s, and, where given, rad/s^2."""

    velocity: Axes
    acceleration: Axes
    jerk: Axes
    motor_speed: dict[Name, Limit]
    motor_acceleration: dict[Name, Limit] | None = None

    def axes(self) -> dict[str, Axes]:
        """The limits of the body by key."""
        return {"velocity": self.velocity, "acceleration": self.acceleration, "jerk": self.jerk}

    def motors_stop(self) -> float:
        """Longest time, s, that a motor needs from its top speed to rest within its own acceleration; 0.0 without."""
        return max(
            (self.motor_speed[name] / most for name, most in (self.motor_acceleration or {}).items()), default=0.0
        )

    def as_stopping(self) -> dict[str, Rates]:
        """What the time and the way to rest follow from."""
        axes = (*PLANAR, *sorted(self.velocity.__pydantic_extra__))
        return {key: limits.as_rates(axes) for key, limits in self.axes().items()}


class Stop(Section):
    """What an emergency stop ends in (IEC 60204-1): category 1 releases the motors at rest, 2 goes on holding them.

    A robot that balances stays upright with both until it is let down; with 0 it is let go at once, and falls.
    """

    category: Literal[0, 1, 2] = 1


class Degraded(Section):
    """What a robot does when it has lost a motor, and with it some way to move; with every way left it drives on.

    `limp`: it drives what is left, at `speed` (share of limits.velocity); `stop`: it comes to rest, as a fault.
    `encoder_lost`: also how the motor turns is not known any more.
    """

    motor_lost: Literal["stop", "limp"] = "stop"
    encoder_lost: Literal["stop", "limp"] = "stop"
    speed: Annotated[float, Field(ge=0.01, le=1.0)] = 0.3


class Watchdog(Section):
    """The controller's own command timeout."""

    timeout: float  # s; what the controller and the loop need is for the driver to say, with the reason


# Options of an ODrive that were keys of `watchdog` in the robot files of recorded sessions: they are still read.
_MOVED_FROM_WATCHDOG = {
    "firmware": "firmware",
    "enable_endpoint": "watchdog_enable_endpoint",
    "timeout_endpoint": "watchdog_timeout_endpoint",
}


class Winding(Section):
    """Of a motor that is told voltages: ohm between its terminals, V s/rad (or N m/A) at its shaft, V that it has.

    The resistance is best taken from the torque-speed line of a data sheet, which has all that is lost on the way.
    """

    resistance: Annotated[float, Field(ge=1e-3, le=100.0, description="ohm")]
    back_emf: Annotated[float, Field(ge=1e-4, le=10.0, description="V s/rad at the motor shaft")]
    voltage: Annotated[float, Field(ge=1.0, le=100.0, description="V")]


class SpeedLoop(Section):
    """Host-side PI speed loop of a motor whose controller takes no speed; gains at the motor's output."""

    kp: Positive  # N m per rad/s
    ki: NonNegative  # N m per rad


class Motor(Section):
    name: Name
    driver: Annotated[str, Field(max_length=32)]
    variant: Annotated[str, Field(max_length=32)]
    bus: Name
    id: Annotated[int, Field(ge=0, le=0x1FFFFFFF)]
    gear_ratio: Annotated[float, Field(ge=0.01, le=1000.0, description="motor turns per output turn")]
    direction: Literal[1, -1]
    max_current: Annotated[float, Field(ge=0.01, le=500.0, description="A")]
    max_torque: Annotated[float, Field(ge=1e-3, le=5000.0, description="N m at the output")]
    max_speed: Annotated[float, Field(ge=1e-3, le=5000.0, description="rad/s at the output; limit set in the device")]
    # Hz; what each controller needs is for its driver to say, with the reason. None: it only replies to commands.
    feedback_rate: float | None = None
    zero: Annotated[float, Field(ge=-1e4, le=1e4, description="rad at the output where the joint is at zero")] = 0.0
    # Only "absolute" (at the output, also after a power cut) lets a steered joint drive without being referenced first.
    encoder: Literal["absolute", "incremental"] = "incremental"
    when_lost: Literal["free", "held"] = "free"  # its joint, without current: a brake or a worm gear holds it
    watchdog: Watchdog | None = None
    watchdog_waiver: Annotated[str, Field(min_length=20, max_length=300)] | None = None
    speed_loop: SpeedLoop | None = None
    winding: Winding | None = None  # of a motor that can be told voltages
    options: dict[Annotated[str, Field(max_length=64)], Option] = Field({}, max_length=32)  # the driver's own

    @model_validator(mode="before")
    @classmethod
    def _as_written_before(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        watchdog, options = given.get("watchdog"), given.get("options", {})
        if not isinstance(watchdog, dict) or not isinstance(options, dict):
            return given
        moved = {new: watchdog[old] for old, new in _MOVED_FROM_WATCHDOG.items() if old in watchdog}
        if not moved or moved.keys() & options.keys():
            return given
        kept = {key: value for key, value in watchdog.items() if key not in _MOVED_FROM_WATCHDOG}
        return given | {"watchdog": kept, "options": options | moved}

    @model_validator(mode="after")
    def _watchdog_or_waiver(self) -> Self:
        if (self.watchdog is None) == (self.watchdog_waiver is None):
            message = "give either watchdog = {...} or watchdog_waiver = 'why this controller has none'"
            raise ValueError(message)
        return self


class Bus(Section):
    name: Name
    interface: Annotated[str, Field(pattern=r"^[a-z0-9_]{1,32}$", description="a python-can interface")]
    channel: Annotated[str, Field(min_length=1, max_length=64)]
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)]
    fd: bool = False  # CAN FD frames pass too
    data_bitrate: Annotated[int, Field(ge=100_000, le=8_000_000)] | None = None  # of CAN FD with a bit rate switch

    @property
    def fd_bitrate(self) -> int:
        """Of the data of a CAN FD frame with a bit rate switch."""
        return self.data_bitrate or self.bitrate

    @model_validator(mode="after")
    def _faster_only_with_fd(self) -> Self:
        if self.data_bitrate is not None and not (self.fd and self.data_bitrate >= self.bitrate):
            message = (
                f"data_bitrate = {self.data_bitrate}: needs fd = true and must be at least bitrate = {self.bitrate}"
            )
            raise ValueError(message)
        return self


class Source(Section):
    """One commander: the highest priority that is not older than its timeout (s) drives."""

    name: Name
    priority: Annotated[int, Field(ge=0, le=255)]
    timeout: Annotated[float, Field(ge=0.02, le=2.0)]


class Sensor(Section):
    """One sensor; older than its timeout (s) its sample is none. By Zenoh, or on the bus that is named.

    On a bus `rate` (Hz) is how often it measures; which ids and kinds there are is for its driver to say.
    """

    name: Name
    kind: SensorKind
    timeout: Annotated[float, Field(ge=0.02, le=2.0)]
    bus: Name | None = None
    driver: Annotated[str, Field(max_length=32)] | None = None
    id: Annotated[int, Field(ge=0, le=0x1FFFFFFF)] | None = None
    rate: Annotated[float, Field(ge=5.0, le=1000.0, description="Hz")] | None = None

    @model_validator(mode="after")
    def _on_a_bus_or_not(self) -> Self:
        given = (self.bus, self.driver, self.id, self.rate)
        if None in given and any(one is not None for one in given):
            message = "give all of bus, driver, id and rate, or none of them for a sensor by Zenoh"
            raise ValueError(message)
        if self.rate is not None and self.timeout * self.rate < SENSOR_PERIODS:
            least = f"{SENSOR_PERIODS} periods of rate = {self.rate:g} Hz, so that a lost frame is survived"
            message = f"timeout = {self.timeout:g}: must be at least {SENSOR_PERIODS / self.rate:.3g}: {least}"
            raise ValueError(message)
        return self


class Commands(Section):
    source: Annotated[list[Source], Field(min_length=1, max_length=32)]


class Zenoh(Section):
    """Loopback only and no scouting unless said otherwise here."""

    listen: list[Endpoint] = Field(default=["tcp/127.0.0.1:7447"])
    connect: list[Endpoint] = Field(default=[])
    multicast_scouting: bool = False
    config_file: Annotated[str, Field(max_length=256)] | None = None  # JSON5 of Zenoh itself: TLS, access control
    odometry_rate: Rate = 50.0
    state_rate: Rate = 10.0
    view_rate: Annotated[float, Field(ge=1.0, le=50.0)] = 20.0  # Hz, of what is sent to those who look on


class Incidents(Section):
    """What is kept of a fault, an emergency stop, a lost motor or a person's mark, each in a file of its own.

    pre, post: s in front of it and behind it. budget: all of this robot's together; the oldest go.
    """

    enabled: bool = True
    pre: Annotated[float, Field(ge=1.0, le=120.0, description="s")] = 20.0
    post: Annotated[float, Field(ge=0.5, le=60.0, description="s")] = 5.0
    budget: Bytes = 500_000_000


class Recording(Section):
    """Where sessions go and how much disk they may take; a relative directory is relative to the working one.

    disk_budget: all sessions of this robot together, the running one included; a segment has at most half of it.
    enabled: of the sessions; incidents are kept without them, too.
    """

    enabled: bool = True
    directory: Annotated[str, Field(min_length=1, max_length=256)] = "sessions"
    segment_seconds: Annotated[float, Field(ge=5.0, le=3600.0)] = 300.0
    segment_bytes: Bytes = 256_000_000
    disk_budget: Bytes = 20_000_000_000
    min_free: Bytes = 500_000_000
    incidents: Incidents = Incidents()


class RobotConfig(Section):
    """The whole robot file."""

    robot: Annotated[AnyRobot, Field(discriminator="kind")]
    loop: Loop = Loop()
    limits: Limits
    stop: Stop = Stop()
    degraded: Degraded = Degraded()
    motor: Annotated[list[Motor], Field(min_length=1, max_length=32)]
    bus: Annotated[list[Bus], Field(min_length=1, max_length=8)]
    commands: Commands
    sensor: list[Sensor] = Field([], max_length=16)
    settings: dict[Name, float] = Field({})  # what `gateway.core.settings` lists, as it is at the start
    zenoh: Zenoh = Zenoh()
    recording: Recording = Recording()

    @model_validator(mode="after")
    def _names_fit_together(self) -> Self:
        problems = [*_duplicates("motor.name", (motor.name for motor in self.motor))]
        problems += _duplicates("bus.name", (bus.name for bus in self.bus))
        problems += _shared_channels(self.bus)
        problems += _duplicates("commands.source.name", (source.name for source in self.commands.source))
        problems += _duplicates("commands.source.priority", (source.priority for source in self.commands.source))
        for key, limits in self.limits.axes().items():
            problems += _other_axes(f"limits.{key}", limits.__pydantic_extra__, self.robot.AXES)
        sources = [source.name for source in self.commands.source]
        problems += _duplicates("sensor.name", [*(sensor.name for sensor in self.sensor), *dict.fromkeys(sources)])
        problems += _second_of_a_kind(self.sensor)
        place, ranges = getattr(self.robot, "width_sensor", None), _of_kind(self.sensor, SensorKind.RANGE)
        if place is not None and place >= len(ranges):
            known = ", ".join(ranges) or "none"
            problems.append(
                f"robot.width_sensor = {place}: no such [[sensor]] of kind 'range'; from 0 on there is {known}"
            )
        problems += _mismatch("robot", self.robot.motor_names(), (motor.name for motor in self.motor))
        problems += _mismatch("limits.motor_speed", self.limits.motor_speed, (motor.name for motor in self.motor))
        if self.limits.motor_acceleration is not None:
            given = self.limits.motor_acceleration
            problems += _mismatch("limits.motor_acceleration", given, (motor.name for motor in self.motor))
        buses = [bus.name for bus in self.bus]
        problems += [
            f"motor {motor.name}: bus = {motor.bus!r}: no such [[bus]]; there is {', '.join(buses)}"
            for motor in self.motor
            if motor.bus not in buses
        ]
        problems += [
            f"sensor {sensor.name}: bus = {sensor.bus!r}: no such [[bus]]; there is {', '.join(buses)}"
            for sensor in self.sensor
            if sensor.bus is not None and sensor.bus not in buses
        ]
        for motor in self.motor:
            speed = self.limits.motor_speed.get(motor.name, 0.0)
            if speed > motor.max_speed:
                allowed = f"allowed up to the motor's max_speed = {motor.max_speed}"
                problems.append(f"limits.motor_speed.{motor.name} = {speed}: {allowed}")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def motors_in_order(self) -> tuple[Motor, ...]:
        """Motors in the order of the chassis (the order of every per-wheel sequence in the core)."""
        by_name = {motor.name: motor for motor in self.motor}
        return tuple(by_name[name] for name in self.robot.motor_names())


def parse(text: str, origin: str) -> RobotConfig:
    """Robot file from its text. Raises ConfigError."""
    return parse_as(RobotConfig, text, origin)


def parse_as(model: type[_File], text: str, origin: str) -> _File:
    """What a person typed, as this model. Raises ConfigError."""
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of more than 4300 digits, and tables without end
        raise ConfigError(origin, [f"not valid TOML: {error}"]) from None
    try:
        return model.model_validate(document)
    except ValidationError as error:
        raise ConfigError(origin, [_problem(item, document) for item in error.errors()]) from None


def load(path: Path) -> tuple[RobotConfig, str]:
    """Robot file and its text. Raises ConfigError."""
    text = read(path)
    return parse(text, str(path)), text


def read(path: Path) -> str:
    """The text of a file that a person wrote. Raises ConfigError."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"cannot be read: {error}"]) from None


def _problem(found: ErrorDetails, document: object) -> str:
    missing = found["type"] == "missing"
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in _typed(found["loc"], document))
    key += f".{found['loc'][-1]}" if missing else ""
    value = found["input"]
    shown = "" if missing or isinstance(value, dict | list) else f" = {value!r}"
    words = _WORDS.get(found["type"], found["msg"].removeprefix("Value error, "))
    return f"{key.lstrip('.')}{shown}: {words}" if key else words


def _typed(location: Iterable[int | str], document: object) -> list[int | str]:
    """Of this location what stands in the file: in between are names of kinds that were tried."""
    kept: list[int | str] = []
    for part in location:
        inside = dict(enumerate(document)) if isinstance(document, list) else document
        if isinstance(inside, dict) and part in inside:
            document = inside[part]
            kept.append(part)
    return kept


def _duplicates(key: str, values: Iterable[object]) -> list[str]:
    seen: set[object] = set()
    doubled = {value for value in values if value in seen or seen.add(value)}  # type: ignore[func-returns-value]
    return [f"{key} = {value!r}: given twice, must be unique" for value in sorted(doubled, key=str)]


def _of_kind(sensors: Iterable[Sensor], kind: SensorKind) -> list[str]:
    return [sensor.name for sensor in sensors if sensor.kind is kind]


def _second_of_a_kind(sensors: Iterable[Sensor]) -> list[str]:
    """Nothing here chooses between two that tell the same of the body; ranges tell of a direction each."""
    first: dict[SensorKind, str] = {}
    return [
        f"sensor {sensor.name}: kind = {sensor.kind.value!r}: {first[sensor.kind]} already tells it; one is allowed"
        for sensor in sensors
        if sensor.kind is not SensorKind.RANGE and first.setdefault(sensor.kind, sensor.name) != sensor.name
    ]


def _shared_channels(buses: Iterable[Bus]) -> list[str]:
    """Two buses on one channel would each claim, filter and send as if they were alone on it."""
    owners: dict[tuple[str, str], str] = {}
    problems = []
    for bus in buses:
        owner = owners.setdefault((bus.interface, bus.channel), bus.name)
        if owner != bus.name:
            channel = f"interface = {bus.interface!r}, channel = {bus.channel!r}"
            problems.append(
                f"bus {bus.name}: {channel}: already the channel of bus {owner}; give both motors one [[bus]]"
            )
    return problems


def _other_axes(key: str, given: Iterable[str], axes: Sequence[str]) -> list[str]:
    """What limits name beyond the twist, against what the chassis has."""
    more = axes[len(PLANAR) :]
    problems = [
        f"{key}.{axis}: no axis of this chassis; it has {', '.join(axes)}" for axis in given if axis not in more
    ]
    return problems + [f"{key}.{axis}: missing, the chassis has this axis" for axis in more if axis not in given]


def _mismatch(key: str, given: Iterable[str], motors: Iterable[str]) -> list[str]:
    names, known = list(given), set(motors)
    problems = _duplicates(key, names)
    problems += [f"{key}: {name!r} is no [[motor]]" for name in names if name not in known]
    return problems + [f"{key}: motor {name!r} is not mentioned" for name in sorted(known - set(names))]
