"""What would the core have said with other settings, or with another robot file? Open loop, from recorded inputs.

How this works
--------------
Two cores are given the recorded inputs: one as it was, one changed. Settings are asked for as anybody asks for them, by
requests among the inputs. What the robot would have done with the new commands nobody has recorded: what it measured is
what it measured then, so what is found is how commands change, and not where the robot would have gone.

A core with the recorded robot file takes over the state of the other one where the change begins, and again behind
every gap. A core with another robot file cannot take the state of the recorded one: it is there from cycle 0 on, or,
where that was not recorded, from the first state that fits its robot file; behind a gap it goes on at such a state.
"""

from collections.abc import Iterator, Mapping
from math import isfinite, sqrt
from typing import NamedTuple

from gateway.config import RobotConfig, parse
from gateway.core import settings as known
from gateway.core.channels import Layout, layout_of
from gateway.core.engine import Engine
from gateway.core.frame_words import FrameWords
from gateway.types import Inputs, Outputs, Request, RequestKind
from replay.compare.differences import differing
from replay.compare.replay import CRASHES, Replay
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.reader import Session

OPEN_LOOP = "open loop: what the motors and sensors said is what they said then; a robot would have answered otherwise"
OURS = 1 << 62  # ids of our requests begin here: nobody else counts as far


class WhatIfError(ValueError):
    """A question that cannot be asked of this session; the text says why."""


class Step(NamedTuple):
    """A cycle with both answers. `t`: s since the first recorded cycle."""

    t: float
    cycle: int
    recorded: Outputs
    new: Outputs


class Change(NamedTuple):
    """What becomes of a channel, or of a field of a motor's commands.

    `first_t`: s since the first recorded cycle. `largest` at `largest_t`, and `rms` over all cycles in which both have
    the number (of a command's field: over all cycles), in the unit of the channel; None: it is no number, or one of
    both has none. `cycles`: that differ.
    """

    motor: str | None
    channel: str
    cycles: int
    first_t: float
    last_t: float
    largest: float | None
    largest_t: float | None
    rms: float | None


def settings_of(asked: Mapping[str, float], robot_file: RobotConfig | None, begin: float) -> dict[str, float]:
    """The settings by their names. Raises WhatIfError for a question that no session answers."""
    found = {name.replace(".", "_"): value for name, value in asked.items()}
    problems = known.problems(found)
    if problems:
        raise WhatIfError("; ".join(problems))
    if not found and robot_file is None:
        raise WhatIfError("nothing to change: give a setting or another robot file")
    if not (isfinite(begin) and begin >= 0.0):
        raise WhatIfError(f"begin = {begin:g} s: must be 0 or more since the first recorded cycle")
    return found


class WhatIf:
    """Iterate over `steps`, then look at `changes`. Raises WhatIfError and ConfigError at construction."""

    def __init__(
        self,
        session: Session,
        asked: Mapping[str, float],
        robot_file: RobotConfig | None = None,
        begin: float = 0.0,
    ) -> None:
        self.settings = settings_of(asked, robot_file, begin)
        self.config = parse(session.config_text, "robot file of the session")
        self.new_config = robot_file or self.config
        self.began = "not at all"  # where the changed core has its state from, in words
        self.cycles = 0
        self.unseen = 0
        self._session = session
        self._other_file = robot_file is not None
        self._begin = begin
        self._engine: Engine | None = None
        self._set = False
        self._next = 0
        self._sums = Sums(self.config, self.new_config)

    @property
    def changes(self) -> list[Change]:
        """Of every channel and field that changes, in the order in which they first do."""
        return self._sums.changes()

    def steps(self) -> Iterator[Step]:
        """Every cycle from `begin` on that both cores can be given. Raises WhatIfError."""
        replay = Replay(self.config, self._session.snapshot)
        first_ns = None
        for inputs, _ in self._session.cycles():
            first_ns = inputs.now_ns if first_ns is None else first_ns
            t = (inputs.now_ns - first_ns) * 1e-9
            engine = replay.engine(inputs)
            changed = self._changed(engine, inputs, t)
            if engine is None or changed is None:
                self.unseen += engine is None or t >= self._begin
                if engine is not None:
                    _answer(engine, inputs, "the recorded core")
                continue
            new = _answer(changed, self._asked(inputs, t), "the changed core")
            recorded = _answer(engine, inputs, "the recorded core")
            self._refused(new)
            if t >= self._begin:
                step = Step(t, inputs.cycle, recorded, new)
                self.cycles += 1
                self._sums.add(step)
                yield step
        if not self.cycles:
            raise WhatIfError(f"{self._session.path}: {self._nothing(first_ns is None)}")

    def _nothing(self, empty: bool) -> str:
        if empty:
            return "the session holds no cycles"
        if self._engine is None and self._other_file:
            return "its beginning was not recorded, and no recorded state of the core fits the other robot file"
        return f"nothing can be replayed from {self._begin:g} s on"

    def _changed(self, engine: Engine | None, inputs: Inputs, t: float) -> Engine | None:
        """The core with the change in the state of before this cycle; None: not yet, or nobody knows that state."""
        if self._engine is None or inputs.cycle != self._next:
            self._set = False
            self._engine = self._of_other_file(inputs.cycle) if self._other_file else self._of_same(engine, inputs, t)
        self._next = inputs.cycle + 1
        return self._engine

    def _of_same(self, engine: Engine | None, inputs: Inputs, t: float) -> Engine | None:
        if engine is None or t < self._begin:
            return None
        if not self.cycles:
            self.began = f"with the state of the recorded core in front of cycle {inputs.cycle}"
        return Engine(self.config, engine.snapshot())

    def _of_other_file(self, cycle: int) -> Engine | None:
        if cycle == 0:
            self.began = "at the session's beginning, because no state is taken over from another robot file"
            return Engine(self.new_config)
        state = self._session.snapshot(cycle - 1)
        if state is None:
            return None
        try:
            engine = Engine(self.new_config, state)
        except ValueError:  # a state that does not fit
            return None
        if not self.cycles:
            self.began = f"with the state recorded after cycle {cycle - 1}, which fits the other robot file"
        return engine

    def _asked(self, inputs: Inputs, t: float) -> Inputs:
        """With our requests, in the first cycle that they are for."""
        if self._set or t < self._begin or not self.settings:
            return inputs
        self._set = True
        requests = [
            Request(RequestKind.SET, OURS + place, inputs.now_ns, setting=name, value=value)
            for place, (name, value) in enumerate(self.settings.items())
        ]
        return inputs._replace(requests=(*inputs.requests, *requests))

    def _refused(self, outputs: Outputs) -> None:
        refused = [str(reply.reason) for reply in outputs.replies if reply.id >= OURS and not reply.ok]
        if refused:
            raise WhatIfError("; ".join(refused))


def _answer(engine: Engine, inputs: Inputs, who: str) -> Outputs:
    try:
        return engine.step(inputs)
    except CRASHES as error:
        raise WhatIfError(f"{who} breaks in cycle {inputs.cycle}: {error!r}") from None


class _Sum:
    """Of one channel or field."""

    def __init__(self, t: float) -> None:
        self.cycles = 0
        self.first_t = self.last_t = t
        self.largest: float | None = None
        self.largest_t: float | None = None
        self.squares = 0.0

    def add(self, t: float, before: float | None, after: float | None) -> None:
        self.cycles += 1
        self.last_t = t
        if before is None or after is None:
            return
        size = abs(after - before)
        self.squares += size * size
        if self.largest is None or size > self.largest:
            self.largest, self.largest_t = size, t


class Sums:
    """What differs from step to step, summed up: channels that both robots have, and the fields of their frames."""

    def __init__(self, config: RobotConfig, new: RobotConfig) -> None:
        self._words = FrameWords(config)
        self._motors = set(config.robot.motor_names()) | set(new.robot.motor_names())
        self._layouts: tuple[Layout, Layout] = (layout_of(config), layout_of(new))
        one, other = (layout.labels for layout in self._layouts)
        self._shared = [(label, one.index(label), other.index(label)) for label in one if label in other]
        self._sums: dict[tuple[str | None, str], _Sum] = {}
        self._both: dict[tuple[str | None, str], int] = {}
        self._cycles = 0

    def add(self, step: Step) -> None:
        """One more cycle."""
        self._cycles += 1
        before, after = (
            layout.row(outputs.trace) for layout, outputs in zip(self._layouts, (step.recorded, step.new), strict=True)
        )
        for label, place, other in self._shared:
            key = self._key(label)
            if before[place] is not None and after[other] is not None:
                self._both[key] = self._both.get(key, 0) + 1
            if before[place] != after[other]:
                self._sum(key, step.t).add(step.t, before[place], after[other])
        for one in differing(self._words, RecordedOutputs.of(step.recorded), _without_ours(step.new)):
            self._sum((one.motor, one.field), step.t).add(step.t, one.recorded, one.replayed)

    def _key(self, label: str) -> tuple[str | None, str]:
        channel, _, owner = label.rpartition(".")
        return (owner, channel) if owner in self._motors else (None, label)

    def _sum(self, key: tuple[str | None, str], t: float) -> _Sum:
        return self._sums.setdefault(key, _Sum(t))

    def changes(self) -> list[Change]:
        """Everything that differed, in the order in which it first did."""
        found = [
            Change(
                *key,
                one.cycles,
                one.first_t,
                one.last_t,
                one.largest,
                one.largest_t,
                None if one.largest is None else sqrt(one.squares / self._both.get(key, self._cycles)),
            )
            for key, one in self._sums.items()
        ]
        return sorted(found, key=lambda change: change.first_t)


def _without_ours(outputs: Outputs) -> RecordedOutputs:
    """Without the answers to our requests, which are the last ones of their cycle, and the events that tell of them."""
    replies = tuple(reply for reply in outputs.replies if reply.id < OURS)
    ours = len(outputs.replies) - len(replies)
    told = [place for place, event in enumerate(outputs.events) if event.code == RequestKind.SET.value]
    left_out = told[len(told) - ours :]
    events = tuple(event for place, event in enumerate(outputs.events) if place not in left_out)
    return RecordedOutputs.of(outputs)._replace(replies=replies, events=events)
