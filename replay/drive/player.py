"""Recorded frames back onto a bus, with their recorded timing.

How this works
--------------
A received frame is due at its kernel stamp, a sent one at its cycle, both counted from the first frame; every frame
has an absolute deadline, so lateness does not add up. A bus error is an event in a session, never a frame; an id that
no frame can have, as a log converted by other tools may carry for error frames, is left out and counted, because
with its flag cut off it would be a command to somebody.
"""

import gc
import time
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.edges.can_adapter import MAX_EXTENDED_ID, MAX_STANDARD_ID, AdapterError, ask, message_of
from gateway.edges.python_can import can
from replay.sessions.reader import Session

LISTEN_S = 0.3  # ODrive's slowest default message is its heartbeat, every 0.1 s


class Direction(Enum):
    """As the recorded gateway saw it."""

    RX = "rx"  # what the motors said
    TX = "tx"  # what the gateway commanded


class Due(NamedTuple):
    """One frame and when it was on the bus, CLOCK_MONOTONIC of the recording."""

    time_ns: int
    frame: CanFrame


class Played(NamedTuple):
    """What became of the frames, and how far from their deadlines they were handed to the bus."""

    frames: int
    not_frames: int  # left out: no data frame has such an id
    not_sent: int
    problem: str | None  # why the first of them was not sent
    seconds: float
    median_error_us: float
    p99_error_us: float

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return self._asdict()


def recorded_buses(session: Session) -> list[str]:
    """Names of the buses on which anything was recorded."""
    return sorted({frame.bus for inputs, outputs in session.cycles() for frame in (*inputs.frames, *outputs.frames)})


def recorded(session: Session, bus: str, only: Direction | None) -> list[Due]:
    """The frames of one recorded bus in order of time, times never falling. Raises SessionError."""
    frames: list[Due] = []
    last_ns = 0
    for inputs, outputs in session.cycles():
        received = inputs.frames if only is not Direction.TX else ()
        commanded = outputs.frames if only is not Direction.RX else ()
        for time_ns, frame in _dues(inputs.now_ns, received, commanded):
            if frame.bus == bus:
                last_ns = max(last_ns, time_ns)
                frames.append(Due(last_ns, frame))
    return frames


def _dues(now_ns: int, received: Sequence[CanFrame], commanded: Sequence[CanFrame]) -> list[Due]:
    """The frames of a cycle; commands of an imported log have the times at which they were seen, and their order."""
    found = [
        Due(now_ns if frame.received_ns is None else frame.received_ns, frame) for frame in (*received, *commanded)
    ]
    for place, (time_ns, frame) in enumerate(found[len(received) :], start=len(received)):
        found[place] = Due(time_ns, frame._replace(received_ns=None))
    seen = any(frame.received_ns is not None for frame in commanded)
    return sorted(found, key=lambda due: due.time_ns) if seen else found


def is_alive(bus: can.BusABC) -> bool:
    """Whether anybody else sends on the bus. Raises AdapterError."""
    deadline_ns = time.monotonic_ns() + round(LISTEN_S * 1e9)
    while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
        message = ask(bus.recv, left_ns * 1e-9)
        if message is not None and not message.is_error_frame:
            return True
    return False


def play(frames: Sequence[Due], bus: can.BusABC, *, speed: float = 1.0) -> Played:
    """Send every frame at its time; one that the bus refuses is counted, not repeated."""
    playable = [due for due in frames if _is_frame(due.frame)]
    errors_ns: list[int] = []
    problem, not_sent = None, 0
    gc.collect()
    gc.freeze()  # a collection that walks the whole session would be seen in the timing
    started_ns = time.monotonic_ns()
    for deadline_ns, frame in _deadlines(playable, started_ns, speed):
        errors_ns.append(_wait(deadline_ns) - deadline_ns)
        try:
            ask(bus.send, message_of(frame), timeout=0)
        except AdapterError as error:
            not_sent += 1
            problem = problem or str(error)
    seconds = (time.monotonic_ns() - started_ns) * 1e-9
    gc.unfreeze()
    errors_ns.sort()
    return Played(
        frames=len(playable) - not_sent,
        not_frames=len(frames) - len(playable),
        not_sent=not_sent,
        problem=problem,
        seconds=round(seconds, 3),
        median_error_us=_quantile_us(errors_ns, 0.5),
        p99_error_us=_quantile_us(errors_ns, 0.99),
    )


def _deadlines(frames: Sequence[Due], started_ns: int, speed: float) -> Iterator[tuple[int, CanFrame]]:
    for time_ns, frame in frames:
        yield started_ns + round((time_ns - frames[0].time_ns) / speed), frame


def _wait(deadline_ns: int) -> int:
    """Sleep to the deadline; the time at its end."""
    while (now_ns := time.monotonic_ns()) < deadline_ns:
        time.sleep((deadline_ns - now_ns) * 1e-9)
    return now_ns


def _is_frame(frame: CanFrame) -> bool:
    return 0 <= frame.id <= (MAX_EXTENDED_ID if frame.extended else MAX_STANDARD_ID)


def _quantile_us(ordered_ns: Sequence[int], share: float) -> float:
    return round(ordered_ns[int(share * (len(ordered_ns) - 1))] * 1e-3, 1) if ordered_ns else 0.0
