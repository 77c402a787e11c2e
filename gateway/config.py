"""The robot file: TOML, everything in SI, unknown keys rejected. What people type is checked here, once."""

import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from gateway import file_keys
from gateway.chassis import AnyRobot
from gateway.errors import EXIT_CONFIG, UserError
from gateway.guess import guess
from gateway.sections import Form, Limit, Name, NonNegative, Positive, Rate, Section, Unit
from gateway.types import CHOSEN_GROWTH, PLANAR, Growth, Rates, SensorKind, Twist

Variance = Annotated[float, Field(ge=1e-10, le=1.0)]
Bytes = Annotated[int, Field(ge=1_000_000, le=10**13), Unit("bytes")]
_INTERFACE_NAME = r"(?!\.{1,2}$)[^\s/:]{1,15}"  # dev_valid_name of the kernel (net/core/dev.c)
SENSOR_PERIODS = 3  # of a sensor on a bus until it may count as silent
_File = TypeVar("_File", bound=BaseModel)


def _plain(value: object) -> object:
    if isinstance(value, int | float) and -1e15 <= value <= 1e15:
        return value
    if isinstance(value, str) and len(value) <= 256:
        return value
    message = "must be a number from -1e15 to 1e15, a text of at most 256 characters, true or false"
    raise ValueError(message)


def with_port(endpoint: str) -> str:
    """An endpoint of Zenoh, of which only the form is looked at here. Raises ValueError."""
    protocol, _, address = endpoint.partition("/")
    port = re.split("[?#]", address)[0].rpartition(":")[2]
    numbered = port.isascii() and port.isdigit() and int(port) <= 65535
    if not (protocol and address and (numbered or protocol not in _WITH_PORT)):
        message = "must be a protocol and an address, with a port up to 65535: tcp/127.0.0.1:7447"
        raise ValueError(message)
    return endpoint


_WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
Endpoint = Annotated[
    str, Field(max_length=128), AfterValidator(with_port), Form("a Zenoh endpoint such as tcp/127.0.0.1:7447")
]
Option = Annotated[bool | int | float | str, BeforeValidator(_plain)]


class ConfigError(UserError, ValueError):
    """A robot file that must not be driven with; each problem names file, key, value and the allowed range."""

    exit_code = EXIT_CONFIG

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

    vx: Annotated[Limit, Field(description="forward: m/s, of the acceleration m/s^2, of the jerk m/s^3")]
    vy: Annotated[Limit, Field(description="to the left, likewise")]
    wz: Annotated[Limit, Field(description="turning: rad/s, rad/s^2, rad/s^3")]

    def as_twist(self) -> Twist:
        """The three numbers in the order of the core."""
        return Twist(self.vx, self.vy, self.wz)

    def named(self) -> tuple[str, ...]:
        """Its axes, vx, vy and wz first."""
        return (*PLANAR, *sorted(self.__pydantic_extra__))

    def as_rates(self, axes: Sequence[str]) -> Rates:
        """Those of these axes, vx, vy and wz first."""
        return (*self.as_twist(), *[self.__pydantic_extra__[axis] for axis in axes[len(PLANAR) :]])


class Loop(Section):
    rate: Annotated[
        float,
        Field(
            ge=10.0, le=1000.0, description="cycles: how often motors are heard and told; a faster one loads the bus"
        ),
        Unit("Hz"),
    ] = 250.0


class Limits(Section):
    """Limits of the body twist, and of each motor's output (after the gear): rad/s, and, where given, rad/s^2."""

    velocity: Annotated[Axes, Field(description="of the body; vx, vy in m/s, wz in rad/s, and a chassis's own axes")]
    acceleration: Annotated[Axes, Field(description="of the body over the ground, in m/s^2 and rad/s^2")]
    jerk: Annotated[Axes, Field(description="of the body, in m/s^3 and rad/s^3: how softly it begins to accelerate")]
    motor_speed: Annotated[
        dict[Name, Limit],
        Field(description="of each motor's output (after the gear); at most its max_speed, which is set in the device"),
        Unit("rad/s"),
    ]
    motor_acceleration: Annotated[
        dict[Name, Limit] | None,
        Field(description="of each motor's output; the robot slows down before what needs more; left out: no limit"),
        Unit("rad/s^2"),
    ] = None

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
        axes = self.velocity.named()
        return {key: limits.as_rates(axes) for key, limits in self.axes().items()}


class Stop(Section):
    """What an emergency stop ends in (IEC 60204-1): category 1 releases the motors at rest, 2 goes on holding them.

    A robot that balances stays upright with both until it is let down; with 0 it is let go at once, and falls.
    """

    category: Annotated[
        Literal[0, 1, 2],
        Field(description="an emergency stop ends released (1) or held (2); 0: let go at once, if it balances"),
    ] = 1


class Degraded(Section):
    """What a robot does when it has lost a motor, and with it some way to move; with every way left it drives on.

    `limp`: it drives what is left, at `speed` (share of limits.velocity); `stop`: it comes to rest, as a fault.
    `encoder_lost`: also how the motor turns is not known any more.
    """

    motor_lost: Annotated[
        Literal["stop", "limp"], Field(description="without a motor and a way to move: rest, or drive what is left")
    ] = "stop"
    encoder_lost: Annotated[
        Literal["stop", "limp"], Field(description="the same where also how that motor turns is not known any more")
    ] = "stop"
    speed: Annotated[float, Field(ge=0.01, le=1.0, description="at which it limps"), Unit("of limits.velocity")] = 0.3


class Watchdog(Section):
    """The controller's own command timeout."""

    # What the controller and the loop need is for the driver to say, with the reason.
    timeout: Annotated[
        float,
        Field(description="without a command for so long the controller stops by itself; see its driver"),
        Unit("s"),
    ]


# Options of an ODrive that were keys of `watchdog` in the robot files of recorded sessions: they are still read.
MOVED_FROM_WATCHDOG = {
    "firmware": "firmware",
    "enable_endpoint": "watchdog_enable_endpoint",
    "timeout_endpoint": "watchdog_timeout_endpoint",
}


class Winding(Section):
    """Of a motor that is told voltages: ohm between its terminals, V s/rad (or N m/A) at its shaft, V that it has.

    The resistance is best taken from the torque-speed line of a data sheet, which has all that is lost on the way.
    """

    resistance: Annotated[float, Field(ge=1e-3, le=100.0, description="between its terminals"), Unit("ohm")]
    back_emf: Annotated[
        float, Field(ge=1e-4, le=10.0, description="at the motor shaft; the same number as its N m/A"), Unit("V s/rad")
    ]
    voltage: Annotated[float, Field(ge=1.0, le=100.0, description="of the supply"), Unit("V")]


class SpeedLoop(Section):
    """Host-side PI speed loop of a motor whose controller takes no speed; gains at the motor's output."""

    kp: Annotated[Positive, Field(description="proportional gain; too much swings"), Unit("N m per rad/s")]
    ki: Annotated[NonNegative, Field(description="integral gain"), Unit("N m per rad")]


class Motor(Section):
    name: Annotated[Name, Field(description="by which [robot] and [limits] call it")]
    driver: Annotated[str, Field(max_length=32, description="protocol of its controller")]
    variant: Annotated[str, Field(max_length=32, description="which controller or firmware line of that protocol")]
    bus: Annotated[Name, Field(description="name of its [[bus]]")]
    id: Annotated[int, Field(ge=0, le=0x1FFFFFFF, description="as set in the controller; its driver knows the range")]
    gear_ratio: Annotated[
        float, Field(ge=0.01, le=1000.0, description="of its gearbox"), Unit("motor turns per output turn")
    ]
    direction: Annotated[
        Literal[1, -1], Field(description="-1 where the motor is mounted mirrored, so that it turns the other way")
    ]
    max_current: Annotated[float, Field(ge=0.01, le=500.0, description="of the motor"), Unit("A")]
    max_torque: Annotated[float, Field(ge=1e-3, le=5000.0, description="at the output"), Unit("N m")]
    max_speed: Annotated[
        float, Field(ge=1e-3, le=5000.0, description="at the output; limit set in the device"), Unit("rad/s")
    ]
    # What each controller needs is for its driver to say, with the reason.
    feedback_rate: Annotated[
        float | None,
        Field(description="how often the controller is set to report; its driver knows the range; left out: replies"),
        Unit("Hz"),
    ] = None
    zero: Annotated[
        float, Field(ge=-1e4, le=1e4, description="angle of the output at which the joint is at zero"), Unit("rad")
    ] = 0.0
    encoder: Annotated[
        Literal["absolute", "incremental"],
        Field(
            description="only one that is absolute at the output, also after a power cut, lets a steered joint drive "
            "without being referenced"
        ),
    ] = "incremental"
    when_lost: Annotated[
        Literal["free", "held"], Field(description="its joint without current: held by a brake or a worm gear, or free")
    ] = "free"
    watchdog: Annotated[
        Watchdog | None, Field(description="the controller's own command timeout; it or watchdog_waiver is needed")
    ] = None
    watchdog_waiver: Annotated[
        Annotated[str, Field(min_length=20, max_length=300)] | None,
        Field(description="why the controller has no watchdog, and what stops it instead"),
    ] = None
    speed_loop: Annotated[
        SpeedLoop | None, Field(description="on the host, exactly where the controller takes no speed")
    ] = None
    winding: Annotated[Winding | None, Field(description="of a motor that is told voltages")] = None
    options: Annotated[
        dict[Annotated[str, Field(max_length=64)], Option],
        Field(max_length=32, description="what only this driver asks for; it says which there are"),
    ] = Field({})

    @model_validator(mode="before")
    @classmethod
    def _as_written_before(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        watchdog, options = given.get("watchdog"), given.get("options", {})
        if not isinstance(watchdog, dict) or not isinstance(options, dict):
            return given
        moved = {new: watchdog[old] for old, new in MOVED_FROM_WATCHDOG.items() if old in watchdog}
        if not moved or moved.keys() & options.keys():
            return given
        kept = {key: value for key, value in watchdog.items() if key not in MOVED_FROM_WATCHDOG}
        return given | {"watchdog": kept, "options": options | moved}

    @model_validator(mode="after")
    def _watchdog_or_waiver(self) -> Self:
        if (self.watchdog is None) == (self.watchdog_waiver is None):
            message = "give either watchdog = {...} or watchdog_waiver = 'why this controller has none'"
            raise ValueError(message)
        return self


class Bus(Section):
    name: Annotated[Name, Field(description="by which motors and sensors call it")]
    interface: Annotated[
        str,
        Field(pattern=r"^[a-z0-9_]{1,32}$", description="of python-can: socketcan on Linux"),
        Form("a python-can interface: lower case letters, digits and _, at most 32 of them"),
    ]
    channel: Annotated[
        str, Field(min_length=1, max_length=64, description="as the interface calls it: can0, vcan0 of socketcan")
    ]
    bitrate: Annotated[
        int, Field(ge=10_000, le=1_000_000, description="that every controller on it is set to"), Unit("bit/s")
    ]
    fd: Annotated[bool, Field(description="CAN FD frames pass too")] = False
    data_bitrate: Annotated[
        Annotated[int, Field(ge=100_000, le=8_000_000)] | None,
        Field(description="of CAN FD frames with a bit rate switch; left out: bitrate"),
        Unit("bit/s"),
    ] = None

    @property
    def fd_bitrate(self) -> int:
        """Of the data of a CAN FD frame with a bit rate switch."""
        return self.data_bitrate or self.bitrate

    @model_validator(mode="after")
    def _channel_that_can_be(self) -> Self:
        if self.interface == "socketcan" and not re.fullmatch(_INTERFACE_NAME, self.channel):
            message = (
                f"channel = {self.channel!r}: must be the name of a network interface: at most 15 characters, no "
                "blank, / or colon: can0"
            )
            raise ValueError(message)
        return self

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

    name: Annotated[Name, Field(description="under which it commands: the last part of its Zenoh key")]
    priority: Annotated[int, Field(ge=0, le=255, description="the highest that is not silent drives")]
    timeout: Annotated[float, Field(ge=0.02, le=2.0, description="after which it counts as silent"), Unit("s")]


class Sensor(Section):
    """One sensor; older than its timeout (s) its sample is none. By Zenoh, or on the bus that is named.

    On a bus `rate` (Hz) is how often it measures; which ids and kinds there are is for its driver to say.
    """

    name: Annotated[Name, Field(description="the last part of its Zenoh key, and in the state")]
    kind: Annotated[SensorKind, Field(description="what it tells; at most one heading and one attitude")]
    timeout: Annotated[float, Field(ge=0.02, le=2.0, description="after which its sample is none"), Unit("s")]
    bus: Annotated[Name | None, Field(description="name of its [[bus]]; left out: by Zenoh")] = None
    driver: Annotated[
        Annotated[str, Field(max_length=32)] | None, Field(description="of one on a bus: which frames it sends")
    ] = None
    id: Annotated[
        Annotated[int, Field(ge=0, le=0x1FFFFFFF)] | None, Field(description="of one on a bus: of its first frame")
    ] = None
    rate: Annotated[
        Annotated[float, Field(ge=5.0, le=1000.0)] | None,
        Field(description="of one on a bus: how often it measures; its timeout is at least three of them"),
        Unit("Hz"),
    ] = None

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
    source: Annotated[list[Source], Field(min_length=1, max_length=32, description="who may command")]


class OdometryGrowth(Section):
    """How far wheels may be trusted: variances by which the covariance of the odometry grows; measured, or chosen."""

    variance_per_metre: Annotated[
        Variance, Field(description="of the position, along each axis, by a metre driven"), Unit("m^2/m")
    ] = CHOSEN_GROWTH.position
    heading_variance_per_radian: Annotated[
        Variance, Field(description="of the heading, by a radian turned"), Unit("rad^2/rad")
    ] = CHOSEN_GROWTH.heading_turning
    heading_variance_per_metre: Annotated[
        Variance, Field(description="of the heading, by a metre driven"), Unit("rad^2/m")
    ] = CHOSEN_GROWTH.heading_driving

    def growth(self) -> Growth:
        """The three numbers as the core has them."""
        return Growth(self.variance_per_metre, self.heading_variance_per_radian, self.heading_variance_per_metre)


class Zenoh(Section):
    """Loopback only and no scouting unless said otherwise here."""

    listen: Annotated[list[Endpoint], Field(description="where clients find the robot")] = Field(
        default=["tcp/127.0.0.1:7447"]
    )
    connect: Annotated[list[Endpoint], Field(description="routers and peers that it looks for")] = Field(default=[])
    multicast_scouting: Annotated[bool, Field(description="lets itself be found in the local network")] = False
    config_file: Annotated[
        Annotated[str, Field(max_length=256)] | None, Field(description="JSON5 of Zenoh itself: TLS, access control")
    ] = None
    odometry_rate: Annotated[Rate, Field(description="of <robot>/odometry")] = 50.0
    state_rate: Annotated[Rate, Field(description="of <robot>/state")] = 10.0
    view_rate: Annotated[
        float, Field(ge=1.0, le=50.0, description="of <robot>/view, what is drawn for those who look on"), Unit("Hz")
    ] = 20.0


class Incidents(Section):
    """What is kept of a fault, an emergency stop, a lost motor or a person's mark, each in a file of its own."""

    enabled: Annotated[bool, Field(description="keeps them, also where no session is recorded")] = True
    pre: Annotated[float, Field(ge=1.0, le=120.0, description="kept in front of it"), Unit("s")] = 20.0
    post: Annotated[float, Field(ge=0.5, le=60.0, description="kept behind it"), Unit("s")] = 5.0
    budget: Annotated[Bytes, Field(description="of all of this robot's together; the oldest are deleted")] = 500_000_000


class Recording(Section):
    """Where sessions go and how much disk they may take; a relative directory is relative to the working one.

    disk_budget: all sessions of this robot together, the running one included; a segment has at most half of it.
    enabled: of the sessions; incidents are kept without them, too.
    """

    enabled: Annotated[bool, Field(description="records every cycle; incidents are kept without, too")] = True
    directory: Annotated[
        str,
        Field(min_length=1, max_length=256, description="for sessions; a relative one is relative to the working one"),
    ] = "sessions"
    segment_seconds: Annotated[
        float, Field(ge=5.0, le=3600.0, description="after which a new file of the session is begun"), Unit("s")
    ] = 300.0
    segment_bytes: Annotated[Bytes, Field(description="after which a new file of the session is begun")] = 256_000_000
    disk_budget: Annotated[
        Bytes, Field(description="of all sessions of this robot together; the oldest are deleted")
    ] = 20_000_000_000
    min_free: Annotated[Bytes, Field(description="on the disk, below which nothing is recorded")] = 500_000_000
    incidents: Annotated[Incidents, Field(description="what is kept of faults, stops and marks")] = Incidents()


class RobotConfig(Section):
    """The whole robot file."""

    robot: Annotated[AnyRobot, Field(discriminator="kind", description="name, kind and geometry")]
    loop: Annotated[Loop, Field(description="the control loop")] = Loop()
    limits: Annotated[Limits, Field(description="of the body, and of each motor")]
    stop: Annotated[Stop, Field(description="emergency stops")] = Stop()
    degraded: Annotated[Degraded, Field(description="what it does when it has lost a motor, and a way to move")] = (
        Degraded()
    )
    motor: Annotated[list[Motor], Field(min_length=1, max_length=32, description="a table for each motor")]
    bus: Annotated[list[Bus], Field(min_length=1, max_length=8, description="a table for each CAN interface")]
    commands: Annotated[Commands, Field(description="who may command")]
    sensor: Annotated[list[Sensor], Field(max_length=16, description="a table for each sensor")] = Field([])
    odometry: Annotated[OdometryGrowth, Field(description="how far the wheels may be trusted")] = OdometryGrowth()
    settings: Annotated[
        dict[Name, float], Field(description="what `drivegate set` may change, as it is at the start")
    ] = Field({})
    zenoh: Annotated[Zenoh, Field(description="where and how the robot is commanded; on loopback unless told")] = (
        Zenoh()
    )
    recording: Annotated[Recording, Field(description="where sessions go, and how much disk they may take")] = (
        Recording()
    )

    @model_validator(mode="after")
    def _names_fit_together(self) -> Self:
        problems = _misfits(parts_of(self))
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def motors_in_order(self) -> tuple[Motor, ...]:
        """Motors in the order of the chassis (the order of every per-wheel sequence in the core)."""
        by_name = {motor.name: motor for motor in self.motor}
        return tuple(by_name[name] for name in self.robot.motor_names())


class Named(NamedTuple):
    """The tables of one list. `names`: of all, None where one has none; `sound`: those that are as they must be."""

    names: tuple[str, ...] | None
    sound: tuple[Any, ...]

    @property
    def whole(self) -> bool:
        """Whether every one is sound."""
        return self.names is not None and len(self.names) == len(self.sound)


class Parts(NamedTuple):
    """The tables of a robot file that are as they must be, each by itself; None: this one is not."""

    robot: AnyRobot | None
    loop: Loop | None
    limits: Limits | None
    motors: Named
    buses: Named
    sources: Named
    sensors: Named
    settings: dict[str, float] | None


class Survey(NamedTuple):
    """All that is wrong with a robot file as far as it can be said without building the robot; what is sound of it."""

    config: RobotConfig | None  # None: there are problems
    problems: tuple[str, ...]
    parts: Parts


def parts_of(config: RobotConfig) -> Parts:
    """Of a file whose tables are all sound."""
    return Parts(
        robot=config.robot,
        loop=config.loop,
        limits=config.limits,
        motors=_named(config.motor),
        buses=_named(config.bus),
        sources=_named(config.commands.source),
        sensors=_named(config.sensor),
        settings=config.settings,
    )


def parse(text: str, origin: str) -> RobotConfig:
    """Robot file from its text. Raises ConfigError."""
    found = survey(text, origin)
    if found.config is None:
        raise ConfigError(origin, found.problems)
    return found.config


def survey(text: str, origin: str) -> Survey:
    """Robot file from its text, with everything that is wrong with it. Raises ConfigError for what is no TOML."""
    document = document_of(text, origin)
    try:
        config = RobotConfig.model_validate(document)
    except ValidationError as error:
        wrong = [item for item in error.errors() if item["loc"]]  # without a place it is what `_misfits` says anyway
        parts = _sound_parts(document, {(item["loc"][:2]) for item in wrong})
        problems = [file_keys.problem(item, document, RobotConfig) for item in wrong] + _misfits(parts)
        return Survey(None, tuple(problems), parts)
    return Survey(config, (), parts_of(config))


def parse_as(model: type[_File], text: str, origin: str) -> _File:
    """What a person typed, as this model. Raises ConfigError."""
    document = document_of(text, origin)
    try:
        return model.model_validate(document)
    except ValidationError as error:
        raise ConfigError(origin, [file_keys.problem(item, document, model) for item in error.errors()]) from None


def document_of(text: str, origin: str) -> dict[str, Any]:
    """What a person typed, as it stands there. Raises ConfigError for what is no TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of more than 4300 digits, and tables without end
        raise ConfigError(origin, [f"not valid TOML: {error}"]) from None


def _sound_parts(document: dict[str, Any], wrong: set[tuple[int | str, ...]]) -> Parts:
    """`wrong`: the first two parts of the places of errors."""
    bad = {place[0] for place in wrong}
    commands = document.get("commands")
    sources = commands.get("source") if isinstance(commands, dict) and "commands" not in bad else None
    return Parts(
        robot=_table("robot", document, bad),
        loop=_table("loop", document, bad),
        limits=_table("limits", document, bad),
        motors=_tables("motor", Motor, document.get("motor"), wrong),
        buses=_tables("bus", Bus, document.get("bus"), wrong),
        sources=_tables("source", Source, sources, set()),
        sensors=_tables("sensor", Sensor, document.get("sensor", []), wrong),
        settings=_table("settings", document, bad),
    )


def _table(key: str, document: dict[str, Any], bad: set[int | str]) -> Any:  # noqa: ANN401  # of the type of its field
    """This table, or its default; None where it is not sound."""
    if key in bad:
        return None
    field = RobotConfig.model_fields[key]
    if key not in document:
        return field.get_default(call_default_factory=True)
    of: Any = Annotated[field.annotation, field]
    return TypeAdapter(of).validate_python(document[key])


def _tables(key: str, of: type[BaseModel], given: object, wrong: set[tuple[int | str, ...]]) -> Named:
    if not isinstance(given, list) or (key,) in wrong:
        return Named(None, ())
    sound = tuple([of.model_validate(one) for place, one in enumerate(given) if (key, place) not in wrong])
    names = [one.get("name") if isinstance(one, dict) else None for one in given]
    return Named(tuple(map(str, names)) if all(isinstance(name, str) for name in names) else None, sound)


def _named(given: Sequence[BaseModel]) -> Named:
    return Named(tuple(str(getattr(one, "name", "")) for one in given), tuple(given))


def _misfits(parts: Parts) -> list[str]:
    """What does not fit together, of all that is sound."""
    problems: list[str] = []
    for key, named in (
        ("motor.name", parts.motors),
        ("bus.name", parts.buses),
        ("commands.source.name", parts.sources),
    ):
        problems += _duplicates(key, named.names or ())
    problems += _shared_channels(parts.buses.sound)
    problems += _duplicates("commands.source.priority", (source.priority for source in parts.sources.sound))
    problems += _duplicates("sensor.name", [*(parts.sensors.names or ()), *dict.fromkeys(parts.sources.names or ())])
    problems += _second_of_a_kind(parts.sensors.sound)
    problems += _no_width_sensor(parts.robot, parts.sensors)
    if parts.robot is not None and parts.limits is not None:
        for key, limits in parts.limits.axes().items():
            problems += _other_axes(f"limits.{key}", limits.__pydantic_extra__, parts.robot.AXES)
    problems += _unlike_motors(parts)
    for kind, named in (("motor", parts.motors), ("sensor", parts.sensors)):
        problems += _no_bus(kind, named.sound, parts.buses.names)
    return problems + _too_fast(parts)


def _no_width_sensor(robot: AnyRobot | None, sensors: Named) -> list[str]:
    place, ranges = getattr(robot, "width_sensor", None), _of_kind(sensors.sound, SensorKind.RANGE)
    if place is None or place < len(ranges) or not sensors.whole:
        return []
    known = ", ".join(ranges) or "none"
    return [f"robot.width_sensor = {place}: no such [[sensor]] of kind 'range'; from 0 on there is {known}"]


def _unlike_motors(parts: Parts) -> list[str]:
    """What names motors, against the motors there are."""
    if parts.motors.names is None:
        return []
    named: list[tuple[str, Iterable[str]]] = []
    if parts.robot is not None:
        named.append(("robot", parts.robot.motor_names()))
    if parts.limits is not None:
        named.append(("limits.motor_speed", parts.limits.motor_speed))
        if parts.limits.motor_acceleration is not None:
            named.append(("limits.motor_acceleration", parts.limits.motor_acceleration))
    return [problem for key, names in named for problem in _mismatch(key, names, parts.motors.names)]


def _no_bus(kind: str, users: Iterable[Motor | Sensor], buses: Sequence[str] | None) -> list[str]:
    if buses is None:
        return []
    return [
        f"{kind} {one.name}: bus = {one.bus!r}: no such [[bus]]; there is {', '.join(buses)}{guess(one.bus, buses)}"
        for one in users
        if one.bus is not None and one.bus not in buses
    ]


def _too_fast(parts: Parts) -> list[str]:
    speeds = {} if parts.limits is None else parts.limits.motor_speed
    return [
        f"limits.motor_speed.{motor.name} = {speeds[motor.name]}: "
        f"allowed up to the motor's max_speed = {motor.max_speed}"
        for motor in parts.motors.sound
        if speeds.get(motor.name, 0.0) > motor.max_speed
    ]


def load(path: Path) -> tuple[RobotConfig, str]:
    """Robot file and its text. Raises ConfigError."""
    text = read(path)
    return parse(text, str(path)), text


def read(path: Path) -> str:
    """The text of a file that a person wrote, with its line ends. Raises ConfigError."""
    try:
        return path.read_bytes().decode()
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"cannot be read: {error}"]) from None


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
    problems += [f"{key}: {name!r} is no [[motor]]{guess(name, sorted(known))}" for name in names if name not in known]
    return problems + [f"{key}: motor {name!r} is not mentioned" for name in sorted(known - set(names))]
