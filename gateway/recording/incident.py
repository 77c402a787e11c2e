"""What an incident is: what somebody would look for afterwards, what stood around it, and what was found in it."""

from collections.abc import Iterator, Sequence

import msgspec

from gateway.recording.packets import Record
from gateway.types import BusEventKind, Level, Mode, RequestKind

MOST_CAUSES = 50  # listed of one incident; more are counted
DEGRADED = "mode_degraded"  # a motor is lost, and the robot drives on
MODE = "mode_"
WATCHED = frozenset({Mode.FAULT, Mode.DEGRADED, Mode.ESTOP})
HIDDEN = "the recording has a gap where it came to this"
# What a bus says of itself until it says something else; the other kinds are things that happen on it.
_STATES = frozenset(set(BusEventKind) - {BusEventKind.TX_DROPPED, BusEventKind.RX_OVERFLOW, BusEventKind.RX_MALFORMED})


class Cause(msgspec.Struct, frozen=True):
    """Why it is kept: code and words of an event or a mark, and its cycle. `wall_ns`: CLOCK_REALTIME of it."""

    cycle: int
    now_ns: int
    wall_ns: int
    code: str
    text: str

    @property
    def name(self) -> str:
        """In a word, for the name of a file."""
        return self.code.removeprefix(MODE)


class BusState(msgspec.Struct, frozen=True):
    """What a bus last said of itself, in which cycle; None: nothing since the recorder began."""

    name: str
    state: str | None = None
    text: str | None = None
    cycle: int | None = None


class Judgement(msgspec.Struct, frozen=True):
    """What came of running its cycles through the core again, in the words of `drivegate replay verify`.

    `cycles`: compared; `unseen`: those to which no state of the core leads; `difference`: the first, in words.
    """

    verdict: str
    cycles: int
    unseen: int
    difference: str | None = None


class Incident(msgspec.Struct, frozen=True):
    """What the header of its file says of it. `more`: causes beyond those that are listed."""

    causes: tuple[Cause, ...]
    more: int = 0
    buses: tuple[BusState, ...] = ()
    judgement: Judgement | None = None


def causes(record: Record) -> Iterator[Cause]:
    """Of one cycle; hardly any has one.

    An event of level error is what stopped the robot: a fault, a bus that is down, an emergency stop. Nothing in the
    first cycle is one: a stop that was kept over a restart is no news.
    """
    inputs, outputs = record.inputs, record.outputs
    if not (outputs.events or inputs.requests) or inputs.cycle == 0:
        return
    told = [(request.kind.value, request.text or "") for request in inputs.requests if request.kind is RequestKind.MARK]
    told += [
        (event.code, event.text) for event in outputs.events if event.level is Level.ERROR or event.code == DEGRADED
    ]
    for code, text in told:
        yield Cause(inputs.cycle, inputs.now_ns, record.timing.wall_ns, code, text)


def hidden(record: Record, before: Mode) -> Iterator[Cause]:
    """What a gap in front of this cycle has hidden; `before`: the mode in front of the gap."""
    mode = record.outputs.mode
    if mode is not before and mode in WATCHED:
        yield Cause(record.inputs.cycle, record.inputs.now_ns, record.timing.wall_ns, f"{MODE}{mode.value}", HIDDEN)


class Buses:
    """What the buses last said of themselves."""

    def __init__(self, names: Sequence[str]) -> None:
        self._states = {name: BusState(name) for name in names}

    def hear(self, record: Record) -> None:
        """What is new in a cycle."""
        for event in record.inputs.bus_events:
            if event.kind in _STATES:
                self._states[event.bus] = BusState(event.bus, event.kind.value, event.text, record.inputs.cycle)

    def states(self) -> tuple[BusState, ...]:
        """As it is now."""
        return tuple(self._states.values())
