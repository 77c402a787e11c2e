"""How the loop kept time: cycles counted by the microsecond, in memory that does not grow with the session."""

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np

from gateway.types import CycleTiming
from replay.report.binned import Counts
from replay.sessions.reader import Session, SessionError

LONGEST_US = 100_001  # what takes longer is counted with it, and the most is kept
CHUNK = 4096


class Latency:
    """One time of every cycle, in whole us, rounded up."""

    def __init__(self) -> None:
        self.counts: Counts = np.zeros(LONGEST_US + 1, np.int64)
        self.most = 0.0

    def add(self, times_ns: Counts) -> None:
        """Some more cycles."""
        us = np.clip(-(-times_ns // 1000), 0, LONGEST_US)
        self.counts += np.bincount(us, minlength=LONGEST_US + 1)
        self.most = max(self.most, float(times_ns.max()) * 1e-3)

    @property
    def cycles(self) -> int:
        """Of how many this is."""
        return int(self.counts.sum())

    def below(self, percent: float) -> float:
        """us that so many of all cycles do not exceed: to the next microsecond, and beyond the longest the most."""
        place = int(np.searchsorted(np.cumsum(self.counts), self.cycles * percent / 100.0))
        return self.most if place >= LONGEST_US else min(float(place), self.most)

    def between(self, low_us: float, high_us: float) -> int:
        """Cycles that took longer than `low_us` and no longer than `high_us`."""
        cumulative = np.concatenate([[0], np.cumsum(self.counts)])
        places = [int(np.clip(bound, -1, LONGEST_US)) + 1 for bound in (low_us, high_us)]
        return int(cumulative[places[1]] - cumulative[places[0]])


class Timing:
    """`late`: start of a cycle behind its time; `work`: drain, step and send."""

    def __init__(self) -> None:
        self.late = Latency()
        self.work = Latency()

    def add(self, told: Iterable[CycleTiming]) -> None:
        """Some more cycles."""
        late, work = np.array([(one.late_ns, one.work_ns) for one in told], np.int64).T
        self.late.add(late)
        self.work.add(work)


def timing(session: Session) -> Timing | None:
    """None of a recording of schema 1, which is not read for that, and of a drive in virtual time, which took none."""
    found = Timing()
    try:
        for some in _chunks(one for _, one in session.timings()):
            found.add(some)
    except SessionError:
        return None
    return found if found.work.most > 0.0 else None


def _chunks(told: Iterator[CycleTiming]) -> Iterator[list[CycleTiming]]:
    while some := list(islice(told, CHUNK)):
        yield some
