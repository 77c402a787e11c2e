"""Speed of `replay verify` at 1 kHz, reading the session from disk included, as a multiple of real time.

Alone, by the processor's time, and side by side in two processes; beside that what two processes that only count gain
on this machine now.
"""

import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from gateway.types import Twist
from replay.compare.side_by_side import processes
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.bench.sessions import recorded
from tests.world import NAMES, World

RATE_HZ = 1000.0
COURSE = (Twist(0.5, 0.0, 0.0), Twist(0.0, 0.4, 0.0), Twist(0.0, 0.0, 0.8), Twist(0.3, 0.2, 0.3))
LEG_S = 4.0
REPEATS = 3
ROUNDS = 3  # of the course, for two processes: some seconds of work
COUNTS = 10_000_000


def measure() -> dict[str, float]:
    """The best of a few runs for each robot."""
    figures: dict[str, float] = {}
    for name in NAMES:
        world = World(name, rate_hz=RATE_HZ)
        world.start()
        for twist in COURSE * ROUNDS:
            world.run(LEG_S, twist)
        with tempfile.TemporaryDirectory() as directory:
            folder = recorded(world, Path(directory))
            figures |= {f"{key}_{name}": value for key, value in _measured(folder).items()}
    return figures


def _measured(folder: Path) -> dict[str, float]:
    """In turn, so that whatever else the machine does meets all of them; of each the best."""
    alone, spent, together, counted, counted_together = [], [], [], [], []
    with processes(2) as pool:
        verify(open_session(folder), pool=pool)  # both have started, which takes half a second
        for _ in range(REPEATS):
            begin = time.process_time()
            verdict = verify(open_session(folder))
            spent.append(time.process_time() - begin)
            verdicts = verdict, verify(open_session(folder), pool=pool)
            assert verdicts[0]._replace(realtime_ratio=0.0) == verdicts[1]._replace(realtime_ratio=0.0)
            assert verdicts[0].identical
            alone.append(verdicts[0].realtime_ratio)
            together.append(verdicts[1].realtime_ratio)
            counted.append(count(pool, 1))
            counted_together.append(count(pool, 2))
    return {
        "verify_realtime_ratio": verdict.cycles / RATE_HZ / min(spent),
        "verify_realtime_ratio_two_processes": max(together),
        "verify_gain_two_processes": max(together) / max(alone),
        "counting_gain_two_processes": 2.0 * min(counted) / min(counted_together),
    }


def count(pool: Executor, number: int) -> float:
    """Seconds in which so many of its processes count."""
    return _seconds(lambda: list(pool.map(_count, [COUNTS] * number)))


def _seconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _count(number: int) -> int:
    return sum(1 for _ in range(number))
