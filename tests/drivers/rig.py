"""What the driver tests share: motor specs, frames as text, and the smallest fake devices that answer by the book."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, pi
from struct import Struct, pack, unpack, unpack_from
from types import MappingProxyType
from typing import Protocol

from drivers import DRIVERS
from drivers.contract import (
    CanFrame,
    Capabilities,
    DecodedFrame,
    Driver,
    DriverType,
    MotorFeedback,
    MotorSpec,
    MotorState,
    OptionValue,
)
from drivers.odrive.firmware import FIRMWARES
from drivers.setpoint import CommandKind, MotorCommand
from drivers.vesc import SETPOINTS
from tests.drivers.reply_only import REPLY, ReplyOnlyDriver, command_values, reply_data

BUS = "can0"
MS = 1_000_000
CYCLE_NS = 4 * MS
WATCHDOG_S = 0.1
ODRIVE_OPTIONS: Mapping[str, OptionValue] = {
    "firmware": "0.6.10",
    "watchdog_enable_endpoint": 188,
    "watchdog_timeout_endpoint": 189,
}
NEEDED_OPTIONS: Mapping[str, Mapping[str, OptionValue]] = {"vesc": {"pole_pairs": 7, "min_erpm": 20}}
PAIRS = [(driver, variant) for driver, kind in DRIVERS.items() for variant in kind.variants]
DRIVER_TYPES: dict[str, DriverType] = DRIVERS | {"reply_only": ReplyOnlyDriver}
# Controllers that are set up in one of several modes: variant and options of each.
MODES: dict[str, tuple[str, Mapping[str, OptionValue]]] = {
    "gm6020 current": ("gm6020", {"mode": "current"}),
    "gm6020 voltage": ("gm6020", {"mode": "voltage"}),
}
UNDER_CONTRACT = [
    *(pair for pair in PAIRS if pair[1] not in {variant for variant, _ in MODES.values()}),
    *(("dji", mode) for mode in MODES),
    ("reply_only", "replier"),
]


def spec(
    variant: str,
    *,
    id: int = 3,
    name: str = "",
    watchdog_s: float | None = None,
    options: Mapping[str, OptionValue] = MappingProxyType({}),
) -> MotorSpec:
    """A motor of 100 rad/s (in voltage mode 33), 2 N m and 20 A."""
    rate = None if variant in ReplyOnlyDriver.variants else 250.0
    top, supply = (33.0, 24.0) if variant == "gm6020 voltage" else (100.0, None)
    variant, modes = MODES.get(variant, (variant, options))
    options = options or modes or NEEDED_OPTIONS.get(variant, {})
    return MotorSpec(
        *(name or f"motor_{id}", id, variant, top, 2.0, 20.0, rate, 250.0, watchdog_s, options), supply=supply
    )


def watched(variant: str = "0.6", *, id: int = 3) -> MotorSpec:
    """An ODrive with its watchdog."""
    return spec(variant, id=id, watchdog_s=WATCHDOG_S, options=ODRIVE_OPTIONS)


def can_frame(text: str, *, received_ns: int | None = None) -> CanFrame:
    """Frame from `id#data` in hex, or `id#R` for a remote one; an id of 8 digits is extended."""
    identifier, _, data = text.partition("#")
    extended = len(identifier) == 8
    if data == "R":
        return CanFrame(BUS, int(identifier, 16), b"", extended, remote=True, received_ns=received_ns)
    return CanFrame(BUS, int(identifier, 16), bytes.fromhex(data), extended, received_ns=received_ns)


def can_text(frame: CanFrame) -> str:
    """The other way round."""
    identifier = f"{frame.id:08X}" if frame.extended else f"{frame.id:03X}"
    return f"{identifier}#{'R' if frame.remote else frame.data.hex().upper()}"


class Device(Protocol):
    """A fake controller."""

    def answers(self, frames: Sequence[CanFrame], now_ns: int) -> list[CanFrame]: ...


_ENDPOINT_VALUE = Struct("<BHB4s")


@dataclass
class FakeOdrive:
    """One axis: says heartbeats and estimates, and answers what it is asked, unless told otherwise."""

    node: int
    variant: str
    firmware: tuple[int, int, int] = (0, 6, 10)
    axis_state: int = 1
    errors: int = 0
    disarm_reason: int = 0
    result: int = 0
    estimates: tuple[float, float] = (0.0, 0.0)
    powered: bool = True
    encoder: bool = True
    arms: bool = True
    confirms_writes: bool = False
    deaf: Callable[[CanFrame], bool] = lambda _frame: False  # frames that get lost on the way to it
    endpoints: dict[int, bytes] = field(default_factory=lambda: {188: bytes(4), 189: bytes(4)})
    stuck: set[int] = field(default_factory=set)  # endpoints that keep their value
    next_heartbeat_ns: int = 0

    def answers(self, frames: Sequence[CanFrame], now_ns: int) -> list[CanFrame]:
        """What is heard from it until now."""
        if not self.powered:
            return []
        replies = [reply for frame in frames for reply in self._reply(frame)]
        if self.encoder:
            replies.append(self._frame(0x09, pack("<ff", *self.estimates)))
        if now_ns >= self.next_heartbeat_ns:
            self.next_heartbeat_ns = now_ns + 100 * MS
            replies.append(self.heartbeat())
        return [reply._replace(received_ns=now_ns) for reply in replies]

    def heartbeat(self) -> CanFrame:
        """The heartbeat of this moment."""
        if self.variant == "0.5":
            return self._frame(0x01, pack("<IBBBB", self.errors, self.axis_state, 0, 0, 0x80))
        return self._frame(0x01, pack("<IBBBB", self.errors, self.axis_state, self.result, 0, 0))

    def reboot(self) -> None:
        """As after a power cycle: nothing of what was written is left."""
        self.axis_state, self.errors = 1, 0
        self.endpoints = {endpoint: bytes(4) for endpoint in self.endpoints}

    def _reply(self, frame: CanFrame) -> list[CanFrame]:
        if frame.id >> 5 != self.node or self.deaf(frame):
            return []
        command = frame.id & 0x1F
        if command == 0x00 and frame.remote and self.variant == "0.6":
            return [self._frame(0x00, bytes([2, 4, 4, 58, *self.firmware, 0]))]
        if frame.remote:
            return self._told_errors(command)
        if command == 0x04:
            return self._endpoint(frame.data)
        if command == 0x07:
            self._ask_state(unpack_from("<I", frame.data)[0])
        if command == 0x18:
            self.errors = 0
        return []

    def _told_errors(self, command: int) -> list[CanFrame]:
        if self.variant == "0.6":
            return [self._frame(0x03, pack("<II", self.errors, self.disarm_reason))] if command == 0x03 else []
        told = {0x03: pack("<Q", self.disarm_reason), 0x04: bytes(8), 0x1D: bytes(8)}
        return [self._frame(command, told[command])] if command in told else []

    def _endpoint(self, data: bytes) -> list[CanFrame]:
        opcode, endpoint, _, value = _ENDPOINT_VALUE.unpack(data)
        if opcode == 1:
            if endpoint not in self.stuck:
                self.endpoints[endpoint] = value
            # A confirmation shows what was asked for, not what is there.
            return [self._frame(0x05, _ENDPOINT_VALUE.pack(0, endpoint, 0, value))] if self.confirms_writes else []
        return [self._frame(0x05, _ENDPOINT_VALUE.pack(0, endpoint, 0, self.endpoints[endpoint]))]

    def _ask_state(self, asked: int) -> None:
        if asked != 8 or (self.arms and not self.errors):
            self.axis_state = asked

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(BUS, self.node << 5 | command, data)


@dataclass
class FakeDji:
    """One motor at rest at 180 degrees."""

    id: int
    powered: bool = True
    first: int = 0x200  # id 0 would answer so

    def answers(self, _frames: Sequence[CanFrame], now_ns: int) -> list[CanFrame]:
        """Feedback of this cycle."""
        if not self.powered:
            return []
        return [CanFrame(BUS, self.first + self.id, pack(">HhhBB", 4096, 0, 0, 30, 0), received_ns=now_ns)]


@dataclass
class FakeVesc:
    """One motor at rest: says STATUS and STATUS_5, answers what it is asked, and has a command timeout of 0.1 s."""

    id: int
    powered: bool = True
    timeout_ns: int = 100 * MS
    fault: int = 0
    killed: bool = False
    answering: bool = True
    statuses: tuple[int, ...] = (9, 27)
    voltage: float = 24.0
    deaf: Callable[[CanFrame], bool] = lambda _frame: False  # frames that get lost on the way to it
    fed_ns: int = 0

    def answers(self, frames: Sequence[CanFrame], now_ns: int) -> list[CanFrame]:
        """What is heard from it until now."""
        if not self.powered:
            return []
        replies = [reply for frame in frames if frame.id & 0xFF == self.id for reply in self._reply(frame, now_ns)]
        said = {9: pack(">ihh", 0, 0, 0), 16: pack(">4h", 300, 290, 0, 0), 27: pack(">ihxx", 0, int(10 * self.voltage))}
        replies += [vesc_frame(self.id, command, said[command]) for command in self.statuses]
        return [reply._replace(received_ns=now_ns) for reply in replies]

    def _reply(self, frame: CanFrame, now_ns: int) -> list[CanFrame]:
        if self.deaf(frame):
            return []
        if frame.id >> 8 != 8:
            self.fed_ns = now_ns
            return []
        host, what, packet, mask = unpack(">BBBI", frame.data)
        if not self.answering or (what, packet) != (0, 50):
            return []
        expired = self.timeout_ns > 0 and now_ns - self.fed_ns > self.timeout_ns
        value = self.fault if mask == 1 << 15 else expired | self.killed << 1
        return [vesc_frame(host, 8, pack(">BBBIB", self.id, 1, 50, mask, value))]


def vesc_frame(id: int, command: int, data: bytes) -> CanFrame:
    return CanFrame(BUS, command << 8 | id, data, extended=True)


def claimed(able: Capabilities) -> set[CommandKind]:
    """The kinds of command that a controller of these capabilities takes."""
    declared = {
        CommandKind.VELOCITY: able.velocity,
        CommandKind.TORQUE: able.torque,
        CommandKind.VOLTAGE: able.voltage,
        CommandKind.BRAKE: able.brake,
        CommandKind.COAST: True,
    }
    return {kind for kind, given in declared.items() if given}


@dataclass
class FakeReplier:
    """One motor at rest that speaks when spoken to."""

    id: int
    powered: bool = True

    def answers(self, frames: Sequence[CanFrame], now_ns: int) -> list[CanFrame]:
        """A reply to each command."""
        commands = [frame for frame in frames if frame.id == 0x10 + self.id] if self.powered else []
        return [CanFrame(BUS, REPLY + self.id, reply_data(0, 0.0, 0.0), received_ns=now_ns) for _ in commands]


class Bench:
    """A driver with its fake devices, cycled every 4 ms."""

    def __init__(self, driver: Driver, devices: Sequence[Device]) -> None:
        self.driver = driver
        self.devices = devices
        self.now_ns = 1_000 * MS
        self.sent: list[tuple[int, CanFrame]] = []  # with the time
        self.last: list[CanFrame] = []  # sent in the last cycle
        self.states: list[MotorState] = []  # right after the command

    def cycle(self, commands: Sequence[MotorCommand]) -> list[CanFrame]:
        """One cycle: command, let the devices answer, take the answers."""
        frames = self.driver.command(commands, now_ns=self.now_ns)
        self.states = [motor.state for motor in self.feedback()]
        self.sent += [(self.now_ns, frame) for frame in frames]
        self.last = frames
        heard = [answer for device in self.devices for answer in device.answers(frames, self.now_ns + MS)]
        self.now_ns += CYCLE_NS
        for frame in heard:
            assert self.driver.receive(frame)
        return frames

    def run(self, command: MotorCommand, *, ms: int, until: Callable[[], bool] = lambda: False) -> list[CanFrame]:
        """The same command to all for a while; the frames sent."""
        end, frames = self.now_ns + ms * MS, list[CanFrame]()
        while self.now_ns < end and not until():
            frames += self.cycle([command] * len(self.devices))
        return frames

    def said(self) -> list[CanFrame]:
        """What is heard 200 ms later, if the last frames are sent again."""
        return [frame for device in self.devices for frame in device.answers(self.last, self.now_ns + 200 * MS)]

    def feedback(self) -> list[MotorFeedback]:
        """Feedback as of the next cycle."""
        return self.driver.feedback(now_ns=self.now_ns)


def odrive_setpoints(frame: CanFrame) -> tuple[float, ...]:
    """Velocity, torque feed-forward or torque that an ODrive frame asks for; nothing for other frames."""
    command = frame.id & 0x1F
    if frame.remote or command not in {0x0C, 0x0D, 0x0E}:
        return ()
    return unpack("<ff", frame.data)


def dji_setpoints(frame: CanFrame) -> tuple[float, ...]:
    """Current or voltage raw of the four slots."""
    return unpack(">4h", frame.data) if frame.id in {0x200, 0x1FF, 0x2FF, 0x1FE, 0x2FE} else ()


def vesc_setpoints(frame: CanFrame) -> tuple[float, ...]:
    """Duty, current or speed that a VESC is asked for; a current brake asks for no motion."""
    command = frame.id >> 8
    if command not in {0, 1, 2, 3}:
        return ()
    return (0.0,) if command == 2 else unpack(">i", frame.data)


def odrive_measurement(node: int, position: float, velocity: float) -> tuple[CanFrame, ...]:
    return (CanFrame(BUS, node << 5 | 0x09, pack("<ff", position / (2 * pi), velocity / (2 * pi))),)


def dji_measurement(id: int, position: float, velocity: float, *, first: int = 0x200) -> tuple[CanFrame, ...]:
    ticks = int(position / (2 * pi) * 8192) % 8192
    return (CanFrame(BUS, first + id, pack(">HhhBB", ticks, round(velocity * 30 / pi), 0, 30, 0)),)


def vesc_measurement(id: int, position: float, velocity: float) -> tuple[CanFrame, ...]:
    counts, erpm = round(position / (2 * pi) * 42), int(velocity * 30 / pi * 7)
    status, status_5 = pack(">ihh", erpm, 0, 0), pack(">ihxx", counts, 240)
    return vesc_frame(id, 9, status), vesc_frame(id, 27, status_5)


@dataclass
class Rig:
    """How to test one driver: its kinds of command, a bench with two motors, its setpoints, a frame with a fault."""

    kinds: tuple[CommandKind, ...]
    ids: tuple[int, int]
    bad_ids: tuple[int, ...]
    device: Callable[[int, str], Device]
    setpoints: Callable[[CanFrame], tuple[float, ...]]
    fault_frame: Callable[[int, str], CanFrame] | None
    measurement: Callable[[int, float, float], tuple[CanFrame, ...]]  # of an id, at so many rad and rad/s
    watchdogs: Mapping[str, Mapping[str, OptionValue]] = field(default_factory=dict)  # by variant: options with it
    commands: frozenset[str] = frozenset()  # names of the messages that a host sends
    extended: bool = False  # its ids
    lengths: tuple[int, int] = (8, 8)  # bytes of a setpoint and of a measurement
    cyclic: int = 1  # frames of each motor at its feedback rate
    every_id: Sequence[int] = range(0x800)  # every one that may mean something

    def from_host(self, decoded: DecodedFrame) -> bool:
        """Whether a host says this, and no controller."""
        return decoded.message in self.commands or (decoded.message.endswith(" request") and not decoded.fields)

    def specs(self, variant: str) -> list[MotorSpec]:
        """Two motors."""
        return [self.spec(variant, id=at) for at in self.ids]

    def spec(self, variant: str, *, id: int) -> MotorSpec:
        """One motor, with its watchdog if it can have one."""
        if variant not in self.watchdogs:
            return spec(variant, id=id)
        return spec(variant, id=id, watchdog_s=WATCHDOG_S, options=self.watchdogs[variant])

    def asked(self, frames: Sequence[CanFrame]) -> list[float]:
        """Every setpoint in the frames, all finite."""
        values = [value for frame in frames for value in self.setpoints(frame)]
        assert all(isfinite(value) for value in values)
        return values


RIGS: dict[str, Rig] = {
    "odrive": Rig(
        kinds=(CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.BRAKE, CommandKind.COAST),
        ids=(3, 0),
        bad_ids=(-1, 63, 64),
        device=FakeOdrive,
        setpoints=odrive_setpoints,
        fault_frame=lambda node, _variant: CanFrame(BUS, node << 5 | 1, pack("<IBBBB", 0x4000, 1, 0, 0, 0)),
        measurement=odrive_measurement,
        watchdogs={"0.6": ODRIVE_OPTIONS},
        commands=frozenset(message.name for line in FIRMWARES.values() for message in line.to_device.values()),
    ),
    "dji": Rig(
        kinds=(CommandKind.TORQUE, CommandKind.COAST),
        ids=(2, 7),
        bad_ids=(-1, 0, 9),
        device=lambda id, _variant: FakeDji(id),
        setpoints=dji_setpoints,
        fault_frame=None,  # the controllers report no faults
        measurement=dji_measurement,
        commands=frozenset({"command"}),
    ),
    "reply_only": Rig(
        kinds=(CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.BRAKE, CommandKind.COAST),
        ids=(3, 5),
        bad_ids=(-1, 0, 16),
        device=lambda id, _variant: FakeReplier(id),
        setpoints=command_values,
        fault_frame=lambda id, _variant: CanFrame(BUS, REPLY + id, reply_data(7, 0.0, 0.0)),
        measurement=lambda id, position, velocity: (CanFrame(BUS, REPLY + id, reply_data(0, position, velocity)),),
        commands=frozenset({"command"}),
    ),
    "vesc": Rig(
        kinds=(
            *(CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.VOLTAGE),
            *(CommandKind.BRAKE, CommandKind.COAST),
        ),
        ids=(3, 0),
        bad_ids=(-1, 127, 128, 255),
        device=lambda id, _variant: FakeVesc(id),
        setpoints=vesc_setpoints,
        fault_frame=lambda id, _variant: vesc_frame(128 | id, 8, pack(">BBBIB", id, 1, 50, 1 << 15, 5)),
        measurement=vesc_measurement,
        watchdogs={"vesc": NEEDED_OPTIONS["vesc"]},
        commands=frozenset(message.name for message in SETPOINTS.values()) | {"GET_VALUES_SELECTIVE request"},
        extended=True,
        lengths=(4, 8),
        cyclic=2,
        every_id=[command << 8 | id for command in (*range(64), 0x100, 0x1FFFFF) for id in (0, 1, 3, 4, 128, 131, 255)],
    ),
}


_GM6020 = replace(
    RIGS["dji"],
    bad_ids=(-1, 0, 8),
    device=lambda id, _variant: FakeDji(id, first=0x204),
    measurement=lambda id, position, velocity: dji_measurement(id, position, velocity, first=0x204),
)
_RIGS_OF_MODES: dict[str, Rig] = {
    "gm6020 current": _GM6020,
    "gm6020 voltage": replace(_GM6020, kinds=(CommandKind.VOLTAGE, CommandKind.BRAKE, CommandKind.COAST)),
}


def rig_of(driver: str, variant: str) -> Rig:
    """How to test this variant, or a controller that is set up in this mode."""
    return _RIGS_OF_MODES.get(variant, RIGS[driver])


def bench(driver: str, variant: str) -> tuple[Bench, Rig]:
    """A driver of this variant on a bench of two motors."""
    rig = rig_of(driver, variant)
    specs = rig.specs(variant)
    return Bench(DRIVER_TYPES[driver](BUS, specs), [rig.device(motor.id, variant) for motor in specs]), rig
