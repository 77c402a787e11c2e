"""One ODrive axis: what it says, what is asked of it, and the frames to say it with."""

from collections.abc import Callable
from enum import IntEnum, auto
from functools import partial
from math import isfinite, tau
from struct import Struct
from typing import Any, Final

from drivers.checks import feedback_timeout_ns, measuring_hz
from drivers.contract import CanFrame, DriverFault, MotorSpec
from drivers.odrive import tables
from drivers.odrive.firmware import FIRMWARES, error_code, error_words, told_versions
from drivers.odrive.tables import AxisState, Control
from drivers.odrive.watchdog import watchdog_of
from drivers.records import data_frame
from drivers.setpoint import CommandKind
from drivers.twins import CODE as ID_TWIN
from drivers.twins import TwinWatch, twin_fault

REVOLUTION: Final = tau  # rad; the wire counts in revolutions
HEARTBEAT_TIMEOUT_NS: Final = 300_000_000  # three of the default cyclic messages of 100 ms
ESTIMATES_SETTLE_NS: Final = 50_000_000  # an estimate may have waited for the bus while the heartbeat overtook it

_PACK_VELOCITY: Final = tables.COMMON_TO_DEVICE[tables.SET_INPUT_VEL].layout.pack
_PACK_TORQUE: Final = tables.COMMON_TO_DEVICE[tables.SET_INPUT_TORQUE].layout.pack
_VELOCITY: Final = CommandKind.VELOCITY
_TORQUE: Final = CommandKind.TORQUE
_FLOAT: Final = Struct("<f")
_UINT32: Final = Struct("<I")

Take = Callable[[tuple[Any, ...], int], None]


class Step(IntEnum):
    """Where the bring-up of an axis is; what happens in each is the table of odrive_bringup."""

    HEARTBEAT = auto()
    VERSION = auto()
    FIRMWARE = auto()
    CONFIGURE = auto()
    VERIFY = auto()
    READY = auto()
    CLEAR = auto()
    MODE = auto()
    LIMITS = auto()
    ARM = auto()
    ACTIVE = auto()
    RESET = auto()
    ASK_WHY = auto()
    REFUSE = auto()


ARMING: Final = frozenset({Step.CLEAR, Step.MODE, Step.LIMITS, Step.ARM, Step.ACTIVE})
FAILED: Final = frozenset({Step.RESET, Step.ASK_WHY, Step.REFUSE})


class Axis:
    """State of one axis. Received messages change what is known; only odrive_bringup moves on in good times."""

    __slots__ = (
        "_torque_id",
        "_velocity_id",
        "axis_state",
        "booting",
        "bus",
        "closed_ns",
        "configured",
        "control",
        "enable_read",
        "entered_ns",
        "errors",
        "fault",
        "firmware",
        "hardware",
        "heartbeat_ns",
        "heartbeat_until_ns",
        "kind",
        "measured_ns",
        "measured_timeout_ns",
        "measured_until_ns",
        "next_release_ns",
        "position",
        "reasons",
        "result",
        "sent_ns",
        "spec",
        "step",
        "temperature_c",
        "timeout_read",
        "told",
        "torque",
        "torque_ns",
        "twins",
        "velocity",
        "verdict",
        "version",
        "voltage",
        "wanted",
        "watchdog",
        "zero_frame",
    )

    def __init__(self, bus: str, spec: MotorSpec) -> None:
        self.bus = bus
        self.spec = spec
        self.watchdog = watchdog_of(spec)
        self.firmware = FIRMWARES[spec.variant]
        self.measured_timeout_ns = feedback_timeout_ns(spec)
        self._velocity_id = self._id(tables.SET_INPUT_VEL)
        self._torque_id = self._id(tables.SET_INPUT_TORQUE)
        # Both inputs at once: this frame also sets the torque feed-forward, which is the input of torque mode.
        self.zero_frame = self.frame(tables.SET_INPUT_VEL, 0.0, 0.0)

        self.axis_state: int | None = None  # None: not told since it was last asked to change
        self.errors = 0
        self.result = 0
        self.booting = False
        self.closed_ns: int | None = None  # first heartbeat of this closed loop
        self.version: str | None = None
        self.hardware: str | None = None  # told together with the version
        self.timeout_read: float | None = None
        self.enable_read: bool | None = None
        self.reasons: dict[int, int] = {}
        self.heartbeat_ns: int | None = None
        self.heartbeat_until_ns = 0
        self.measured_ns: int | None = None
        self.measured_until_ns = 0
        self.position: float | None = None
        self.velocity: float | None = None
        self.torque: float | None = None
        self.torque_ns: int | None = None
        self.voltage: float | None = None
        self.temperature_c: float | None = None
        self.twins = TwinWatch(spec)

        self.step = Step.HEARTBEAT
        self.entered_ns: int | None = None  # None: entered, but nothing done there yet
        self.sent_ns = 0
        self.next_release_ns = 0
        self.told = 0  # times that this step has sent what nobody confirms
        self.configured = 0  # times the watchdog was written since the last heartbeat gap
        self.kind = CommandKind.COAST
        self.wanted: Control | None = None  # by the host, None: coast
        self.control: Control | None = None  # the same until arming begins; from then on what the axis is armed for
        self.verdict: DriverFault | None = None  # becomes the fault once the controller was asked why
        self.fault: DriverFault | None = None

    def frame(self, command: int, *values: float) -> CanFrame:
        """A message to the controller."""
        return CanFrame(self.bus, self._id(command), self.firmware.to_device[command].layout.pack(*values))

    def request(self, command: int) -> CanFrame:
        """Ask for a message of the controller."""
        return CanFrame(self.bus, self._id(command), b"", remote=True)

    def setpoint(self, kind: CommandKind, value: float, feed_forward: float) -> CanFrame:
        """The setpoint of an armed axis, within its limits; `feed_forward` (N m) goes with a velocity."""
        torque = self.spec.max_torque
        if kind is _VELOCITY:
            limit = self.spec.max_speed
            value = limit if value > limit else -limit if value < -limit else value
            if feed_forward != 0.0:
                feed_forward = torque if feed_forward > torque else -torque if feed_forward < -torque else feed_forward
            return data_frame(self.bus, self._velocity_id, _PACK_VELOCITY(value / REVOLUTION, feed_forward))
        if kind is _TORQUE:
            value = torque if value > torque else -torque if value < -torque else value
            return data_frame(self.bus, self._torque_id, _PACK_TORQUE(value))
        return self.zero_frame

    def limits(self) -> tuple[float, float]:
        """What Set_Limits takes: speed in rev/s and current in A."""
        return self.spec.max_speed / REVOLUTION, self.spec.max_current

    def receivers(self) -> dict[int, tuple[tables.Message, Take]]:
        """Who takes which id; a message without use is taken and dropped."""
        takes: dict[str, Take] = {
            "Heartbeat": self._take_heartbeat,
            "Get_Encoder_Estimates": self._take_estimates,
            "Get_Version": self._take_version,
            "TxSdo": self._take_parameter,
            "Get_Temperature": self._take_temperature,
            "Get_Torques": self._take_torques,
            "Get_Bus_Voltage_Current": self._take_bus,
        }
        reasons: dict[int, Take] = {command: partial(self._take_reason, command) for command in self.firmware.reasons}
        return {
            self._id(command): (message, reasons.get(command) or takes.get(message.name, _drop))
            for command, message in self.firmware.from_device.items()
        }

    def enter(self, step: Step) -> None:
        """Go to a step of the bring-up."""
        if self.step in ARMING and step not in ARMING:
            # An arming still on its way must not win: only a heartbeat from now on says that the axis is idle.
            self.axis_state = None
            self.next_release_ns = 0
        self.step = step
        self.entered_ns = None
        self.told = 0
        if step is Step.HEARTBEAT:
            self.version = self.hardware = None
            self.configured = 0
        if step is Step.VERIFY:
            self.timeout_read = self.enable_read = None
        if step is Step.REFUSE:
            self.fault = self._explained()

    def fail(self, fault: DriverFault) -> None:
        """A fault to be reported at once; the controller is asked for details afterwards."""
        self.judge(fault)
        self.fault = fault
        self.enter(Step.ASK_WHY)

    def judge(self, verdict: DriverFault) -> None:
        """Note a fault that is reported on entering REFUSE, together with the reasons heard until then."""
        self.reasons.clear()
        self.verdict = verdict

    def device_fault(self) -> DriverFault:
        """The error bits of the last heartbeat as a fault."""
        errors = self.firmware.errors
        return DriverFault(error_code(self.errors, errors), error_words(self.errors, errors), latched=True)

    def clear_fault(self) -> None:
        """Forget a fault and have the controller asked to forget its own."""
        if self.fault is not None or self.step in FAILED:
            self.fault = self.verdict = None
            self.twins.forget()
            self.enter(Step.RESET)

    def _id(self, command: int) -> int:
        return self.spec.id << tables.NODE_SHIFT | command

    def _explained(self) -> DriverFault | None:
        if self.verdict is None:
            return self.fault
        firmware = self.firmware
        told = [
            f"{reason.title}: {error_words(self.reasons[command], reason.words)}"
            for command, reason in firmware.reasons.items()
            if self.reasons.get(command)
        ]
        return self.verdict._replace(text="; ".join((self.verdict.text, *told)))

    def _take_heartbeat(self, items: tuple[Any, ...], received_ns: int) -> None:
        errors, axis_state, self.result = self.firmware.heartbeat(items)
        self.heartbeat_ns = received_ns
        self.heartbeat_until_ns = received_ns + HEARTBEAT_TIMEOUT_NS
        self.booting = errors & self.firmware.booting != 0
        self.errors = errors & ~self.firmware.booting
        if self.step not in FAILED:
            self._check(axis_state)
        self.axis_state = axis_state
        if axis_state != AxisState.CLOSED_LOOP:
            self.closed_ns = None
        elif self.closed_ns is None:
            self.closed_ns = received_ns

    def _check(self, axis_state: int) -> None:
        if self.errors == self.firmware.host_silent:
            self._host_was_silent()
        elif self.errors:
            self.fail(self.device_fault())
        elif self.booting:
            self.enter(Step.HEARTBEAT)
        elif self.step is Step.ACTIVE and axis_state != AxisState.CLOSED_LOOP:
            # No error bit: so it is when motor and encoder are unplugged, ODrive issue 700.
            text = f"left CLOSED_LOOP_CONTROL on its own{self.result_words()}"
            self.fail(DriverFault("disarmed", text, latched=True))

    def _host_was_silent(self) -> None:
        """The controller's watchdog did its work: a fault that passes once the host asks for coast.

        The bit itself stays in the controller until the next arming clears it.
        """
        if self.step in ARMING and self.step is not Step.CLEAR:
            self.fault = self.device_fault()._replace(latched=False)
            self.enter(Step.READY)

    def missing(self, now_ns: int) -> str | None:
        """Which of the two cyclic messages is missing while the other arrives, and the setting that turns it on."""
        heartbeat, estimates = now_ns < self.heartbeat_until_ns, now_ns < self.measured_until_ns
        if heartbeat == estimates:
            return None
        if heartbeat:
            name, setting, last_ns = "Get_Encoder_Estimates", self.firmware.estimates_setting, self.measured_ns
            rate_ms = max(1, int(1e3 / measuring_hz(self.spec)))
        else:
            name, setting, last_ns = "Heartbeat", self.firmware.heartbeat_setting, self.heartbeat_ns
            rate_ms = 100
        other = "estimates" if estimates else "heartbeats"
        if last_ns is None:
            return f"{other} arrive, but {name} never came: set {setting} to {rate_ms} (ms) in the controller"
        # What came before is turned on: of a controller that lost its supply the faster message is missed first.
        since = f"has not come for {max(0, now_ns - last_ns) * 1e-9:.2f} s"
        return f"{other} arrive, but {name} {since}: check supply, cable, and that {setting} is {rate_ms} (ms)"

    def result_words(self) -> str:
        """Outcome of the last procedure, where the heartbeat tells one."""
        result = self.firmware.results.get(self.result)
        return "" if result is None else f", procedure result {result}"

    def _take_estimates(self, items: tuple[Any, ...], received_ns: int) -> None:
        position, velocity = items
        if not isfinite(position + velocity):  # two f32 cannot overflow a double, so this asks both
            return
        self.measured_ns = received_ns
        self.measured_until_ns = received_ns + self.measured_timeout_ns
        if self.twins.take(position * REVOLUTION, velocity * REVOLUTION, received_ns):
            self._tell_twins()
        if position == velocity == 0.0 and not self._measures(received_ns):
            self.position = self.velocity = None
            return
        self.position = position * REVOLUTION
        self.velocity = velocity * REVOLUTION

    def _tell_twins(self) -> None:
        """Whatever else was said of the axis is hearsay of one of the two."""
        if self.fault is None or self.fault.code != ID_TWIN:
            self.fail(twin_fault(self.spec, self.bus))

    def _measures(self, now_ns: int) -> bool:
        """Whether an estimate of exactly zero is measured, and no placeholder from before the first closed loop."""
        if not self.firmware.zero_until_closed_loop:
            return True
        closed_ns = self.closed_ns if now_ns < self.heartbeat_until_ns else None
        return closed_ns is not None and now_ns - closed_ns >= ESTIMATES_SETTLE_NS

    def _take_version(self, items: tuple[Any, ...], _received_ns: int) -> None:
        self.version, self.hardware = told_versions(items)

    def _take_parameter(self, items: tuple[Any, ...], _received_ns: int) -> None:
        watchdog = self.watchdog
        if watchdog is None:
            return
        _, endpoint, _, value = items
        if endpoint == watchdog.enable_endpoint:
            self.enable_read = value & 0xFF != 0
        if endpoint == watchdog.timeout_endpoint:
            (self.timeout_read,) = _FLOAT.unpack(_UINT32.pack(value))

    def _take_temperature(self, items: tuple[Any, ...], _received_ns: int) -> None:
        # Inverter and motor; a motor without a sensor may say NaN. The hotter one is what limits the drive.
        self.temperature_c = max(filter(isfinite, items), default=self.temperature_c)

    def _take_torques(self, items: tuple[Any, ...], received_ns: int) -> None:
        if isfinite(items[1]):
            self.torque = items[1]
            self.torque_ns = received_ns

    def _take_bus(self, items: tuple[Any, ...], _received_ns: int) -> None:
        if isfinite(items[0]):
            self.voltage = items[0]

    def _take_reason(self, command: int, items: tuple[Any, ...], _received_ns: int) -> None:
        self.reasons[command] = items[self.firmware.reasons[command].item]


def _drop(_items: tuple[Any, ...], _received_ns: int) -> None:
    pass
