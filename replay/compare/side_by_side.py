"""The comparison of a whole session in several processes, each stretch between two snapshots of the core on its own.

How this works
--------------
A stretch begins with the recorded state of the core; the single pass would begin it with the state that the stretch
before has led to. These are the same if both are the same bytes, packed, which is compared as well: then equal
stretches are an equal drive. Nothing but that is found here. Whatever is not plainly equal (a difference, a snapshot
that is refused or not what led to it, cycles out of order, a process that died) is for the single pass to look at.
"""

import gc
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from threading import Thread
from typing import NamedTuple

import numpy as np

from gateway.config import RobotConfig, parse
from replay.compare.replay import CRASHES, Replay, same
from replay.sessions.cycles import CycleRows, Seen, made
from replay.sessions.reader import Session, Stretch, packed

AHEAD = 32  # stretches that wait in memory for a process, or for their turn: at 1 kHz some 2 MB each


class Compared(NamedTuple):
    """How much was compared: cycles, frames sent in them, the time that they cover; and cycles that could not be."""

    cycles: int
    frames: int
    unseen: int
    covered_ns: int


class Confirmed(NamedTuple):
    """What was compared of a session, all of it equal, and the session, read whole."""

    session: Session
    compared: Compared


class _Tally(NamedTuple):
    """Of a stretch that is equal: what is there of it, and how it fits to its neighbours.

    `first_ns`, `last_ns`: times of its first and last cycle. `state`: of the core at its end, packed. None: no core.
    """

    seen: Seen
    compared: Compared
    first_ns: int | None
    last_ns: int | None
    state: bytes | None


def processes(jobs: int) -> ProcessPoolExecutor:
    """So many, each started when there is something to do. They end with the process that has begun them, however."""
    return ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin)


def confirmed(session: Session, pool: Executor, progress: Callable[[int], None]) -> Confirmed | None:
    """Everything of a session compared in a pool; None if it is not plainly equal, or cannot be divided."""
    if not session.divisible:
        return None
    again = session.again()
    found: list[Compared] = []
    before = None
    try:
        for stretch, tally in _tallies(again, pool):
            between_ns = None if tally is None else _between(before, stretch, tally)
            if tally is None or between_ns is None:
                return None
            again.settle(stretch, tally.seen)
            found += [tally.compared, Compared(0, 0, 0, between_ns)]
            before = tally if tally.seen.cycle.size else before
            progress(len(tally.seen.cycle))
    except BrokenProcessPool:
        return None
    return Confirmed(again, Compared(*map(sum, zip(Compared(0, 0, 0, 0), *found, strict=True))))


def _between(before: _Tally | None, stretch: Stretch, tally: _Tally) -> int | None:
    """Time from one stretch to the next where the single pass would go on, 0 where it would not.

    None if it would do anything else than begin with the recorded state.
    """
    if before is None or not tally.seen.cycle.size:
        return 0
    first, last = int(tally.seen.cycle[0]), int(before.seen.cycle[-1])
    if first <= last:
        return None
    if first > last + 1 or before.state is None:
        return 0
    if tally.first_ns is None or before.last_ns is None or stretch.snapshots.get(last) != before.state:
        return None
    return tally.first_ns - before.last_ns


def _tallies(session: Session, pool: Executor) -> Iterator[tuple[Stretch, _Tally | None]]:
    """Every stretch in order. Raises BrokenProcessPool."""
    waiting: deque[tuple[Stretch, Future[_Tally | None]]] = deque()
    try:
        for stretch in session.stretches():
            waiting.append((stretch._replace(blocks=()), pool.submit(_tally, session.config_text, stretch)))
            if len(waiting) > AHEAD:
                yield _done(waiting)
        while waiting:
            yield _done(waiting)
    finally:
        for _, future in waiting:
            future.cancel()


def _done(waiting: deque[tuple[Stretch, Future[_Tally | None]]]) -> tuple[Stretch, _Tally | None]:
    """Raises BrokenProcessPool."""
    stretch, future = waiting.popleft()
    return stretch, future.result()


# in a process of the pool


def _begin() -> None:
    """An interrupt from the keyboard is for whoever has begun this process; one that was killed ends no pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()  # what was imported is not looked through again and again: 5 % of the time
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _tally(config_text: str, stretch: Stretch) -> _Tally | None:
    """None: it is not plainly equal."""
    try:
        return _equal(_config(config_text), stretch)
    except CRASHES:
        return None


@lru_cache(maxsize=1)
def _config(text: str) -> RobotConfig:
    return parse(text, "robot file of the session")


def _equal(config: RobotConfig, stretch: Stretch) -> _Tally | None:
    """Raises one of CRASHES on what is damaged, and if the core does."""
    rows = CycleRows(stretch.blocks)
    if not np.all(np.diff(rows.cycle, prepend=stretch.first_cycle - 1, append=stretch.last_cycle + 1) > 0):
        return None
    replay = Replay(config, stretch.snapshot)
    cycles = frames = 0
    first_ns = None
    for window in rows.windows():
        for inputs, recorded in made(window):
            engine = replay.engine(inputs)
            if engine is None:
                continue
            if not same(engine.step(inputs), recorded):
                return None
            first_ns = inputs.now_ns if inputs.cycle == rows.cycle[0] else first_ns
            cycles += 1
            frames += len(recorded.frames)
    if replay.refused is not None:
        return None
    compared = Compared(cycles, frames, replay.unseen, replay.covered_ns)
    state = replay.state()
    return _Tally(rows.seen, compared, first_ns, replay.last_ns, None if state is None else packed(state))
