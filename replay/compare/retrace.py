"""What a recording holds cycle by cycle and frame by frame, which its pictures show only at a viewing rate.

The trace is computed again from the recorded inputs by the same core; cycles to which no snapshot leads have none.
"""

from collections.abc import Iterator
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.core.channels import layout_of
from gateway.core.frame_words import FrameWords
from gateway.types import Inputs
from replay.compare.replay import Replay
from replay.sessions.reader import Session

Cell = int | float | str | None


class Told(NamedTuple):
    """A frame in words. `t`: s since the first recorded cycle; `sent`: by the gateway."""

    t: float
    sent: bool
    words: str


def columns(session: Session) -> list[str]:
    """Names of the cells of `rows`; motors in chassis order. Raises ConfigError."""
    return ["cycle", "t", "mode", *layout_of(parse(session.config_text, "robot file of the session")).labels]


def rows(session: Session) -> Iterator[list[Cell]]:
    """One row per cycle that can be replayed, SI, None where something is unknown or released. Raises ConfigError."""
    config = parse(session.config_text, "robot file of the session")
    replay, layout = Replay(config, session.snapshot), layout_of(config)
    first_ns = None
    for inputs, _ in session.cycles():
        first_ns = inputs.now_ns if first_ns is None else first_ns
        engine = replay.engine(inputs)
        if engine is not None:
            outputs = engine.step(inputs)
            t = (inputs.now_ns - first_ns) * 1e-9
            yield [inputs.cycle, t, outputs.mode.value, *layout.row(outputs.trace)]


def frames(session: Session) -> Iterator[Told]:
    """Every recorded frame in words, cycle by cycle, received ones first. Raises ConfigError."""
    words = FrameWords(parse(session.config_text, "robot file of the session"))
    first_ns = None
    for inputs, outputs in session.cycles():
        first_ns = inputs.now_ns if first_ns is None else first_ns
        for sent, group in ((False, inputs.frames), (True, outputs.frames)):
            for frame in group:
                yield Told((_time_ns(frame, inputs) - first_ns) * 1e-9, sent, words.of(frame))


def _time_ns(frame: CanFrame, inputs: Inputs) -> int:
    return inputs.now_ns if frame.received_ns is None else frame.received_ns
