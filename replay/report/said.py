"""What was recorded besides the frames: events, requests, and what each source commanded."""

from collections import Counter
from math import hypot
from typing import NamedTuple

import numpy as np

from gateway.types import Inputs, Reply, TwistCommand
from replay.report.binned import Counts, Stretches
from replay.sessions.cycles import RecordedOutputs

MOST_LINES = 300  # of the log
MOST_SOURCES = 50
OTHERS = "others"
REQUEST = "request"
SILENT_S = 0.5  # a source that says nothing for so long does not command
RESTING, MOVING = 1, 2


class Happened(NamedTuple):
    """Events of a code, or requests of a kind: how many in each stretch."""

    level: str
    code: str
    counts: Counts


class Line(NamedTuple):
    """Of the log: when (s), level, code, words."""

    t: float
    level: str
    code: str
    text: str


class Commander(NamedTuple):
    """What a source asked for: how often, first and last when (s), at most how fast (m/s, rad/s).

    `stretches`: in each RESTING, MOVING, or 0 where it was silent.
    """

    source: str
    commands: int
    t: float
    last_t: float
    speed: float
    turning: float
    stretches: Counts


class Said:
    """Takes cycle after cycle. `lines`: the first of the log, `more` of them are left out; `refused` by who and why."""

    def __init__(self, stretches: Stretches) -> None:
        self.commanders: dict[str, Commander] = {}
        self.refused: Counter[str] = Counter()
        self.lines: list[Line] = []
        self.more = 0
        self._stretches = stretches
        self._counts: dict[tuple[str, str], Counts] = {}

    @property
    def happened(self) -> list[Happened]:
        """Events and requests by code, in the order in which they first came."""
        return [Happened(level, code, counts) for (level, code), counts in self._counts.items()]

    def add(self, t: float, inputs: Inputs, recorded: RecordedOutputs) -> None:
        """The next cycle, t in s."""
        for request in inputs.requests:
            answers = [reply for reply in recorded.replies if reply.id == request.id]
            self._line(Line(t, REQUEST, request.kind.value, _answer(answers[0]) if answers else ""))
        for event in recorded.events:
            self._line(Line(t, event.level.value, event.code, event.text))
        self.refused.update(f"{refusal.source}: {refusal.code.value}" for refusal in inputs.refusals)
        for command in inputs.commands:
            self._command(t, command)

    def _line(self, line: Line) -> None:
        key = line.level, line.code
        if key not in self._counts:
            self._counts[key] = self._silence()
        self._counts[key][self._stretches.place(line.t)] += 1
        if len(self.lines) < MOST_LINES:
            self.lines.append(line)
        else:
            self.more += 1

    def _command(self, t: float, command: TwistCommand) -> None:
        known = command.source in self.commanders or len(self.commanders) < MOST_SOURCES
        source = command.source if known else OTHERS
        before = self.commanders.get(source) or Commander(source, 0, t, t, 0.0, 0.0, self._silence())
        here = self._stretches.place(t)
        if t - before.last_t <= SILENT_S:
            since = slice(self._stretches.place(before.last_t), here)
            before.stretches[since] = np.maximum(before.stretches[since], before.stretches[since.start])
        before.stretches[here] = max(int(before.stretches[here]), RESTING if command.still else MOVING)
        self.commanders[source] = before._replace(
            commands=before.commands + 1,
            last_t=t,
            speed=max(before.speed, hypot(command.twist.vx, command.twist.vy)),
            turning=max(before.turning, abs(command.twist.wz)),
        )

    def _silence(self) -> Counts:
        return np.zeros(self._stretches.size, np.int64)


def _answer(reply: Reply) -> str:
    return "granted" if reply.ok else f"refused: {reply.reason}"
