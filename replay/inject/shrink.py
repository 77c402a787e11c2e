"""The shortest script that still breaks a law: entries, recorded commands and time are taken away as long as it does.

How this works
--------------
Delta debugging (Zeller and Hildebrandt, Simplifying and isolating failure-inducing input, 2002): halves, quarters, ...
of the entries are left out, down to single ones, until none can go. Before that the drive is cut behind its first
violation, and tried without what was recorded.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from gateway.types import Request
from replay.drive.scenario import Given
from replay.drive.scenario_file import At, Scenario
from replay.inject.injection import Recorded, run

_TAIL_S = 0.05  # behind the first violation
_Thing = TypeVar("_Thing")


class Shrunk(NamedTuple):
    """What is left, and in how many drives that was found out."""

    drive: Recorded
    scenario: Scenario
    words: str  # the first violation of the law
    tries: int


def shrink(drive: Recorded, scenario: Scenario, law: str, *, most_tries: int = 300) -> Shrunk:
    """From a drive that breaks this law."""
    return _Shrinking(drive, scenario, law, most_tries).result()


class _Shrinking:
    def __init__(self, drive: Recorded, scenario: Scenario, law: str, most_tries: int) -> None:
        self._law = law
        self._most = most_tries
        self._tries = 0
        self._words = ""
        self._drive, self._scenario = drive, scenario
        if not self._breaks(drive, scenario):
            raise ValueError(f"this drive does not break the law: {law}")

    def result(self) -> Shrunk:
        """Everything away that can go."""
        self._cut()
        without = self._drive._replace(given=Given())
        self._accept(without, self._scenario)
        self._fewer_entries()
        self._fewer_requests()
        self._cut()
        return Shrunk(self._drive, self._scenario, self._words, self._tries)

    def _breaks(self, drive: Recorded, scenario: Scenario) -> bool:
        self._tries += 1
        found = run(drive, scenario).violations[self._law]
        if found:
            self._words = found[0]
        return bool(found)

    def _accept(self, drive: Recorded, scenario: Scenario) -> bool:
        """Go on from these if they break the law as well."""
        if self._tries >= self._most or not self._breaks(drive, scenario):
            return False
        self._drive, self._scenario = drive, scenario
        return True

    def _cut(self) -> None:
        """Behind the first violation nothing matters."""
        end = float(self._words.split(" ", 1)[0]) + _TAIL_S
        if end < self._scenario.seconds:
            entries = [at for at in self._scenario.at if at.t <= end]
            self._accept(self._drive, self._scenario.model_copy(update={"seconds": end, "at": entries}))

    def _fewer_entries(self) -> None:
        def fits(entries: Sequence[At]) -> bool:
            return self._accept(self._drive, self._scenario.model_copy(update={"at": list(entries)}))

        _least(self._scenario.at, fits)

    def _fewer_requests(self) -> None:
        def fits(requests: Sequence[Request]) -> bool:
            given = self._drive.given._replace(requests=tuple(requests))
            return self._accept(self._drive._replace(given=given), self._scenario)

        _least(self._drive.given.requests, fits)


def _least(things: Sequence[_Thing], fits: Callable[[Sequence[_Thing]], bool]) -> None:
    """Leaves out pieces, ever smaller ones, as long as the rest fits."""
    left, size = list(things), max(len(things) // 2, 1)
    while left:
        place, gone = 0, False
        while place < len(left):
            rest = left[:place] + left[place + size :]
            if fits(rest):
                left, gone = rest, True
            else:
                place += size
        if size == 1 and not gone:
            return
        size = max(size // 2, 1)
