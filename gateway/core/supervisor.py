"""The one place that decides the operating mode.

How this works
--------------
Each cycle the engine describes the `Situation`; the first condition that holds in the row of the present mode names
the next mode. Rules that the table must keep, tested cell by cell:
- the emergency stop wins from every mode and is left only by a granted reset, never by the passing of time;
- nothing leads from IDLE to motion but `start`: a fresh zero command, with every motor well; a reset arms nothing;
- whatever goes silent or fails while driving leads through STOPPING or FAULT to rest, and from there to IDLE.
"""

from collections.abc import Callable
from typing import Final

from gateway.types import Mode


class Situation:
    """What the transitions depend on, in words. Nobody changes it.

    No named tuple: compiled, one that is made by the names of its fields takes ten times as long.
    """

    def __init__(  # noqa: PLR0913 - a record, every field by its name
        self,
        *,
        estop: bool = False,  # an emergency stop arrived
        reset: bool = False,  # an explicit reset was granted
        shutdown: bool = False,  # the service wants to end
        blocked: bool = False,  # a fault that leaves some direction undrivable
        latched: bool = False,  # a fault that only a reset may clear
        faulty: bool = False,  # any fault at all
        reduced: bool = False,  # a motor is lost; `blocked` says whether every direction is still reachable
        commanded: bool = False,  # a source is fresh
        start: bool = False,  # in IDLE: a fresh zero command, and no motor to wait for
        armed: bool = False,  # every usable motor obeys
        overdue: bool = False,  # arming takes too long
        rested: bool = False,  # setpoint zero and the wheels stand, or do not report and had their time
    ) -> None:
        self.estop: Final = estop
        self.reset: Final = reset
        self.shutdown: Final = shutdown
        self.blocked: Final = blocked
        self.latched: Final = latched
        self.faulty: Final = faulty
        self.reduced: Final = reduced
        self.commanded: Final = commanded
        self.start: Final = start
        self.armed: Final = armed
        self.overdue: Final = overdue
        self.rested: Final = rested


Condition = Callable[[Situation], bool]


def estop(now: Situation) -> bool:
    return now.estop


def reset(now: Situation) -> bool:
    return now.reset and not now.estop


def blocked(now: Situation) -> bool:
    return now.blocked


def latched(now: Situation) -> bool:
    return now.latched


def startable(now: Situation) -> bool:
    return now.start and not now.blocked and not now.shutdown


def ready(now: Situation) -> bool:
    return now.armed and not now.reduced


def ready_reduced(now: Situation) -> bool:
    return now.armed and now.reduced


def overdue(now: Situation) -> bool:
    return now.overdue


def quiet(now: Situation) -> bool:
    return now.shutdown or not now.commanded


def reduced(now: Situation) -> bool:
    return now.reduced


def resumed(now: Situation) -> bool:
    return not quiet(now) and ready(now)


def resumed_reduced(now: Situation) -> bool:
    return not quiet(now) and ready_reduced(now)


def rested(now: Situation) -> bool:
    return now.rested


def cleared(now: Situation) -> bool:
    return now.rested and not now.faulty


TRANSITIONS: Final[dict[Mode, tuple[tuple[Condition, Mode], ...]]] = {
    Mode.IDLE: ((estop, Mode.ESTOP), (latched, Mode.FAULT), (startable, Mode.STARTING)),
    Mode.STARTING: (
        (estop, Mode.ESTOP),
        (blocked, Mode.FAULT),
        (quiet, Mode.STOPPING),
        (ready, Mode.DRIVE),
        (ready_reduced, Mode.DEGRADED),
        (overdue, Mode.FAULT),
    ),
    Mode.DRIVE: ((estop, Mode.ESTOP), (blocked, Mode.FAULT), (quiet, Mode.STOPPING), (reduced, Mode.DEGRADED)),
    Mode.DEGRADED: ((estop, Mode.ESTOP), (blocked, Mode.FAULT), (quiet, Mode.STOPPING)),
    Mode.STOPPING: (
        (estop, Mode.ESTOP),
        (blocked, Mode.FAULT),
        (resumed, Mode.DRIVE),
        (resumed_reduced, Mode.DEGRADED),
        (rested, Mode.IDLE),
    ),
    Mode.ESTOP: ((reset, Mode.IDLE),),
    Mode.FAULT: ((estop, Mode.ESTOP), (cleared, Mode.IDLE)),
}


def next_mode(mode: Mode, situation: Situation) -> Mode:
    """The mode of this cycle."""
    for condition, successor in TRANSITIONS[mode]:
        if condition(situation):
            return successor
    return mode
