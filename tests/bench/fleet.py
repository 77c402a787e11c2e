"""Verdicts on a fleet of short sessions, in one process and in two: sessions a second, and what the second gains.

Beside it what a second process gains that only counts, on this machine now; and the memory of the process that asks,
over the first quarter of the sessions and over the rest.
"""

import resource
import shutil
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

from gateway.types import Twist
from replay.compare.fleet import all_judged
from replay.compare.side_by_side import processes
from replay.sessions.folders import sessions
from tests.bench.sessions import recorded
from tests.bench.verify import counting_gain
from tests.world import NAMES, World

SESSIONS = 200
SECONDS = 4.0
MEGA = 1024.0  # of the kilobytes that the kernel counts in


def measure() -> dict[str, float]:
    """Copies of one session of each kind of robot; the verdicts are the same in one process and in two."""
    with tempfile.TemporaryDirectory() as directory:
        paths = _fleet(Path(directory))
        with processes(2) as pool:
            list(all_judged(paths[:4], pool))  # both have started
            together_s, verdicts, _ = _run(paths, pool)
            gain = counting_gain(pool)
        alone_s, same, memory_mb = _run(paths, None)
    assert verdicts == same
    assert len(verdicts) == SESSIONS
    assert {code for _, code, _ in verdicts} == {0}
    return {
        "fleet_sessions_per_second": SESSIONS / alone_s,
        "fleet_sessions_per_second_two_processes": SESSIONS / together_s,
        "fleet_gain_two_processes": alone_s / together_s,
        "fleet_counting_gain": gain,
        "fleet_memory_growth_mb": memory_mb,
    }


def _fleet(folder: Path) -> list[Path]:
    for name in NAMES:
        world = World(name)
        world.start()
        world.run(SECONDS, Twist(0.3, 0.1, 0.2))
        first = recorded(world, folder / name)
        for number in range(1, SESSIONS // len(NAMES)):
            shutil.copytree(first, first.with_name(f"{first.name}-{number}"))
    return sessions([folder])


def _run(paths: list[Path], pool: Executor | None) -> tuple[float, list[tuple[str, int, int]], float]:
    """Seconds, verdicts, and by how much the memory grew after a quarter of them."""
    started, found, quarter = time.perf_counter(), [], 0
    for one in all_judged(paths, pool):
        found.append((one.path, one.verdict.exit_code, one.verdict.cycles))
        quarter = _peak() if len(found) == len(paths) // 4 else quarter
    return time.perf_counter() - started, found, (_peak() - quarter) / MEGA


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
