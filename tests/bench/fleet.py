"""Verdicts on a fleet of short sessions, in one process, in two, and by two workers of a Dask cluster on this machine.

Beside it what a second process gains that only counts, on this machine now; by how much the memory of the process
that asks grows, behind the first part of the sessions.
"""

import resource
import shutil
import tempfile
import time
from concurrent.futures import Executor
from pathlib import Path

from distributed import LocalCluster

from gateway.types import Twist
from replay.compare.cluster import cluster
from replay.compare.fleet import all_judged
from replay.compare.side_by_side import processes
from replay.sessions.folders import sessions
from replay.sessions.remote import Place
from tests.bench.sessions import recorded
from tests.bench.verify import count
from tests.world import NAMES, World

SESSIONS = 200
PART = 20
SECONDS = 4.0
MEGA = 1024.0  # of the kilobytes that the kernel counts in


def measure() -> dict[str, float]:
    """Copies of one session of each kind of robot, some at a time in each way, so that a busy machine meets all."""
    spent: dict[str, float] = dict.fromkeys(("alone", "processes", "workers", "counted", "counted_together"), 0.0)
    growth: list[float] = []
    with (
        tempfile.TemporaryDirectory() as directory,
        processes(2) as pool,
        _workers(2) as local,
        cluster(local.scheduler_address) as of_cluster,
    ):
        paths = _fleet(Path(directory))
        ways: dict[str, Executor | None] = {"alone": None, "processes": pool, "workers": of_cluster}
        for way in ways.values():
            list(all_judged(paths[:4], way))  # all have started
        assert len(paths) == SESSIONS
        for start in range(0, SESSIONS, PART):
            before, found = _peak(), {}
            for name, way in ways.items():
                seconds, found[name] = _run(paths[start : start + PART], way)
                spent[name] += seconds
            assert found["alone"] == found["processes"] == found["workers"]
            assert {code for _, code, _ in found["alone"]} == {0}
            growth.append((_peak() - before) / MEGA)
            for name, number in (("counted", 1), ("counted_together", 2)):
                spent[name] += count(pool, number)
    return {
        "fleet_sessions_per_second": SESSIONS / spent["alone"],
        "fleet_gain_two_processes": spent["alone"] / spent["processes"],
        "fleet_gain_two_workers": spent["alone"] / spent["workers"],
        "fleet_counting_gain": 2.0 * spent["counted"] / spent["counted_together"],
        "fleet_memory_growth_mb": sum(growth[1:]),  # behind the first part
    }


def _workers(number: int) -> LocalCluster:
    return LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=number, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    )


def _fleet(folder: Path) -> list[Place]:
    for name in NAMES:
        world = World(name)
        world.start()
        world.run(SECONDS, Twist(0.3, 0.1, 0.2))
        first = recorded(world, folder / name)
        for number in range(1, SESSIONS // len(NAMES)):
            shutil.copytree(first, first.with_name(f"{first.name}-{number}"))
    return sessions([folder])


def _run(paths: list[Place], pool: Executor | None) -> tuple[float, list[tuple[str, int, int]]]:
    """Seconds and verdicts."""
    started = time.perf_counter()
    found = [(one.path, one.verdict.exit_code, one.verdict.cycles) for one in all_judged(paths, pool)]
    return time.perf_counter() - started, found


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
