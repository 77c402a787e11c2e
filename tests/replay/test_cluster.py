"""The same verdicts on a Dask cluster of two workers, each a process of its own."""

import json
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from pathlib import Path

import pytest
from distributed import LocalCluster

from replay.compare.fleet import Judged, all_judged
from replay.sessions.folders import sessions
from tests.replay import test_fleet
from tests.replay.test_fleet import named, run

fleet = test_fleet.fleet


def workers(number: int) -> LocalCluster:
    return LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=number, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=False
    )


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with workers(2) as local:
        local.wait_for_workers(2)
        yield local.scheduler_address


def told(*words: object) -> dict[str, object]:
    document: dict[str, object] = json.loads(run(*words, "--json").stdout)
    for one in document["sessions"]:  # type: ignore[attr-defined]
        del one["realtime_ratio"]
    return document


def test_the_verdicts_are_those_of_processes(fleet: Path, scheduler: str) -> None:
    paths = named(fleet)
    assert told(*paths, "--scheduler", scheduler) == told(*paths, "--jobs", 1)


def test_one_session_is_a_fleet_as_well(fleet: Path, scheduler: str) -> None:
    (session,) = sessions([fleet / "robots" / "a"])
    assert told(session, "--scheduler", scheduler)["summary"]["identical"] == 1  # type: ignore[index]


def test_a_scheduler_that_is_not_there_is_said(fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replay.compare.cluster.CONNECT_S", 0.5)
    done = run(fleet, "--scheduler", "tcp://127.0.0.1:9")
    assert done.exit_code == 2
    assert "no scheduler can be reached" in done.output


def test_without_the_package_its_extra_is_named(fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = run(fleet, "--scheduler", "tcp://127.0.0.1:9")
    assert done.exit_code == 2
    assert "drivegate[fleet]" in done.output


def test_a_cluster_without_workers_is_said(fleet: Path) -> None:
    with workers(0) as empty:
        done = run(fleet, "--scheduler", empty.scheduler_address)
    assert done.exit_code == 2
    assert "has no workers" in done.output


class Lost(Executor):
    """Its workers are killed, each of them."""

    def submit(self, fn, /, *args, **_):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN002, ANN003, ANN201
        future: Future[Judged] = Future()
        future.set_exception(RuntimeError("killed"))
        return future


def test_a_worker_that_was_killed_is_a_line(fleet: Path) -> None:
    (one,) = all_judged([fleet / "robots" / "a"], Lost())
    assert one.verdict.exit_code == 2
    assert "no worker could judge it: RuntimeError" in str(one.reason)


def test_an_address_that_is_none_is_said(fleet: Path) -> None:
    done = run(fleet, "--scheduler", "nonsense://")
    assert done.exit_code == 2
    assert "nonsense" in done.output
