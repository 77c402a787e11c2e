"""What the core tells the world, and how often: events on change, odometry and status at their rates."""

from collections.abc import Hashable, Mapping, Sequence
from math import floor
from types import MappingProxyType
from typing import Final

from gateway.config import RobotConfig
from gateway.core.health import Fault
from gateway.types import (
    BusEvent,
    BusEventKind,
    Event,
    Inputs,
    Level,
    Mode,
    Refusal,
    Reply,
    Request,
    RequestKind,
    TwistCommand,
)

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_IDLE: Final = Mode.IDLE
_STOPPING: Final = Mode.STOPPING
_ESTOP: Final = Mode.ESTOP

MAX_KINDS: Final = 256  # told apart by the throttle; a robot file has far fewer
REPEAT_NS: Final = 1_000_000_000  # the same event is told at most this often; what was held back is counted
GREETING_NS: Final = 1_000_000_000  # motors that have not answered yet are no news for so long after start
_BUS_LEVELS: Final = {
    BusEventKind.UP: Level.INFO,
    BusEventKind.ERROR_ACTIVE: Level.INFO,
    BusEventKind.DOWN: Level.ERROR,
}
_MODE_LEVELS: Final = {Mode.ESTOP: Level.ERROR, Mode.FAULT: Level.ERROR, Mode.DEGRADED: Level.WARNING}
_REASONS: Final = {
    Mode.IDLE: "waiting for a fresh zero command",
    Mode.STARTING: "arming the motors",
    Mode.ESTOP: "emergency stop: needs a reset",
    Mode.FAULT: "coming to rest",
}
_JUMP: Final = "what it tells changed by more than the robot can turn: not believed"
_NOBODY: Final[Mapping[str, str]] = MappingProxyType({})
_NO_EVENTS: Final[tuple[Event, ...]] = ()


class Due:
    """A rate kept by deadlines, so that it neither drifts nor bursts after a pause."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._next_ns: int | None = None

    def __call__(self, now_ns: int) -> bool:
        """Whether it is time; moves to the next deadline if so."""
        if self._next_ns is not None and now_ns < self._next_ns:
            return False
        start = now_ns if self._next_ns is None else self._next_ns
        self._next_ns = start + self._period_ns * (1 + floor((now_ns - start) / self._period_ns))
        return True


class _Throttle:
    """Lets the first of a kind pass at once and later ones once per REPEAT_NS, with the count of those held back.

    Kinds beyond MAX_KINDS count as one, so that no flood of new kinds takes memory or passes as news.
    """

    def __init__(self) -> None:
        self._seen: dict[Hashable, tuple[int, int]] = {}

    def admit(self, key: Hashable, now_ns: int, weight: int = 1) -> int:
        """How many to tell of now: 0 while held back."""
        if key not in self._seen and len(self._seen) >= MAX_KINDS:
            key = None
        last_ns, held = self._seen.get(key, (now_ns - REPEAT_NS, 0))
        if now_ns - last_ns < REPEAT_NS:
            self._seen[key] = (last_ns, held + weight)
            return 0
        self._seen[key] = (now_ns, 0)
        return held + weight


class Reporter:
    """Turns what changed in a cycle into events, and keeps the counts that the status shows."""

    def __init__(self, config: RobotConfig) -> None:
        self.odometry_due = Due(config.zenoh.odometry_rate)
        self.status_due = Due(config.zenoh.state_rate)
        self.refused = 0
        self.tx_dropped = 0
        self._silent: Mapping[str, str] = {sensor.name: "never heard" for sensor in config.sensor}
        self._sources = frozenset((*(source.name for source in config.commands.source), *self._silent))
        self._throttle = _Throttle()
        self._first_ns: int | None = None
        self._mode = _IDLE
        self._faults: tuple[Fault, ...] = ()
        self._slip: tuple[str, ...] | None = None
        self._overruns = 0
        self._dropped_records = 0

    def events(
        self,
        inputs: Inputs,
        *,
        mode: Mode,
        reason: str | None,
        faults: tuple[Fault, ...],
        replies: Sequence[Reply],
        slip: tuple[str, ...] | None = None,
        silent: Mapping[str, str] = _NOBODY,
        jumped: Sequence[str] = (),
    ) -> tuple[Event, ...]:
        """Everything worth telling of this cycle; usually nothing. `silent`: sensors and why; `jumped`: sensors.

        `slip`: the wheels that slip, none where that is not known; None: no wheel does.
        """
        quiet = (
            mode is self._mode
            and faults is self._faults
            and slip == self._slip
            and silent == self._silent
            and not (inputs.refusals or inputs.bus_events or replies or jumped)
            and inputs.overruns == self._overruns
            and inputs.dropped_records == self._dropped_records
        )
        if quiet:
            return _NO_EVENTS
        now_ns = inputs.now_ns
        if self._first_ns is None:
            self._first_ns = now_ns
        if mode is _IDLE and now_ns - self._first_ns < GREETING_NS:
            faults = ()
        events = [event for refusal in inputs.refusals for event in self._refusal(refusal, now_ns)]
        events += [event for bus_event in inputs.bus_events for event in self._bus(bus_event, now_ns)]
        events += self._counters(inputs)
        events += self._fault_changes(faults, now_ns)
        events += self._slip_change(slip, now_ns)
        events += self._sensor_changes(silent, jumped, now_ns)
        asked = {request.id: request for request in inputs.requests}
        events += [event for reply in replies for event in self._reply(asked[reply.id], reply, now_ns)]
        events += self._mode_change(mode, reason)
        return tuple(events)

    def of_law(self, told: Sequence[Event], now_ns: int) -> list[Event]:
        """What the drive law has to tell of this cycle."""
        return [event for one in told for event in _counted(*one, self._throttle.admit(one.code, now_ns))]

    def _refusal(self, refusal: Refusal, now_ns: int) -> list[Event]:
        self.refused += 1
        source = refusal.source if refusal.source in self._sources else None  # a stranger's name is no kind of its own
        count = self._throttle.admit((source, refusal.code), now_ns)
        return _counted(Level.WARNING, f"refused_{refusal.code.value}", f"{refusal.source}: {refusal.text}", count)

    def _reply(self, request: Request, reply: Reply, now_ns: int) -> list[Event]:
        kind, setting = request.kind.value, request.kind is RequestKind.SET
        # What is asked to be set, and to what, and words are as many kinds as people like to send.
        count = self._throttle.admit((kind, reply.ok, None if setting else reply.reason), now_ns)
        if reply.ok:
            granted = f"{request.setting} = {request.value:g}" if setting else request.text or "granted"
            return _counted(Level.INFO, kind, granted, count)
        return _counted(Level.WARNING, f"{kind}_refused", str(reply.reason), count)

    def _bus(self, event: BusEvent, now_ns: int) -> list[Event]:
        if event.kind is BusEventKind.TX_DROPPED:
            self.tx_dropped += event.occurrences
        count = self._throttle.admit((event.bus, event.kind), now_ns, event.occurrences)
        level = _BUS_LEVELS.get(event.kind, Level.WARNING)
        return _counted(level, f"bus_{event.kind.value}", f"{event.bus}: {event.text}", count)

    def _counters(self, inputs: Inputs) -> list[Event]:
        overruns, self._overruns = inputs.overruns - self._overruns, inputs.overruns
        dropped, self._dropped_records = inputs.dropped_records - self._dropped_records, inputs.dropped_records
        events: list[Event] = []
        if overruns > 0:
            count = self._throttle.admit("overrun", inputs.now_ns, overruns)
            events += _counted(Level.WARNING, "overrun", "the loop missed its deadline", count)
        if dropped > 0:
            count = self._throttle.admit("dropped_records", inputs.now_ns, dropped)
            events += _counted(Level.WARNING, "dropped_records", "the recorder could not keep up", count)
        return events

    def _fault_changes(self, faults: tuple[Fault, ...], now_ns: int) -> list[Event]:
        before = {(fault.kind, fault.subject) for fault in self._faults}
        present = {(fault.kind, fault.subject) for fault in faults}
        new = [fault for fault in faults if (fault.kind, fault.subject) not in before]
        gone = [fault for fault in self._faults if (fault.kind, fault.subject) not in present]
        self._faults = faults
        events: list[Event] = []
        for fault in new:
            count = self._throttle.admit(("fault", fault.kind, fault.subject), now_ns)
            events += _counted(Level.ERROR, f"fault_{fault.kind.value}", str(fault), count)
        for fault in gone:
            count = self._throttle.admit(("cleared", fault.kind, fault.subject), now_ns)
            events += _counted(Level.INFO, f"cleared_{fault.kind.value}", fault.subject, count)
        return events

    def _slip_change(self, slip: tuple[str, ...] | None, now_ns: int) -> list[Event]:
        before, self._slip = self._slip, slip
        if slip == before or (before is not None and slip == ()):
            return []  # that it is no longer known which one is no news
        if slip is None:
            return _counted(Level.INFO, "slip_over", "all wheels grip", self._throttle.admit("slip_over", now_ns))
        text = (
            f"{', '.join(slip)} slip{'s' * (len(slip) == 1)}"
            if slip
            else "the wheels do not fit a rigid motion: one of them slips"
        )
        return _counted(Level.WARNING, "slip", text, self._throttle.admit(("slip", slip), now_ns))

    def _sensor_changes(self, silent: Mapping[str, str], jumped: Sequence[str], now_ns: int) -> list[Event]:
        before, self._silent = self._silent, silent
        lost = [(name, why) for name, why in silent.items() if name not in before]
        events: list[Event] = []
        for told, code, level in (
            (lost, "sensor_silent", Level.WARNING),
            ([(name, "heard") for name in before if name not in silent], "sensor_heard", Level.INFO),
            ([(name, _JUMP) for name in jumped], "sensor_jump", Level.WARNING),
        ):
            for name, text in told:
                events += _counted(level, code, f"{name}: {text}", self._throttle.admit((code, name), now_ns))
        return events

    def _mode_change(self, mode: Mode, reason: str | None) -> list[Event]:
        before, self._mode = self._mode, mode
        if mode is before:
            return []
        text = f"{before.value} -> {mode.value}" + (f": {reason}" if reason else "")
        return [Event(_MODE_LEVELS.get(mode, Level.INFO), f"mode_{mode.value}", text)]


def waiting_for(
    mode: Mode,
    *,
    faults: Sequence[Fault],
    command: TwistCommand | None,
    shutdown: bool,
    unready: str | None = None,
) -> str | None:
    """Why the robot does not drive, in words; None when it does. `unready`: what its drive law waits for."""
    if mode is _STOPPING:
        return "shutting down" if shutdown else "no fresh command" if command is None else "arming was interrupted"
    if faults and mode is not _ESTOP:
        return str(faults[0]) + ("; needs a reset" if faults[0].latched else "")
    if mode is _IDLE and unready is not None:
        return unready
    if mode is _IDLE and command is not None and not command.still:
        return f"waiting for a zero command from {command.source}"
    return _REASONS.get(mode)


def _counted(level: Level, code: str, text: str, count: int) -> list[Event]:
    if count == 0:
        return []
    return [Event(level, code, text if count == 1 else f"{text} ({count} times)")]
