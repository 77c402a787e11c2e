"""DJI RoboMaster C620 (M3508 motor), C610 (M2006 motor) and GM6020 (motor and controller in one).

How this works
--------------
C620 and C610 take a torque only, through the current. A GM6020 takes that or a voltage: which of the two is set in
DJI's tool and cannot be read over CAN, so the robot file tells it (`options.mode`). In the other mode it listens to
other ids, answers as ever and does not obey, which the core finds as it finds any motor that does not follow.

Four motors share one command frame; every slot is always written, an unused one with 0. So there must be one writer per
command id: this driver, and nobody else on that bus. There is no arming, no error report and no command timeout on CAN;
whether a controller holds its last command when the host falls silent is not documented, so assume that it does. A
motor that is not heard gets 0, and so does one whose id two controllers have: whose speed is told is anybody's guess.

0 is no current, with which a motor rolls on, or no voltage, with which its windings are as good as shorted: it brakes,
the more the faster it turns, and never drives. So a GM6020 in voltage mode cannot be let roll, and braking it is 0 V.
Where it takes a torque, braking without the host's speed loop (`stop_frames`) is a current against the measured speed,
in proportion to it: it fades as the motor comes to rest, and is 0 where the speed is unknown or too small to have a
sign. A controller may hold it until the next frame, so the longer it may be held or the older the measurement is, the
weaker it is.

Rotor side throughout: angle, speed and torque are those of the motor shaft before any gearbox; a GM6020 has none. The
angle is absolute within one turn of it. Turns are counted from the first frame on, so that after a restart of the host
they begin anew, and with them what lies behind a gear.
"""

from collections.abc import Collection, Sequence
from math import ceil, isnan, pi, tau
from struct import Struct
from typing import ClassVar, Final, NamedTuple

from drivers.checks import (
    FASTEST_FEEDBACK_HZ,
    Bound,
    check_bounds,
    check_count,
    check_options,
    check_specs,
    feedback_timeout_ns,
    measuring_hz,
    one_of,
)
from drivers.contract import (
    CanFrame,
    Capabilities,
    DecodedFrame,
    DriverFault,
    IdUse,
    MotorFeedback,
    MotorSpec,
    MotorState,
    ReceiveFilter,
    Renaming,
    Traffic,
)
from drivers.records import data_frame, maker
from drivers.setpoint import CommandKind, MotorCommand
from drivers.sighting import Evidence, Sighting
from drivers.twins import TwinWatch, twin_fault

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_SILENT: Final = MotorState.SILENT
_OPERATIONAL: Final = MotorState.OPERATIONAL
_IDLE: Final = MotorState.IDLE
_FAULT: Final = MotorState.FAULT

# In the order in which they are sent.
COMMAND_IDS: Final = (0x200, 0x1FF, 0x2FF, 0x1FE, 0x2FE)
MOTORS_PER_FRAME: Final = 4
# How a C620, a C610 and a GM6020 are numbered; the switches of a GM6020 can also say 0, which is no id.
IDS: Final = {"c620": range(1, 9), "c610": range(1, 9), "gm6020": range(1, 8)}
FEEDBACK_ID: Final = {"c620": 0x200, "c610": 0x200, "gm6020": 0x204}  # + id; C610 manual, p. 9; of a GM6020: taproot

NAME: Final = "dji"
HOTTEST: Final = 150  # deg C that one may tell; source: ours

AUTO_ID: Final = 0x700  # 8 bytes on it make controllers choose new ids; RoboRTS-Firmware, motor_auto_set_id

TICKS: Final = 8192  # per turn of the rotor; C610 manual, p. 9
HALF_TURN: Final = TICKS / 2.0
RAD_PER_TICK: Final = tau / TICKS
RAD_S_PER_RPM: Final = tau / 60.0
TICKS_PER_RPM_NS: Final = TICKS / 60e9

SPEED_DOUBT: Final = 0.1  # of max_speed: how far the mean speed between two frames may be from that of its two ends
FULL_BRAKING: Final = 0.25  # of max_speed: from there on all of the current that is allowed brakes
REST: Final = 0.002  # of max_speed: below it nothing brakes
MIN_REST_RPM: Final = 2  # the speed is told in whole rpm, so that of 1 has no sure sign
FULL_BRAKING_NS: Final = 5_000_000  # a current held for longer could turn a wheel in the air the other way round

_made: Final = maker(MotorFeedback)
_TORQUE: Final = CommandKind.TORQUE
_VOLTAGE: Final = CommandKind.VOLTAGE
_COAST: Final = CommandKind.COAST
_BRAKE: Final = CommandKind.BRAKE
_COMMAND: Final = Struct(">4h")  # current or voltage raw of four motors
_FEEDBACK: Final = Struct(">HhhBx")  # angle ticks, speed rpm, current raw, temperature deg C (C610: nothing), unused
_WHOLE: Final = 6755399441055744.0  # 1.5 * 2^52: floats there are whole numbers, so adding it rounds to the nearest one
_FEEDBACK_SIZE: Final = _FEEDBACK.size
_feedback: Final = _FEEDBACK.unpack_from
_FEEDBACK_FIELDS: Final = ("angle_ticks", "speed_rpm", "current_raw", "temperature_c")


class Mode(NamedTuple):
    """What differs between the controllers, and between the modes of one."""

    kind: CommandKind  # what it takes: a torque through the current, or a voltage
    command_ids: tuple[int, int]  # of ids 1 to 4, and of those above
    raw_limit: int
    raw_per_ampere: float | None  # in feedback and, of a current, in commands; None: not known
    torque_constant: float  # N m/A at the rotor
    temperature: bool


MODES: Final[dict[str, dict[str, Mode]]] = {
    # raw 16384 = 20 A, 0.3 N m/A after the gearbox 3591/187; open-source drivers RoboRTS-Firmware, OneMotor
    "c620": {"current": Mode(_TORQUE, (0x200, 0x1FF), 16384, 16384 / 20.0, 0.3 * 187 / 3591, temperature=True)},
    # raw 10000 = 10 A; RoboMaster C610 manual, p. 8. 0.18 N m/A after the gearbox 36; OneMotor
    "c610": {"current": Mode(_TORQUE, (0x200, 0x1FF), 10000, 1000.0, 0.18 / 36.0, temperature=False)},
    "gm6020": {
        # raw 16384 = 3 A, 0.741 N m/A; the manual, v1.4, as public drivers quote it. That the feedback has the same
        # scale they take for granted. It takes a firmware that knows this mode: 1.0.11.2 or later, unverified.
        "current": Mode(_TORQUE, (0x1FE, 0x2FE), 16384, 16384 / 3.0, 0.741, temperature=True),
        # Disputed: the full scale is 25000 in taproot, OneMotor and the manual, v1.4, 30000 in rm_control and
        # iRM_Embedded, which older motors may have; 25000 gives too little there and never too much. Nobody says what
        # the current in the feedback is counted in.
        "voltage": Mode(_VOLTAGE, (0x1FF, 0x2FF), 25000, None, 0.741, temperature=True),
    },
}
GM6020_RPM_PER_V: Final = 13.33  # the manual, v1.4, as public drivers quote it
LEAST_SUPPLY: Final = 18.0  # V; six cells, empty
MOST_SUPPLY: Final = 28.0  # V; six cells, full, and a power supply of 24 V; both: ours
_MODE: Final = one_of(MODES["gm6020"], "as it is set in DJI's tool, which CAN does not tell")


class _Motor:
    """What is known of one motor."""

    __slots__ = (
        "angle_ticks",
        "braking_raw_per_rpm",
        "command_period_ns",
        "commanded",
        "current_raw",
        "fault",
        "heard_ns",
        "heard_until_ns",
        "kind",
        "raw_limit",
        "raw_per_torque",
        "raw_per_value",
        "rest_rpm",
        "slot",
        "spec",
        "speed_rpm",
        "temperature",
        "temperature_raw",
        "timeout_ns",
        "total_ticks",
        "twins",
    )

    def __init__(self, spec: MotorSpec, slot: int) -> None:
        mode = _mode(spec)
        self.spec = spec
        self.kind = mode.kind
        self.temperature = mode.temperature
        self.slot = slot
        self.raw_per_torque = None if mode.raw_per_ampere is None else mode.raw_per_ampere / mode.torque_constant
        self.raw_limit, self.raw_per_value = _scale(spec, mode)
        max_rpm = spec.max_speed / RAD_S_PER_RPM
        # No voltage brakes by itself, and can never drive it the other way round.
        self.braking_raw_per_rpm = 0.0 if mode.kind is _VOLTAGE else self.raw_limit / (FULL_BRAKING * max_rpm)
        self.command_period_ns = int(1e9 / spec.command_rate)
        self.rest_rpm = max(MIN_REST_RPM, REST * max_rpm)
        self.timeout_ns = feedback_timeout_ns(spec)
        self.commanded = False
        self.heard_ns: int | None = None
        self.heard_until_ns = 0
        self.angle_ticks = 0
        self.total_ticks = 0
        self.speed_rpm = 0
        self.current_raw = 0
        self.temperature_raw = 0
        self.twins = TwinWatch(spec, turn=tau)
        self.fault: DriverFault | None = None

    def take(self, data: bytes, bus: str, received_ns: int) -> bool:
        """A feedback frame; False for one that no controller sends."""
        if len(data) < _FEEDBACK_SIZE:
            return False
        values: tuple[int, int, int, int] = _feedback(data)  # compiled, a number of no known type takes twice as long
        angle_ticks, speed_rpm, current_raw, temperature = values
        if angle_ticks >= TICKS:
            return False
        if self.heard_ns is None:
            self.total_ticks = angle_ticks
        else:
            gap_ns = received_ns - self.heard_ns
            mean_rpm = 0.5 * (self.speed_rpm + speed_rpm) if gap_ns > 0 else 0.0
            self.total_ticks += _moved_ticks(angle_ticks - self.angle_ticks, mean_rpm * gap_ns * TICKS_PER_RPM_NS)
        self.angle_ticks = angle_ticks
        self.speed_rpm = speed_rpm
        self.current_raw = current_raw
        self.temperature_raw = temperature
        self.heard_ns = received_ns
        self.heard_until_ns = received_ns + self.timeout_ns
        if self.twins.take(angle_ticks * RAD_PER_TICK, speed_rpm * RAD_S_PER_RPM, received_ns) and self.fault is None:
            self.fault = twin_fault(self.spec, bus)
        return True

    def trusted(self, now_ns: int) -> bool:
        """Whether it is heard, and is one."""
        return now_ns < self.heard_until_ns and self.fault is None

    def takes(self, kind: CommandKind) -> bool:
        """Whether this is a kind of command for it."""
        return kind is self.kind or kind is _COAST or (kind is _BRAKE and self.kind is _VOLTAGE)

    def raw(self, value: float) -> int:
        """Current for a torque, or voltage, within all limits."""
        return self._limited(value * self.raw_per_value)

    def braking_raw(self, held_ns: int, now_ns: int) -> int:
        """Current against the measured speed; `held_ns`: how long the last frame was, and so the next one may be."""
        if not self.trusted(now_ns) or self.heard_ns is None or abs(self.speed_rpm) < self.rest_rpm:
            return 0
        longest_ns = max(self.command_period_ns, held_ns, now_ns - self.heard_ns, FULL_BRAKING_NS)
        return self._limited(-self.speed_rpm * self.braking_raw_per_rpm * FULL_BRAKING_NS / longest_ns)

    def _limited(self, wanted: float) -> int:
        limit = self.raw_limit
        return limit if wanted >= limit else -limit if wanted <= -limit else _nearest(wanted)

    def feedback(self, now_ns: int) -> MotorFeedback:
        """Measurement and state."""
        if self.heard_ns is None:
            return MotorFeedback(_SILENT)
        state = _OPERATIONAL if self.commanded else _IDLE
        if self.fault is not None:
            state = _FAULT
        age_ns = now_ns - self.heard_ns if now_ns > self.heard_ns else 0
        return _made(
            (
                state if now_ns < self.heard_until_ns else _SILENT,
                self.total_ticks * RAD_PER_TICK,
                self.speed_rpm * RAD_S_PER_RPM,
                None if self.raw_per_torque is None else self.current_raw / self.raw_per_torque,
                None,
                float(self.temperature_raw) if self.temperature else None,
                self.fault,
                age_ns,
                None,
                age_ns,
            )
        )


class SharedFrame(NamedTuple):
    """A command frame of four motors."""

    id: int
    first: int  # of its slots
    fields: tuple[str, ...]
    owners: tuple[str | None, ...]  # motors by slot; None: nobody's


_TORQUES: Final = Capabilities(torque=True, speed_step=RAD_S_PER_RPM)
_VOLTS: Final = Capabilities(voltage=True, brake=True, coast=False, speed_step=RAD_S_PER_RPM)
_IN_WORDS: Final = {_TORQUE: "a torque in N m alone", _VOLTAGE: "a voltage in V alone, brake"}


class DjiDriver:
    """The C620, C610 and GM6020 controllers of one bus."""

    __slots__ = ("_bus", "_by_id", "_command_frames", "_motors", "_sent_ns", "_slots", "_zero_frames")

    variants: ClassVar[tuple[str, ...]] = tuple(MODES)
    words: ClassVar[tuple[str, ...]] = ()

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        _check_numbers(motors)
        for motor in motors:
            if motor.watchdog_s is not None:
                raise ValueError(f"motor {motor.name}: watchdog: a {motor.variant} has none; give watchdog_waiver")
            _check_options(motor)
            check_bounds(motor, [*_turn_bounds(motor), *_voltage_bounds(motor)])
            _check_torque(motor)
        _check_feedback_ids(motors)
        self._bus = bus
        used = [at for at in COMMAND_IDS if any(_command_id(motor) == at for motor in motors)]
        self._motors = tuple(
            _Motor(motor, used.index(_command_id(motor)) * MOTORS_PER_FRAME + _place(motor)) for motor in motors
        )
        self._sent_ns: int | None = None
        self._by_id = {_feedback_id(motor.spec): motor for motor in self._motors}
        self._slots = len(used) * MOTORS_PER_FRAME
        self._command_frames = tuple(_shared(at, first, self._motors) for first, at in enumerate(used))
        self._zero_frames = [CanFrame(bus, shared.id, bytes(8)) for shared in self._command_frames]

    @staticmethod
    def sighted(frame: CanFrame) -> list[Sighting]:
        """Which of these controllers would say this, or would be told it. None has a sure sign of its own."""
        return _sighted(frame)

    @staticmethod
    def questions(bus: str, heard: Collection[int]) -> list[CanFrame]:
        """None: they answer nothing."""
        return []

    @staticmethod
    def renaming(variant: str) -> Renaming:
        """By its button or its switches: the frame that makes all choose anew (AUTO_ID) is never sent."""
        return Renaming(IDS[variant], _switches if variant == "gm6020" else _presses)

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        """Torque alone, of which braking is the host's speed loop; or a voltage alone, of which none brakes."""
        return tuple([_VOLTS if motor.kind is _VOLTAGE else _TORQUES for motor in self._motors])

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours."""
        bus, identifier, data, extended, remote, received_ns, fd, _ = frame
        motor = self._by_id.get(identifier)
        if motor is None or received_ns is None or extended or remote or fd or bus != self._bus:
            return False
        return motor.take(data, bus, received_ns)

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """The command frames; a motor that is not heard gets 0."""
        check_count(commands, self._motors)
        raws = [0] * self._slots
        for motor, command in zip(self._motors, commands):
            kind, value = command.kind, command.value
            alone = command.feed_forward == 0.0 and command.limit is None
            if isnan(value) or not motor.takes(kind) or not alone:
                raise ValueError(f"motor {motor.spec.name}: {command}: must be {_IN_WORDS[motor.kind]}, or coast")
            motor.commanded = kind is not _COAST
            if kind is motor.kind and motor.trusted(now_ns):
                raws[motor.slot] = motor.raw(value)
        return self._frames(raws, now_ns)

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each motor. The controllers report no faults; the driver finds one."""
        return [motor.feedback(now_ns) for motor in self._motors]

    def clear_faults(self) -> None:
        """Look anew for ids given twice; the controllers themselves report no faults."""
        for motor in self._motors:
            motor.fault = None
            motor.twins.forget()

    def coast_frames(self) -> list[CanFrame]:
        """0 for every motor; without a voltage it is braked, which nothing on CAN can change."""
        return list(self._zero_frames)

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """No voltage, or a braking current against the measured speed; 0 where that is not known, or too small."""
        held_ns = 0 if self._sent_ns is None else now_ns - self._sent_ns
        raws = [0] * self._slots
        for motor in self._motors:
            raws[motor.slot] = motor.braking_raw(held_ns, now_ns)
        return self._frames(raws, now_ns)

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of these motors, too short or impossible."""
        if frame.bus != self._bus or frame.extended or frame.remote or frame.fd or len(frame.data) < _COMMAND.size:
            return None
        for shared in self._command_frames:
            if frame.id == shared.id:
                raws = _COMMAND.unpack_from(frame.data)
                return DecodedFrame(None, "command", tuple(zip(shared.fields, raws, strict=True)), shared.owners)
        motor = self._by_id.get(frame.id)
        if motor is None:
            return None
        items = _feedback(frame.data)
        if items[0] >= TICKS:
            return None
        return DecodedFrame(motor.spec.name, "feedback", tuple(zip(_FEEDBACK_FIELDS, items, strict=True)))

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Command frames and the feedback of each motor."""
        sent = [Traffic(f"command 0x{shared.id:X}", False, 8, loop_rate_hz) for shared in self._command_frames]
        received = [
            Traffic(f"{motor.spec.name} feedback", False, 8, measuring_hz(motor.spec)) for motor in self._motors
        ]
        return (*sent, *received)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """The feedback frame of each motor."""
        return tuple(ReceiveFilter(identifier, 0x7FF, extended=False) for identifier in self._by_id)

    def ids(self) -> tuple[IdUse, ...]:
        """The command frames, the feedback of each motor, and the one frame that would give the controllers new ids."""
        commands = [
            (f"dji command of motor {', '.join(name for name in shared.owners if name is not None)}", shared.id)
            for shared in self._command_frames
        ]
        feedback = [(f"dji feedback of motor {motor.spec.name}", at) for at, motor in self._by_id.items()]
        uses = (*commands, *feedback, ("dji setting of ids", AUTO_ID))
        return tuple(IdUse(user, identifier, 0x7FF, extended=False) for user, identifier in uses)

    def _frames(self, raws: Sequence[int], now_ns: int) -> list[CanFrame]:
        self._sent_ns = now_ns
        return [
            data_frame(self._bus, shared.id, _COMMAND.pack(*raws[shared.first : shared.first + MOTORS_PER_FRAME]))
            for shared in self._command_frames
        ]


def _presses(at: int) -> tuple[str, ...]:
    """What a person does for this id; general knowledge, unverified."""
    return (
        "press the SET button of the controller once, shortly: its light goes out",
        f"press it {at} times, shortly, with less than 3 s between: once more for each number; the light follows",
        "wait for 3 s: it keeps the id; the user guide that came with it is right where it differs",
    )


def _switches(at: int) -> tuple[str, ...]:
    """What a person does for this id; general knowledge, unverified."""
    ways = ", ".join([f"{place + 1} {'on' if at >> place & 1 else 'off'}" for place in range(3)])
    return (
        "cut the power of the motor",
        f"set its switches: {ways}; switch 4 is the 120 ohm of the bus's end and no part of the id",
        "power it again: only then it reads them; the user guide that came with it is right where it differs",
    )


def _mode(motor: MotorSpec) -> Mode:
    """How this motor is spoken to."""
    modes = MODES[motor.variant]
    return modes[str(motor.options.get("mode", next(iter(modes))))]


def _command_id(motor: MotorSpec) -> int:
    return _mode(motor).command_ids[(motor.id - 1) // MOTORS_PER_FRAME]


def _place(motor: MotorSpec) -> int:
    """Among the four of its frame."""
    return (motor.id - 1) % MOTORS_PER_FRAME


def _feedback_id(motor: MotorSpec) -> int:
    return FEEDBACK_ID[motor.variant] + motor.id


def _scale(motor: MotorSpec, mode: Mode) -> tuple[int, float]:
    """The largest raw value within all limits, and raw per N m or V. What a voltage does is for who commands it."""
    if mode.raw_per_ampere is None:
        return mode.raw_limit, mode.raw_limit / (motor.supply or MOST_SUPPLY)  # checked before: it is never left out
    ampere = min(motor.max_current, motor.max_torque / mode.torque_constant)
    return min(mode.raw_limit, int(ampere * mode.raw_per_ampere)), mode.raw_per_ampere / mode.torque_constant


def _shared(identifier: int, group: int, motors: Sequence[_Motor]) -> SharedFrame:
    """The command frame of this id, in words of the first motor in it where a slot is nobody's."""
    first = group * MOTORS_PER_FRAME
    in_it = {motor.slot - first: motor for motor in motors if first <= motor.slot < first + MOTORS_PER_FRAME}
    some = next(iter(in_it.values()))
    fields = tuple(_field(in_it.get(place, some), identifier, place) for place in range(MOTORS_PER_FRAME))
    names = tuple(in_it[place].spec.name if place in in_it else None for place in range(MOTORS_PER_FRAME))
    return SharedFrame(identifier, first, fields, names)


def _field(motor: _Motor, identifier: int, place: int) -> str:
    """What the slot would be called if it were that of such a motor."""
    number = _mode(motor.spec).command_ids.index(identifier) * MOTORS_PER_FRAME + place + 1
    return f"{'voltage' if motor.kind is _VOLTAGE else 'current'}_raw_{number}"


def _check_numbers(motors: Sequence[MotorSpec]) -> None:
    """Controllers that are numbered alike may not share a number; of others the same number may be two."""
    alike: dict[int, list[MotorSpec]] = {}
    for motor in motors:
        alike.setdefault(FEEDBACK_ID.get(motor.variant, 0), []).append(motor)
    for members in alike.values() if alike else [motors]:
        ids = IDS.get(members[0].variant, range(1)) if members else range(1)
        check_specs(members, driver="dji", variants=tuple(MODES), ids=ids)


def _check_feedback_ids(motors: Sequence[MotorSpec]) -> None:
    """Raise ValueError where a GM6020 answers as another controller does; so they would share a slot, too."""
    owners: dict[int, MotorSpec] = {}
    for motor in motors:
        at = _feedback_id(motor)
        other = owners.setdefault(at, motor)
        if other is not motor:
            raise ValueError(
                f"motor {motor.name}: id = {motor.id}: a {motor.variant} of this id answers as 0x{at:X}, and so does "
                f"motor {other.name}, a {other.variant} of id {other.id}: give one of them another id, or another bus"
            )


def _check_options(motor: MotorSpec) -> None:
    """Raise ValueError unless it is told in which of its modes a controller is that has several."""
    known = {} if len(MODES[motor.variant]) == 1 else {"mode": _MODE}
    check_options(motor, known, of=f"a {motor.variant}")


def _check_torque(motor: MotorSpec) -> None:
    mode = _mode(motor)
    limit, _ = _scale(motor, mode)
    if limit < 1 and mode.raw_per_ampere is not None:
        step = f"{1e3 / mode.raw_per_ampere:.2g} mA"
        raise ValueError(f"motor {motor.name}: max_current or max_torque allows less than {step}, one step")


def _voltage_bounds(motor: MotorSpec) -> list[Bound]:
    """Of a voltage, which is a share of the supply: no motor turns faster than that lets it. ValueError without one."""
    if _mode(motor).kind is not _VOLTAGE:
        return []
    volts, share = motor.supply, f"a {motor.variant} in voltage mode gives a share of its supply"
    if volts is None:
        raise ValueError(f"motor {motor.name}: winding is missing: {share}, which is winding.voltage")
    why = f"a {motor.variant} turns {GM6020_RPM_PER_V} rpm per volt without a load, and winding.voltage = {volts:g}"
    return [
        Bound("winding.voltage", volts, LEAST_SUPPLY, MOST_SUPPLY, "V", share),
        Bound("max_speed", motor.max_speed, 0.0, volts * GM6020_RPM_PER_V * RAD_S_PER_RPM, "rad/s", why),
    ]


def _turn_bounds(motor: MotorSpec) -> list[Bound]:
    """The angle is known within a turn only: between two frames the way must be foreseen to half a turn."""
    doubt = SPEED_DOUBT * motor.max_speed
    slowest = ceil(10.0 * doubt / pi) / 10.0
    top = f"max_speed times gear_ratio is {motor.max_speed:.0f} rad/s"
    why = f"the rotor's turns are counted from its angle and speed, and {top}"
    return [
        Bound("max_speed", motor.max_speed, 0.0, FASTEST_FEEDBACK_HZ * pi / SPEED_DOUBT, "rad/s at the rotor", why),
        Bound("feedback_rate", measuring_hz(motor), slowest, FASTEST_FEEDBACK_HZ, "Hz", why),
    ]


def _sighted(frame: CanFrame) -> list[Sighting]:
    if frame.extended or frame.remote or frame.fd:
        return []
    if frame.id in COMMAND_IDS:
        return _commanded(frame)
    found = []
    for first in sorted(set(FEEDBACK_ID.values())):
        variants = tuple([variant for variant, of in FEEDBACK_ID.items() if of == first])
        if frame.id - first in IDS[variants[0]]:
            found.append(_feedback_sighting(frame.id - first, variants, frame.data))
    return found


def _commanded(frame: CanFrame) -> list[Sighting]:
    """Every motor that may be told something other than 0 here; a slot of 0 may be nobody's."""
    if len(frame.data) != _COMMAND.size:
        return []
    raws: tuple[int, ...] = _COMMAND.unpack(frame.data)
    found = []
    for variant, modes in MODES.items():
        for mode in modes.values():
            if frame.id in mode.command_ids:
                first = 1 + MOTORS_PER_FRAME * mode.command_ids.index(frame.id)
                ids = [first + place for place, raw in enumerate(raws) if raw and first + place in IDS[variant]]
                found += [_sighting((variant,), at, "command", Evidence.COMMAND) for at in ids]
    return found


def _feedback_sighting(at: int, variants: tuple[str, ...], data: bytes) -> Sighting:
    if len(data) != _COMMAND.size:
        return _sighting(variants, at, "feedback", Evidence.AGAINST)
    angle_ticks, speed_rpm, _, temperature = _feedback(data)
    if angle_ticks >= TICKS or data[7] != 0 or temperature > HOTTEST:
        return _sighting(variants, at, "feedback", Evidence.AGAINST)
    # A C610 has no sensor and says 0; all others say what the room has at least, unless that freezes.
    able = tuple([one for one in variants if _senses_temperature(one) is (temperature > 0)])
    if not able:
        return _sighting(variants, at, "feedback", Evidence.AGAINST)
    told = () if temperature == 0 else (("temperature", f"{temperature} deg C"),)
    angle, speed = angle_ticks * RAD_PER_TICK, speed_rpm * RAD_S_PER_RPM
    seen = _sighting(able, at, "feedback", Evidence.PROOF)
    return seen._replace(told=told, angle=angle, velocity=speed, turn=tau)


def _sighting(variants: tuple[str, ...], at: int, message: str, evidence: Evidence) -> Sighting:
    """C620 and C610 are numbered together, a GM6020 by itself: by where their feedback begins."""
    return Sighting(NAME, variants, at, message, evidence, numbering=f"0x{FEEDBACK_ID[variants[0]]:X}")


def _senses_temperature(variant: str) -> bool:
    return any([mode.temperature for mode in MODES[variant].values()])


def _nearest(x: float) -> int:
    """`round(x)` of what is far below 2^51, in a fraction of its time when compiled."""
    return int((x + _WHOLE) - _WHOLE)


def _moved_ticks(difference: int, expected: float) -> int:
    """The movement nearest to what the speed promises, among those that end at the angle seen.

    Without a gap the promise is small and this is the shortest way round. After one it is right as long as the mean
    speed of its two ends is within half a turn per gap of the true mean.
    """
    if -HALF_TURN <= expected - difference <= HALF_TURN:  # no turn has ended since, as between most frames
        return difference
    return difference + TICKS * _nearest((expected - difference) / TICKS)
