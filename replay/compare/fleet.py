"""Verdicts on many sessions, one process each: what cannot be read is a verdict as well, and never an exception.

The worst exit code is that of all of them, by `WORST`: a difference outranks a session that cannot be judged, and that
one an incomplete one.
"""

import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from typing import NamedTuple

from replay.compare.differences import Differences, differences
from replay.compare.replay import CRASHES
from replay.compare.verify import (
    EXIT_DIFFERENT,
    EXIT_IDENTICAL,
    EXIT_INCOMPLETE,
    EXIT_NOT_REPLAYABLE,
    Verdict,
    not_replayable,
    verify,
)
from replay.sessions.reader import SessionError, open_session
from replay.sessions.remote import Place, local

WORST = (EXIT_DIFFERENT, EXIT_NOT_REPLAYABLE, EXIT_INCOMPLETE, EXIT_IDENTICAL)
WORDS = {
    EXIT_IDENTICAL: "identical",
    EXIT_DIFFERENT: "different",
    EXIT_NOT_REPLAYABLE: "not replayable",
    EXIT_INCOMPLETE: "incomplete",
}
SHOWN = 60  # characters of a value
AHEAD = 64  # sessions that are given to processes before their turn


class Judged(NamedTuple):
    """A session with its verdict. `elapsed_s`: what that took. `differences`: all of them, where something differs."""

    path: str
    robot: str | None
    verdict: Verdict
    elapsed_s: float
    differences: Differences | None

    @property
    def word(self) -> str:
        """The verdict in a word or two."""
        return WORDS[self.verdict.exit_code]

    @property
    def reason(self) -> str | None:
        """Where it differs and why, or what is missing; None if it is identical."""
        difference = self.verdict.first_difference
        if difference is None:
            return self.verdict.problem
        where = f"{difference.field}{f' of motor {difference.motor}' if difference.motor else ''}"
        causes = () if self.differences is None else [cause.value for cause in self.differences.causes]
        cause = f" ({', '.join(causes)})" if causes else ""
        recorded, replayed = _short(difference.recorded), _short(difference.replayed)
        return f"cycle {difference.cycle}: {where}: {recorded}, now {replayed}{cause}"

    def as_json(self) -> dict[str, object]:
        """The document of one session, with what it is of and all differences."""
        return {
            "path": self.path,
            "robot": self.robot,
            "seconds": round(self.verdict.seconds, 6),
            **self.verdict.as_json(),
            "differences": None if self.differences is None else self.differences.as_json(),
        }


def _short(text: str) -> str:
    """A value that has its place in a line."""
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def judged(place: Place) -> Judged:
    """The verdict on one session, and all differences if there are any."""
    started, robot, found = time.perf_counter(), None, None
    try:
        with local(place) as path:
            session = open_session(path)
            robot = session.header.robot
            verdict = verify(session)
            if verdict.exit_code == EXIT_DIFFERENT:
                found = differences(session.again())
    except (SessionError, OSError) as error:
        verdict = not_replayable(str(error))
    except CRASHES as error:  # a robot file that is refused is one of them
        verdict = not_replayable(f"{place}: {error}")
    return Judged(str(place), robot, verdict, time.perf_counter() - started, found)


def all_judged(places: Sequence[Place], pool: Executor | None = None) -> Iterator[Judged]:
    """Each in its turn, with a pool some of them ahead; those that a broken pool leaves are judged here.

    A pool is processes (`replay.compare.side_by_side`) or a cluster (`replay.compare.cluster`).
    """
    done = 0
    try:
        for one in map(judged, places) if pool is None else _ahead(places, pool):
            done += 1
            yield one
    except BrokenProcessPool:
        yield from map(judged, places[done:])


def _ahead(places: Sequence[Place], pool: Executor) -> Iterator[Judged]:
    """Raises BrokenProcessPool."""
    waiting: deque[tuple[Place, Future[Judged]]] = deque()
    try:
        for place in places:
            waiting.append((place, pool.submit(judged, place)))
            if len(waiting) > AHEAD:
                yield _done(*waiting.popleft())
        while waiting:
            yield _done(*waiting.popleft())
    finally:
        for _, future in waiting:
            future.cancel()


def _done(place: Place, future: Future[Judged]) -> Judged:
    """Raises BrokenProcessPool."""
    try:
        return future.result()
    except BrokenProcessPool:
        raise
    except Exception as error:  # of a cluster: a worker that was killed, or that has no DriveGate
        return Judged(str(place), None, not_replayable(f"{place}: no worker could judge it: {error!r}"), 0.0, None)


class Tally:
    """Of sessions, one after the other: what is kept of them is little."""

    def __init__(self) -> None:
        self._codes: Counter[int] = Counter()
        self._causes: Counter[str] = Counter()
        self._cycles = 0
        self._seconds = 0.0

    def add(self, one: Judged) -> None:
        """One more."""
        self._codes[one.verdict.exit_code] += 1
        self._causes.update(cause.value for cause in (one.differences.causes if one.differences else ()))
        self._cycles += one.verdict.cycles
        self._seconds += one.verdict.seconds

    @property
    def exit_code(self) -> int:
        """The worst one; that of nothing to replay where there was none."""
        return next((code for code in WORST if self._codes[code]), EXIT_NOT_REPLAYABLE)

    def as_json(self) -> dict[str, object]:
        """The documented keys of `summary`."""
        counts = {WORDS[code].replace(" ", "_"): self._codes[code] for code in reversed(WORST)}
        return {
            "sessions": self._codes.total(),
            **counts,
            "causes": dict(self._causes),
            "cycles": self._cycles,
            "seconds": round(self._seconds, 6),
            "exit_code": self.exit_code,
        }

    def __str__(self) -> str:
        """One line."""
        counts = ", ".join(f"{self._codes[code]} {WORDS[code]}" for code in reversed(WORST) if self._codes[code])
        causes = ", ".join(f"{cause}: {number}" for cause, number in self._causes.items())
        total = f"{self._codes.total()} sessions, {self._cycles} cycles, {self._seconds:.1f} s: {counts or 'none'}"
        return f"{total}; {causes}" if causes else total
