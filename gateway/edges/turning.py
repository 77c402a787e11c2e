"""The loop of a procedure that turns motors: it owns the bus, and leaves no motor turning however it ends.

How this works
--------------
A signal, a bus that fails and an exception all end in stop frames and then in frames that release, sent for as long as
the procedure itself asks for, or, where it raised, for `LAST_BRAKE_NS`. What cannot be caught (SIGKILL, a power cut) is
for the controllers' own command timeouts; those that have none hold their last command.
"""

import time
from collections.abc import Callable
from typing import Protocol

from drivers.contract import CanFrame
from gateway.edges.can_bus import BusEdge
from gateway.edges.signals import EndRequest
from gateway.types import BusEventKind

LAST_BRAKE_NS = 40_000_000  # nothing is heard any more, and braking by an old speed may drive
LAST_RELEASES = 5


class Procedure(Protocol):
    """What the loop needs of it."""

    @property
    def finished(self) -> bool: ...

    def step(self, frames: list[CanFrame], now_ns: int) -> list[CanFrame]: ...

    def stop(self, reason: str) -> None: ...

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]: ...

    def coast_frames(self) -> list[CanFrame]: ...


def turn(
    bus: BusEdge,
    procedure: Procedure,
    ending: EndRequest,
    *,
    period_ns: int,
    clock: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Run it to its end. Whatever raises is raised again, once nothing turns any more."""
    try:
        deadline_ns = clock()
        while not procedure.finished:
            now_ns = _wait(deadline_ns, clock, sleep)
            frames, events = bus.receive(now_ns)
            if ending.by is not None:
                procedure.stop(ending.by)
            for event in events:
                if event.kind is BusEventKind.DOWN and not event.text.endswith("is being opened"):
                    procedure.stop(f"{event.bus}: {event.text}")
            bus.send(procedure.step(frames, now_ns), now_ns)
            deadline_ns = max(deadline_ns + period_ns, now_ns)
    finally:
        if not procedure.finished:
            _end(bus, procedure, period_ns, clock, sleep)


def _end(
    bus: BusEdge,
    procedure: Procedure,
    period_ns: int,
    clock: Callable[[], int],
    sleep: Callable[[float], None],
) -> None:
    """Brake, then release, without asking the procedure where it is."""
    now_ns = clock()
    until_ns = now_ns + LAST_BRAKE_NS
    while now_ns < until_ns:
        bus.send(procedure.stop_frames(now_ns=now_ns), now_ns)
        now_ns = _wait(now_ns + period_ns, clock, sleep)
    for _ in range(LAST_RELEASES):
        bus.send(procedure.coast_frames(), now_ns)
        now_ns = _wait(now_ns + period_ns, clock, sleep)


def _wait(deadline_ns: int, clock: Callable[[], int], sleep: Callable[[float], None]) -> int:
    now_ns = clock()
    while now_ns < deadline_ns:
        sleep((deadline_ns - now_ns) * 1e-9)
        now_ns = clock()
    return now_ns
