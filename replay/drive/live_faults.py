"""Faults of a simulated robot that runs in real time, while somebody watches. Never of a real one.

How this works
--------------
Whoever gives faults does so from any thread, checked at once; they wait in a queue. The loop, which owns the world,
takes them between two cycles and breaks what is due. Times count from when the loop takes them. What it did it tells in
words, for a mark in the recording: what happens in the world is no input of the core, so nothing else would tell it.
The core counts marks that follow each other too fast instead of telling them: so what it has not told, and what has no
room in one mark, waits for the next, with its age.
"""

import heapq
import re
from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

from gateway.config import ConfigError, RobotConfig
from gateway.core.reporter import REPEAT_NS
from gateway.edges.messages import MAX_WORDS
from gateway.guess import guess
from gateway.types import Event, RequestKind
from replay.drive.breaking import Breaking
from replay.drive.faults import FaultKind
from replay.drive.scenario_file import MAX_SECONDS, At, Fault, Scenario, check_names
from replay.drive.script import ON_THE_COMMAND_LINE, Script, in_words
from replay.sim.bus import SimulatedBus
from replay.sim.plants.contract import PlantName

MAX_WAITING = 256  # faults that are to come, and ends of those that are there
MARKS_APART_NS = round(1.05 * REPEAT_NS)  # a mark is in the core a cycle later, or two
MARK = "simulated: "  # how each begins
NOT_LIVE = {FaultKind.LOOP_PAUSE: "the loop of a robot that runs is paused by stopping its process (SIGSTOP, SIGCONT)"}
LIVE = tuple(kind for kind in FaultKind if kind not in NOT_LIVE)


class _Due(NamedTuple):
    """One beginning, or, with the `names` that it concerns, one end; in order of their times."""

    at_ns: int
    number: int  # what is due at one instant happens in the order in which it was planned
    fault: Fault
    seed: int
    giving: int  # which of all scripts it came with
    names: tuple[str, ...] | None = None


class LiveFaults:
    """`check` and `give` from any thread; `step` from the loop's."""

    def __init__(self, bus: SimulatedBus, config: RobotConfig, plant: PlantName) -> None:
        self._breaking = Breaking(bus, config)
        self._config = config
        self._plant = plant
        self._given: deque[Script] = deque()
        self._due: list[_Due] = []
        self._numbered = 0
        self._givings = 0
        self._untold: list[tuple[int, str]] = []
        self._marked, self._mark = 0, ""  # how many of those are in the mark that was left last, and that mark
        self._left_ns: int | None = None

    def give(self, script: Script, origin: str = ON_THE_COMMAND_LINE) -> None:
        """Leaves it to the loop. Raises ConfigError for what is no fault, or not of this robot: then nothing of it."""
        found = [_not_live(f"at[{place}]", at) for place, at in enumerate(script.at)]
        problems = [problem for problem in found if problem is not None]
        waiting = len(self._due) + sum(len(one.at) for one in list(self._given)) + len(script.at)
        clears = all(at.fault is not None and at.fault.kind is FaultKind.CLEAR for at in script.at)
        if waiting > MAX_WAITING and not clears:
            problems.append(f"{waiting} faults would wait for their time: at most {MAX_WAITING}; `clear` forgets them")
        if problems:
            raise ConfigError(origin, problems)
        asked = Scenario(robot=self._config.robot.name, seconds=MAX_SECONDS, plant=self._plant, at=script.at)
        check_names(asked, self._config, origin)
        self._given.append(script)

    def step(self, now_ns: int, told: Sequence[Event]) -> str | None:
        """What is due by now happens; a mark to be left now, if any. `told`: the events of this cycle."""
        while self._given:
            self._take(self._given.popleft(), now_ns)
        while self._due and self._due[0].at_ns <= now_ns:
            self._untold.append((now_ns, self._happen(heapq.heappop(self._due), now_ns)))
        if any(event.code == RequestKind.MARK.value and event.text.startswith(self._mark) for event in told):
            del self._untold[: self._marked]
            self._marked = 0
        if not self._untold or (self._left_ns is not None and now_ns - self._left_ns < MARKS_APART_NS):
            return None
        self._left_ns = now_ns
        self._marked, self._mark = _in_one_mark(self._untold, now_ns)
        return self._mark

    def _take(self, script: Script, now_ns: int) -> None:
        self._givings += 1
        for at in script.at:
            if at.fault is not None:
                self._plan(now_ns + round(at.t * 1e9), at.fault, seed=script.seed, giving=self._givings)

    def _plan(self, at_ns: int, fault: Fault, *, seed: int, giving: int, names: tuple[str, ...] | None = None) -> None:
        self._numbered += 1
        heapq.heappush(self._due, _Due(at_ns, self._numbered, fault, seed, giving, names))

    def _happen(self, due: _Due, now_ns: int) -> str:
        fault = due.fault
        if due.names is not None:
            self._breaking.end(fault, due.names, now_ns)
            return f"end of {words(fault)}"
        if fault.kind is FaultKind.CLEAR:
            self._forget(fault, due.giving)
        names = self._breaking.begin(fault, now_ns, seed=due.seed + due.number)
        if fault.seconds is not None:
            end_ns = now_ns + round(fault.seconds * 1e9)
            self._plan(end_ns, fault, seed=due.seed, giving=due.giving, names=names)
        return words(fault)

    def _forget(self, clear: Fault, giving: int) -> None:
        """What `clear` mends does not end once more, and nothing of it that was given before is still to come."""
        self._due = [
            due
            for due in self._due
            if (clear.motor is not None and due.fault.motor != clear.motor)
            or (due.names is None and due.giving >= giving)
        ]
        heapq.heapify(self._due)


def _in_one_mark(untold: Sequence[tuple[int, str]], now_ns: int) -> tuple[int, str]:
    """How many of them have room in one mark, and that mark; the first always has."""
    texts = [one if at_ns == now_ns else f"{one} {(now_ns - at_ns) * 1e-9:.2f} s ago" for at_ns, one in untold]
    ends = accumulate(len(text) + len(", ") for text in texts)
    count = max(1, sum(len(MARK) + end - len(", ") <= MAX_WORDS for end in ends))
    return count, (MARK + ", ".join(texts[:count]))[:MAX_WORDS]


def words(fault: Fault) -> str:
    """As on the command line, without its time."""
    seconds = "" if fault.seconds is None else f"+{fault.seconds:g}"
    name = fault.motor or fault.bus or fault.sensor
    value = "" if fault.value is None else f"={fault.value:g}"
    return f"{fault.kind.value}{seconds}{f':{name}' if name else ''}{value}"


def entries_of(said: Sequence[str]) -> list[dict[str, Any]]:
    """What is said on a command line, as entries of a script; without a time it is for now. Raises ConfigError."""
    known = [one.value for one in LIVE]
    kinds = [re.split(r"\W", one, maxsplit=1)[0] for one in said]
    wrong = [f"{kind!r}: must be one of {', '.join(known)}{guess(kind, known)}" for kind in kinds if kind not in known]
    if wrong:
        raise ConfigError(ON_THE_COMMAND_LINE, wrong)
    return [in_words(one, now=True) for one in said]


def _not_live(key: str, at: At) -> str | None:
    """Why this entry cannot be given to a robot that runs; None: it can."""
    if at.fault is None:
        return f"{key}: only a fault can be given while it runs"
    why = NOT_LIVE.get(at.fault.kind)
    return None if why is None else f"{key}.fault.kind = {at.fault.kind.value!r}: {why}"
