"""VESC over CAN (CAN mode "VESC"): speed, torque through the current, voltage through the duty, brake and coast.

How this works
--------------
Ids are extended, `command << 8 | VESC id`, everything is big-endian, and a setpoint is truncated toward zero. There is
no arming. The VESC sends STATUS (speed, current) and STATUS_5 (counter of sixths of an electrical turn, input voltage)
in one group, STATUS_4 (temperatures) in another, at rates that are set in VESC Tool. A motor obeys only while

- STATUS and STATUS_5 arrive: without the input voltage there is no duty for a voltage;
- it answers what is asked of it several times a second, since no status tells it: its fault code, and whether its
  command timeout has expired or its kill switch is on. A VESC forgets a fault within half a second and obeys again, so
  it is this driver that remembers it;
- its command timeout is known to work, where the robot file gives one. It cannot be read, but seen: the driver falls
  silent after one zero current and asks until the VESC says that its timeout has expired. Questions do not feed it.
  One that has not expired in time is too long, off, or fed by somebody else, and is a latched fault. Where the VESC
  brakes when it expires, it does so for some hundredths of a second at the end of the check.

A host that gave no command for longer than that finds a fault that lasts until it asks for coast: the VESC itself would
obey the next command as if nothing had been.

Between two counts the position goes on with the speed, but never beyond the count, so that a slow wheel is seen moving.
"""

from collections.abc import Collection, Sequence
from math import isnan, tau
from struct import Struct
from typing import ClassVar, Final, NamedTuple

from drivers.checks import (
    LONGEST_WATCHDOG_S,
    Bound,
    Option,
    check_bounds,
    check_count,
    check_options,
    check_specs,
    feedback_timeout_ns,
    measuring_hz,
    whole_number,
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
from drivers.records import extended_frame, maker
from drivers.setpoint import CommandKind, MotorCommand
from drivers.sighting import Evidence, Sighting
from drivers.twins import TwinWatch, twin_fault

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_SILENT: Final = MotorState.SILENT
_OPERATIONAL: Final = MotorState.OPERATIONAL
_STARTING: Final = MotorState.STARTING
_IDLE: Final = MotorState.IDLE
_FAULT: Final = MotorState.FAULT
_COAST: Final = CommandKind.COAST
_BRAKE: Final = CommandKind.BRAKE
_VELOCITY: Final = CommandKind.VELOCITY
_TORQUE: Final = CommandKind.TORQUE
_VOLTAGE: Final = CommandKind.VOLTAGE

MS: Final = 1_000_000
IDS: Final = range(127)
ALL: Final = 255
# Each VESC is asked by a host with an id of its own, which its answer goes to: two answers with one id would collide.
HOST_BIT: Final = 0x80
ID_BITS: Final = 8
# Bits 16 to 28 are zero in everything that a VESC sends or obeys.
ID_MASK: Final = 0x1FFF_00FF
ID_AND_HOST_MASK: Final = 0x1FFF_007F
COMMAND_MASK: Final = 0x1FFF_FF00

NAME: Final = "vesc"
PING, PONG = 17, 18
LAST_COMMAND: Final = 0xFF  # bits 28 to 16 of an id are 0
USUAL_POLE_PAIRS: Final = 7  # where no robot file tells them yet

# Layouts, scales and numbers: github vedderb/bldc, documentation/comm_can.md, comm/comm_can.c, comm/commands.c.
SET_DUTY, SET_CURRENT, SET_CURRENT_BRAKE, SET_RPM = 0, 1, 2, 3
PROCESS_SHORT_BUFFER: Final = 8
STATUS, STATUS_4, STATUS_5 = 9, 16, 27
DUTY_SCALE: Final = 1e5
CURRENT_SCALE: Final = 1e3
GET_VALUES_SELECTIVE: Final = 50
TO_BE_ANSWERED, ANSWER = 0, 1
ASK_FAULT: Final = 1 << 15
ASK_STATUS: Final = 1 << 21
TIMED_OUT, KILLED = 1, 2  # bits of what answers ASK_STATUS
COUNTS: Final = 6  # of the tachometer per electrical turn

RELEASED_BELOW: Final = 0.05  # A, firmware default cc_min_current: with less the motor is released
MAX_ERPM: Final = 1e6  # ten times the default limit of the firmware
RPM_PER_RAD_S: Final = 60.0 / tau

ASK_PERIOD_NS: Final = 25 * MS  # the two questions take turns: a fault is there for 500 ms
CHECK_PERIOD_NS: Final = 10 * MS  # of the same while the command timeout is checked
SHORTEST_WATCHDOG_S: Final = 0.05  # so that it is seen before it expires
ANSWER_TIMEOUT_NS: Final = 500 * MS
CHECK_SLACK_NS: Final = 50 * MS  # the firmware looks at its timeout every 10 ms; the rest is for bus and questions
CHECK_PATIENCE_NS: Final = 1000 * MS
CHECK_AGAIN_NS: Final = 1000 * MS  # of silence, in which the settings may have been changed
STATUS_4_HZ: Final = 10.0

_made: Final = maker(MotorFeedback)
_VALUE: Final = Struct(">i")
_QUESTION: Final = Struct(">BBBI")  # who asks, what to do, COMM_GET_VALUES_SELECTIVE, mask
_ANSWER: Final = Struct(">BBBIB")  # VESC id, what it is, COMM_GET_VALUES_SELECTIVE, mask, value
_WRAP: Final = 1 << 32

FAULTS: Final = (
    "NONE",
    *("OVER_VOLTAGE", "UNDER_VOLTAGE", "DRV", "ABS_OVER_CURRENT", "OVER_TEMP_FET", "OVER_TEMP_MOTOR"),
    *("GATE_DRIVER_OVER_VOLTAGE", "GATE_DRIVER_UNDER_VOLTAGE", "MCU_UNDER_VOLTAGE", "BOOTING_FROM_WATCHDOG_RESET"),
    *("ENCODER_SPI", "ENCODER_SINCOS_BELOW_MIN_AMPLITUDE", "ENCODER_SINCOS_ABOVE_MAX_AMPLITUDE", "FLASH_CORRUPTION"),
    *("HIGH_OFFSET_CURRENT_SENSOR_1", "HIGH_OFFSET_CURRENT_SENSOR_2", "HIGH_OFFSET_CURRENT_SENSOR_3"),
    *("UNBALANCED_CURRENTS", "BRK", "RESOLVER_LOT", "RESOLVER_DOS", "RESOLVER_LOS", "FLASH_CORRUPTION_APP_CFG"),
    *("FLASH_CORRUPTION_MC_CFG", "ENCODER_NO_MAGNET", "ENCODER_MAGNET_TOO_STRONG", "PHASE_FILTER", "ENCODER_FAULT"),
    *("LV_OUTPUT_FAULT", "ENCODER_SLIP", "OVERSPEED", "UNDERSPEED", "ABS_OVERSPEED"),
)

OPTIONS: Final[dict[str, Option]] = {
    "pole_pairs": whole_number(1, 100, "pole pairs of the motor: half of its magnets"),
    "min_erpm": whole_number(1, 65535, "the minimum ERPM of the speed loop as set in VESC Tool; below it only brakes"),
}


class Message(NamedTuple):
    """Layout of a message; each item has a name and the number that it was multiplied with."""

    name: str
    layout: Struct
    fields: tuple[tuple[str, float], ...]


SETPOINTS: Final = {
    SET_DUTY: Message("SET_DUTY", _VALUE, (("duty", DUTY_SCALE),)),
    SET_CURRENT: Message("SET_CURRENT", _VALUE, (("current", CURRENT_SCALE),)),
    SET_CURRENT_BRAKE: Message("SET_CURRENT_BRAKE", _VALUE, (("current", CURRENT_SCALE),)),
    SET_RPM: Message("SET_RPM", _VALUE, (("erpm", 1.0),)),
    10: Message("SET_CURRENT_REL", _VALUE, (("share", 1e5),)),
}
STATUSES: Final = {
    STATUS: Message("STATUS", Struct(">ihh"), (("erpm", 1.0), ("current", 10.0), ("duty", 1000.0))),
    STATUS_4: Message(
        "STATUS_4", Struct(">4h"), (("t_fet", 10.0), ("t_motor", 10.0), ("i_in", 10.0), ("pid_pos", 50.0))
    ),
    STATUS_5: Message("STATUS_5", Struct(">ihxx"), (("tacho", 1.0), ("v_in", 10.0))),
}
ANSWERS: Final = {ASK_FAULT: "fault", ASK_STATUS: "status"}

_status: Final = STATUSES[STATUS].layout.unpack_from
_status_4: Final = STATUSES[STATUS_4].layout.unpack_from
_status_5: Final = STATUSES[STATUS_5].layout.unpack_from
STATUS_SIZE: Final = 8

EXPIRED: Final = DriverFault("host_silent", "no command for longer than its command timeout", latched=False)
KILL_SWITCH: Final = DriverFault("kill_switch", "its kill switch is on", latched=False)
LEAST_SUPPLY: Final = (
    0.5  # of the voltage in the robot file: with less told, a duty would be far too much if it is wrong
)
NO_VOLTAGE: Final = DriverFault(
    "no_voltage", "tells an input voltage of 0 V, or of less than half the supply, so no duty is sure", latched=False
)
UNSEEN: Final = DriverFault(
    "watchdog_unverified", "did not tell whether its command timeout expires: firmware too old?", latched=False
)


class _Motor:
    """What is known of one VESC, and what it is told."""

    __slots__ = (
        "answered_ns",
        "answered_until_ns",
        "bus",
        "check_begun_ns",
        "check_failed",
        "checked",
        "coast_frame",
        "commanded_ns",
        "current_limit",
        "duty_zero_frame",
        "erpm",
        "erpm_limit",
        "erpm_per_rad_s",
        "fault",
        "heard_ns",
        "kind",
        "least_voltage",
        "min_erpm",
        "next_question_ns",
        "position",
        "questions",
        "rad_per_count",
        "ran",
        "raw_current",
        "raw_per_torque",
        "spec",
        "status_5_ns",
        "status_5_until_ns",
        "status_bits",
        "status_ns",
        "status_until_ns",
        "stop_frame",
        "tacho",
        "temperature_c",
        "timeout_ns",
        "turned_counts",
        "twins",
        "voltage",
        "watchdog_ns",
    )

    def __init__(self, bus: str, spec: MotorSpec) -> None:
        pole_pairs = int(spec.options["pole_pairs"])
        self.bus = bus
        self.spec = spec
        self.min_erpm = int(spec.options["min_erpm"])
        self.erpm_per_rad_s = RPM_PER_RAD_S * pole_pairs
        self.erpm_limit = int(spec.max_speed * self.erpm_per_rad_s)
        self.rad_per_count = tau / (COUNTS * pole_pairs)
        self.current_limit = int(spec.max_current * CURRENT_SCALE)
        self.raw_per_torque = CURRENT_SCALE * spec.max_current / spec.max_torque
        self.timeout_ns = feedback_timeout_ns(spec)
        self.watchdog_ns = None if spec.watchdog_s is None else int(spec.watchdog_s * 1e9)
        self.coast_frame = self._frame(SET_CURRENT, 0)
        self.stop_frame = self._frame(SET_CURRENT_BRAKE, self.current_limit)
        self.duty_zero_frame = self._frame(SET_DUTY, 0)

        self.status_ns: int | None = None
        self.status_until_ns = 0
        self.erpm: int | None = None
        self.raw_current: int | None = None  # tenths of A
        self.status_5_ns: int | None = None
        self.status_5_until_ns = 0
        self.tacho = 0
        self.turned_counts = 0
        self.position: float | None = None
        self.voltage: float | None = None
        self.least_voltage = LEAST_SUPPLY * (spec.supply or 0.0)
        self.temperature_c: float | None = None
        self.twins = TwinWatch(spec)

        self.questions = 0
        self.next_question_ns = 0
        self.answered_ns: int | None = None  # of the fault code
        self.answered_until_ns = 0
        self.status_bits = 0

        self.kind = _COAST
        self.commanded_ns: int | None = None
        self.heard_ns = 0  # when it last was, as far as a command was given since
        self.checked = self.watchdog_ns is None
        self.check_begun_ns: int | None = None
        self.check_failed = False  # for now; it goes on
        self.ran = False  # its timeout was seen not expired since the check began
        self.fault: DriverFault | None = None

    # -- what it says -------------------------------------------------------------------------------------------------

    def take_status(self, data: bytes, received_ns: int) -> None:
        """Speed and current."""
        self.erpm, self.raw_current, _ = _status(data)
        self.status_ns = received_ns
        self.status_until_ns = received_ns + self.timeout_ns

    def take_status_4(self, data: bytes, _received_ns: int) -> None:
        """Temperatures of bridge and motor; the hotter one is what limits the drive."""
        t_fet, t_motor, _, _ = _status_4(data)
        self.temperature_c = max(t_fet, t_motor) / 10.0

    def take_status_5(self, data: bytes, received_ns: int) -> None:
        """Position and input voltage."""
        tacho, v_in = _status_5(data)
        velocity = 0.0 if self.erpm is None else self.erpm / self.erpm_per_rad_s
        if self.status_5_ns is None or self.position is None:
            self.turned_counts = tacho
            self.position = tacho * self.rad_per_count
        else:
            half = _WRAP // 2
            self.turned_counts += (tacho - self.tacho + half) % _WRAP - half
            low = self.turned_counts * self.rad_per_count
            gone = self.position + velocity * (received_ns - self.status_5_ns) * 1e-9
            self.position = max(low, min(low + self.rad_per_count, gone))
        self.tacho = tacho
        self.voltage = v_in / 10.0
        self.status_5_ns = received_ns
        self.status_5_until_ns = received_ns + self.timeout_ns
        twins = self.twins.take(self.turned_counts * self.rad_per_count, velocity, received_ns)
        if twins and (self.fault is None or not self.fault.latched):
            self.fault = twin_fault(self.spec, self.bus)

    def take_answer(self, mask: int, value: int, received_ns: int) -> None:
        """What it was asked for."""
        if mask == ASK_STATUS:
            self._take_status_bits(value, received_ns)
            return
        self.answered_ns = received_ns
        self.answered_until_ns = received_ns + ANSWER_TIMEOUT_NS
        if value and (self.fault is None or not self.fault.latched):
            word = FAULTS[value] if value < len(FAULTS) else "not known here"
            self.fault = DriverFault("device_error", f"fault {value}, {word}", latched=True)

    def _take_status_bits(self, bits: int, received_ns: int) -> None:
        self.status_bits = bits
        if bits & KILLED and self.fault is None:
            self.fault = KILL_SWITCH
        if not self.checked:
            self._check(bits & TIMED_OUT != 0, received_ns)

    def _check(self, timed_out: bool, received_ns: int) -> None:
        begun_ns, watchdog_ns = self.check_begun_ns, self.watchdog_ns
        if begun_ns is None or watchdog_ns is None or received_ns < begun_ns:
            return
        if timed_out:
            self.checked = self.ran  # before it ran this is of the time before the check
            self.check_failed = self.check_failed and not self.checked
            return
        self.ran = True
        waited_ns = received_ns - begun_ns
        if waited_ns > watchdog_ns + CHECK_SLACK_NS and (self.fault is None or not self.fault.latched):
            text = (
                f"its command timeout has not expired {waited_ns * 1e-9:.2f} s after the last command: it must be "
                f"{watchdog_ns / 1e6:g} ms, and nobody else may command it"
            )
            self.fault = DriverFault("watchdog_unverified", text, latched=True)

    # -- what it is told ----------------------------------------------------------------------------------------------

    def told(self, command: MotorCommand, now_ns: int) -> list[CanFrame]:
        """The frames of this cycle: a question if it is time for one, and one setpoint; none while the check waits."""
        self._accept(command, now_ns)
        frames: list[CanFrame] = []
        if now_ns >= self.next_question_ns:
            frames.append(self._question(now_ns))
        if not self.heard(now_ns):
            if now_ns - self.heard_ns >= CHECK_AGAIN_NS or not self.checked:
                self._forget_check()
            frames.append(self.coast_frame)
            return frames
        self.heard_ns = now_ns
        if not self.checked and (self.fault is None or not self.fault.latched):
            if self._check_begins(now_ns):
                frames.append(self.coast_frame)
            return frames
        frames.append(self._setpoint(command.kind, command.value) if self.obeys(now_ns) else self.coast_frame)
        return frames

    def _accept(self, command: MotorCommand, now_ns: int) -> None:
        before_ns, self.commanded_ns = self.commanded_ns, now_ns
        late = before_ns is not None and self.watchdog_ns is not None and now_ns - before_ns >= self.watchdog_ns
        if late and self.kind is not _COAST and self.fault is None and self.checked:
            self.fault = EXPIRED
        self.kind = command.kind
        if self.kind is _COAST and self.fault is not None and not self.fault.latched:
            self.fault = KILL_SWITCH if self.status_bits & KILLED else None

    def _question(self, now_ns: int) -> CanFrame:
        self.next_question_ns = now_ns + (ASK_PERIOD_NS if self.checked else CHECK_PERIOD_NS)
        self.questions += 1
        mask = ASK_FAULT if self.questions & 1 else ASK_STATUS
        data = _QUESTION.pack(HOST_BIT | self.spec.id, TO_BE_ANSWERED, GET_VALUES_SELECTIVE, mask)
        return extended_frame(self.bus, PROCESS_SHORT_BUFFER << ID_BITS | self.spec.id, data)

    def _check_begins(self, now_ns: int) -> bool:
        """Whether the check of the command timeout begins in this cycle; one without an outcome begins again."""
        begun_ns, watchdog_ns = self.check_begun_ns, self.watchdog_ns or 0
        if begun_ns is not None and now_ns - begun_ns < watchdog_ns + CHECK_PATIENCE_NS:
            return False
        self.check_failed = begun_ns is not None
        self.check_begun_ns = now_ns
        self.ran = False
        return True

    def _forget_check(self) -> None:
        self.checked = self.watchdog_ns is None
        self.check_begun_ns = None
        self.check_failed = False

    def _setpoint(self, kind: CommandKind, value: float) -> CanFrame:
        if kind is _VELOCITY:
            erpm = _truncated(value * self.erpm_per_rad_s, self.erpm_limit)
            # Below its minimum a VESC would not start a released motor, but brake a running one with a duty of 0.
            return self.duty_zero_frame if -self.min_erpm < erpm < self.min_erpm else self._frame(SET_RPM, erpm)
        if kind is _TORQUE:
            return self._frame(SET_CURRENT, _truncated(value * self.raw_per_torque, self.current_limit))
        if kind is _VOLTAGE and self.voltage is not None and self.voltage > self.least_voltage:
            return self._frame(SET_DUTY, _truncated(value / self.voltage * DUTY_SCALE, int(DUTY_SCALE)))
        return self.stop_frame if kind is _BRAKE else self.coast_frame

    def _frame(self, command: int, value: int) -> CanFrame:
        return extended_frame(self.bus, command << ID_BITS | self.spec.id, _VALUE.pack(value))

    def clear_fault(self) -> None:
        """Forget a fault; the VESC forgets its own by itself."""
        if self.fault is not None:
            self.fault = None
            self.twins.forget()
            if not self.checked:
                self._forget_check()

    # -- what is known of it ------------------------------------------------------------------------------------------

    def measured(self, now_ns: int) -> bool:
        """Whether both of its measurements arrive."""
        return now_ns < self.status_until_ns and now_ns < self.status_5_until_ns

    def heard(self, now_ns: int) -> bool:
        """Whether it measures and answers."""
        return now_ns < self.answered_until_ns and self.measured(now_ns)

    def obeys(self, now_ns: int) -> bool:
        """Whether it may be given a setpoint, if its command timeout is not being checked."""
        return self.heard(now_ns) and self.problem() is None

    def problem(self) -> DriverFault | None:
        """Why it may not, if it is heard."""
        if self.fault is not None:
            return self.fault
        if self.kind is _VOLTAGE and self.voltage is not None and self.voltage <= self.least_voltage:
            return NO_VOLTAGE
        return UNSEEN if self.check_failed else None

    def feedback(self, now_ns: int) -> MotorFeedback:
        """Measurement and state."""
        measured_ns = None
        if self.status_ns is not None and self.status_5_ns is not None:
            measured_ns = min(self.status_ns, self.status_5_ns)
        return _made(
            (
                self._state(now_ns),
                self.position,
                None if self.erpm is None else self.erpm / self.erpm_per_rad_s,
                None if self.raw_current is None else self.raw_current / 10.0 * CURRENT_SCALE / self.raw_per_torque,
                self.voltage,
                self.temperature_c,
                self.problem(),
                None if measured_ns is None else max(0, now_ns - measured_ns),
                self._missing(now_ns),
                None if self.status_ns is None else max(0, now_ns - self.status_ns),
            )
        )

    def _state(self, now_ns: int) -> MotorState:
        if not self.measured(now_ns):
            return _SILENT
        if self.problem() is not None:
            return _FAULT
        if now_ns >= self.answered_until_ns:
            return _SILENT
        if not self.checked:
            return _STARTING
        return _IDLE if self.kind is _COAST else _OPERATIONAL

    def _missing(self, now_ns: int) -> str | None:
        """What does not arrive while something else does, and the setting that turns it on."""
        status, status_5 = now_ns < self.status_until_ns, now_ns < self.status_5_until_ns
        if not status and not status_5:
            return None
        if status and status_5:
            if now_ns < self.answered_until_ns:
                return None
            since = _since(self.answered_ns, now_ns)
            return (
                f"STATUS arrives, but an answer to what it is asked {since}: CAN Mode must be VESC, firmware 6 or newer"
            )
        here, missing, last_ns = ("STATUS", "STATUS_5", self.status_5_ns)
        if status_5:
            here, missing, last_ns = ("STATUS_5", "STATUS", self.status_ns)
        rate = f"{measuring_hz(self.spec):g} Hz"
        return f"{here} arrives, but {missing} {_since(last_ns, now_ns)}: turn it on in CAN Status Messages, {rate}"


class VescDriver:
    """The VESCs of one bus."""

    __slots__ = ("_bus", "_by_id", "_coast_frames", "_motors", "_stop_frames", "_takes")

    variants: ClassVar[tuple[str, ...]] = ("vesc",)
    words: ClassVar[tuple[str, ...]] = FAULTS

    def __init__(self, bus: str, motors: Sequence[MotorSpec]) -> None:
        check_specs(motors, driver="vesc", variants=self.variants, ids=IDS)
        for motor in motors:
            check_options(motor, OPTIONS, of="driver vesc")
            check_bounds(motor, _bounds(motor))
        self._bus = bus
        self._motors = tuple(_Motor(bus, motor) for motor in motors)
        self._by_id = {motor.spec.id: motor for motor in self._motors}
        self._takes = {
            command << ID_BITS | motor.spec.id: take
            for motor in self._motors
            for command, take in (
                (STATUS, motor.take_status),
                (STATUS_4, motor.take_status_4),
                (STATUS_5, motor.take_status_5),
            )
        }
        self._coast_frames = [motor.coast_frame for motor in self._motors]
        self._stop_frames = [motor.stop_frame for motor in self._motors]

    @staticmethod
    def sighted(frame: CanFrame) -> list[Sighting]:
        """What this frame is to a VESC."""
        found = _sighted(frame)
        return [] if found is None else [found]

    @staticmethod
    def questions(bus: str, heard: Collection[int]) -> list[CanFrame]:
        """A ping to every id that one can have here, since new ones send no status. It feeds no timeout."""
        me = HOST_BIT  # no VESC of ours has this id
        return [extended_frame(bus, PING << ID_BITS | at, bytes([me])) for at in IDS]

    @staticmethod
    def renaming(variant: str) -> Renaming:
        """By VESC Tool: of the frames that a CAN bus has for it none changes an id alone."""
        return Renaming(IDS, _by_tool)

    @property
    def capabilities(self) -> tuple[Capabilities, ...]:
        """All but a feed-forward and a limit: the speed loop of a VESC takes neither."""
        able = Capabilities(velocity=True, torque=True, voltage=True, brake=True, device_watchdog=True)
        return tuple([able._replace(least_speed=motor.min_erpm / motor.erpm_per_rad_s) for motor in self._motors])

    def receive(self, frame: CanFrame) -> bool:
        """Take one received frame; True when it was ours."""
        bus, identifier, data, extended, remote, received_ns, fd, _ = frame
        if not extended or received_ns is None or remote or fd or bus != self._bus or len(data) != STATUS_SIZE:
            return False
        take = self._takes.get(identifier)
        if take is not None:
            take(data, received_ns)
            return True
        answer = self._answer(identifier, data)
        if answer is None:
            return False
        motor, mask, value = answer
        motor.take_answer(mask, value, received_ns)
        return True

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        """One setpoint per VESC and some questions; nothing but questions to one whose timeout is being checked."""
        check_count(commands, self._motors)
        for motor, command in zip(self._motors, commands):
            if isnan(command.value) or command.feed_forward != 0.0 or command.limit is not None:
                allowed = "a velocity, torque or voltage, brake or coast; no feed_forward and no limit"
                raise ValueError(f"motor {motor.spec.name}: {command}: must be {allowed}")
        frames: list[CanFrame] = []
        for motor, command in zip(self._motors, commands):
            frames += motor.told(command, now_ns)
        return frames

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        """The latest measurement and state of each motor."""
        return [motor.feedback(now_ns) for motor in self._motors]

    def clear_faults(self) -> None:
        """Forget latched faults, and check a command timeout anew that was found wrong."""
        for motor in self._motors:
            motor.clear_fault()

    def coast_frames(self) -> list[CanFrame]:
        """Current 0 for every motor."""
        return list(self._coast_frames)

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        """All the current that is allowed, against the motion: the VESC itself knows which way it turns."""
        return list(self._stop_frames)

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A sent or received frame in words, or None when it is not of these motors or not of its length."""
        if frame.bus != self._bus or not frame.extended or frame.remote or frame.fd:
            return None
        answer = self._answer(frame.id, frame.data) if len(frame.data) == _ANSWER.size else None
        if answer is not None:
            motor, mask, value = answer
            return DecodedFrame(motor.spec.name, "GET_VALUES_SELECTIVE", ((ANSWERS[mask], value),))
        return self._decoded(frame)

    def _decoded(self, frame: CanFrame) -> DecodedFrame | None:
        """What goes to a VESC or is sent by it under its own id."""
        motor, command = self._by_id.get(frame.id & ~COMMAND_MASK), frame.id >> ID_BITS
        if motor is None:
            return None
        if command == PROCESS_SHORT_BUFFER:
            return _decoded_question(motor.spec.name, frame.data)
        message = STATUSES.get(command) or SETPOINTS.get(command)
        if message is None or len(frame.data) != message.layout.size:
            return None
        items = zip(message.fields, message.layout.unpack(frame.data), strict=True)
        fields = tuple((name, raw if scale == 1.0 else raw / scale) for (name, scale), raw in items)
        return DecodedFrame(motor.spec.name, message.name, fields)

    def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
        """Setpoint, question and answer, and the status messages of each motor."""
        traffic: list[Traffic] = []
        for motor in self._motors:
            name, rate, asked = motor.spec.name, measuring_hz(motor.spec), 1e9 / ASK_PERIOD_NS
            traffic += (
                Traffic(f"{name} setpoint", extended=True, length=_VALUE.size, rate_hz=loop_rate_hz),
                Traffic(f"{name} question", extended=True, length=_QUESTION.size, rate_hz=min(asked, loop_rate_hz)),
                Traffic(f"{name} answer", extended=True, length=_ANSWER.size, rate_hz=min(asked, loop_rate_hz)),
                Traffic(f"{name} STATUS", extended=True, length=STATUS_SIZE, rate_hz=rate),
                Traffic(f"{name} STATUS_5", extended=True, length=STATUS_SIZE, rate_hz=rate),
                Traffic(f"{name} STATUS_4", extended=True, length=STATUS_SIZE, rate_hz=STATUS_4_HZ),
            )
        return tuple(traffic)

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """Everything under the ids of these motors, and the answers, which have the id of who asked."""
        own = [ReceiveFilter(at, ID_MASK, extended=True) for at in self._by_id]
        return (*own, ReceiveFilter(PROCESS_SHORT_BUFFER << ID_BITS, COMMAND_MASK, extended=True))

    def ids(self) -> tuple[IdUse, ...]:
        """Every command to each VESC, to the host that asks it, and to all of them."""
        own = [
            IdUse(f"vesc {at} of motor {motor.spec.name} and who asks it", at, ID_AND_HOST_MASK, extended=True)
            for at, motor in self._by_id.items()
        ]
        answers = IdUse("vesc answers", PROCESS_SHORT_BUFFER << ID_BITS, COMMAND_MASK, extended=True)
        return (*own, IdUse("vesc commands to all", ALL, ID_MASK, extended=True), answers)

    def _answer(self, identifier: int, data: bytes) -> tuple[_Motor, int, int] | None:
        """Whose answer to which question this is, and its value; also one that another host asked."""
        if identifier >> ID_BITS != PROCESS_SHORT_BUFFER:
            return None
        at, what, packet, mask, value = _ANSWER.unpack(data)
        motor = self._by_id.get(at)
        if motor is None or (what, packet) != (ANSWER, GET_VALUES_SELECTIVE) or mask not in ANSWERS:
            return None
        return motor, mask, value


def _by_tool(at: int) -> tuple[str, ...]:
    """What a person does for this id; vesc_tool res/config, APPCONF_CONTROLLER_ID.

    Over CAN a whole application configuration could be sent (COMM_SET_APPCONF), which each firmware lays out anew.
    """
    return (
        "connect the VESC by USB and start VESC Tool",
        f"App Settings, General: VESC ID = {at}; CAN Status Messages and their rate are there too",
        "write the app configuration: the VESC keeps it",
    )


def _bounds(motor: MotorSpec) -> list[Bound]:
    """What fits between the minimum and the maximum of a VESC."""
    least, per = int(motor.options["min_erpm"]), RPM_PER_RAD_S * int(motor.options["pole_pairs"])
    slow = f"from min_erpm = {least} up to {MAX_ERPM:g} ERPM at these pole pairs"
    release = f"with less than {RELEASED_BELOW:g} A a VESC releases its motor"
    bounds = [
        Bound("max_speed", motor.max_speed, least / per, MAX_ERPM / per, "rad/s at the motor shaft", slow),
        Bound("max_current", motor.max_current, RELEASED_BELOW, 1e6, "A", release),
    ]
    if motor.watchdog_s is not None:
        seen = "a shorter one cannot be seen to expire"
        bounds.append(Bound("watchdog.timeout", motor.watchdog_s, SHORTEST_WATCHDOG_S, LONGEST_WATCHDOG_S, "s", seen))
    return bounds


def _sighted(frame: CanFrame) -> Sighting | None:
    if not frame.extended or frame.remote or frame.fd or frame.id >> ID_BITS > LAST_COMMAND:
        return None
    command, at, data = frame.id >> ID_BITS, frame.id & 0xFF, frame.data
    if command == PONG:
        # To whoever pinged; who answers is in the data, in newer firmware with its kind of hardware.
        return _sighting(data[0], "PONG", Evidence.PROOF) if data and data[0] in IDS else None
    if command == PROCESS_SHORT_BUFFER:
        return _sighted_answer(at, data)
    if command in SETPOINTS and at in IDS:
        return _sighting(at, SETPOINTS[command].name, Evidence.COMMAND)
    return _sighted_status(at, STATUSES[command], data) if command in STATUSES and at in IDS else None


def _sighted_status(at: int, message: Message, data: bytes) -> Sighting:
    if len(data) != STATUS_SIZE:
        return _sighting(at, message.name, Evidence.AGAINST)
    items = message.layout.unpack(data)
    if message is STATUSES[STATUS_5]:
        angle = items[0] * tau / (COUNTS * USUAL_POLE_PAIRS)
        return _sighting(at, message.name, Evidence.PROOF, (("voltage", f"{items[1] / 10.0:.1f} V"),), angle)
    told: tuple[tuple[str, str], ...] = ()
    if message is STATUSES[STATUS_4]:
        told = (("temperature", f"{max(items[0], items[1]) / 10.0:.1f} deg C"),)
    return _sighting(at, message.name, Evidence.PROOF, told)


def _sighting(
    at: int, message: str, evidence: Evidence, told: tuple[tuple[str, str], ...] = (), angle: float | None = None
) -> Sighting:
    return Sighting(NAME, (NAME,), at, message, evidence, told, angle, None if angle is None else 0.0)


def _sighted_answer(at: int, data: bytes) -> Sighting | None:
    if len(data) == _QUESTION.size:
        return _sighting(at, "GET_VALUES_SELECTIVE request", Evidence.TALK) if at in IDS else None
    if len(data) != _ANSWER.size:
        return None
    who, what, packet, mask, value = _ANSWER.unpack(data)
    if who not in IDS or (what, packet) != (ANSWER, GET_VALUES_SELECTIVE):
        return None
    told: tuple[tuple[str, str], ...] = ()
    if mask == ASK_FAULT:
        told = (("error", FAULTS[value] if 0 < value < len(FAULTS) else "" if value == 0 else f"fault {value}"),)
    return _sighting(who, "GET_VALUES_SELECTIVE", Evidence.PROOF, told)


def _decoded_question(name: str, data: bytes) -> DecodedFrame | None:
    if len(data) != _QUESTION.size:
        return None
    host, what, packet, mask = _QUESTION.unpack(data)
    if (what, packet) != (TO_BE_ANSWERED, GET_VALUES_SELECTIVE):
        return None
    return DecodedFrame(name, "GET_VALUES_SELECTIVE request", (("host", host), ("mask", mask)))


def _truncated(value: float, limit: int) -> int:
    """Toward zero, as a VESC does itself."""
    return limit if value >= limit else -limit if value <= -limit else int(value)


def _since(last_ns: int | None, now_ns: int) -> str:
    return "never came" if last_ns is None else f"has not come for {max(0, now_ns - last_ns) * 1e-9:.2f} s"
