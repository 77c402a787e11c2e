"""Runs test files again and again in one copy of the checkout, each time in a fresh child of this process.

A program of its own, started in the copy: it imports what the tests share but nothing of the checkout, so that every
child imports the copy as it is at that moment and only starts faster. One job per line of standard input, one result
per line of standard output, both JSON.

- job: file, tests (ids, in this order; null: all), traced (paths whose lines are noted), limit_s
- result: status (pytest's exit code; null: killed at the limit), failed (id of the first failing test or null),
  seconds (by test), lines (by test, "" for what runs at import: pairs of traced path and line number)
"""

import contextlib
import importlib
import json
import os
import resource
import select
import signal
import sys
import tempfile
from collections.abc import Generator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import pytest
from hypothesis import Phase, settings

SHARED = ("can", "hypothesis", "msgspec", "numpy", "pydantic", "tomllib")  # slow to import, quick to fork
MEMORY_BYTES = 8 << 30  # a mutant that collects without end dies of it, not the machine
IMPORT = ""
OPTIONS = (
    *("-x", "-q", "--tb=no", "--no-header", "-o", "timeout=0", "-p", "no:cacheprovider", "-p", "no:faulthandler"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of what is shared
)


class Tracer(Protocol):
    """What sys.settrace takes and gives."""

    def __call__(self, frame: FrameType, event: str, argument: object, /) -> "Tracer | None": ...


class Watch:
    """A pytest plugin: which tests run, in which order, and what is seen of them."""

    def __init__(self, tests: Sequence[str] | None, traced: Sequence[str]) -> None:
        self._rank = None if tests is None else {test: rank for rank, test in enumerate(tests)}
        self._now: dict[str, set[int]] = {path: set() for path in traced}  # lines run and not yet attributed
        self._tracers = {str(Path(path).resolve()): _tracer(numbers) for path, numbers in self._now.items()}
        self._test = IMPORT
        self.failed: str | None = None
        self.seconds: dict[str, float] = {}
        self.lines: dict[str, set[tuple[str, int]]] = {IMPORT: set()}

    def attribute(self, test: str) -> None:
        """The lines until now belong to the test before; from here on to this one."""
        lines = self.lines.setdefault(self._test, set())
        for path, numbers in self._now.items():
            lines |= {(path, number) for number in numbers}
            numbers.clear()
        self._test = test

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what is asked for."""
        rank = self._rank
        if rank is not None:
            items[:] = sorted((item for item in items if item.nodeid in rank), key=lambda item: rank[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """A test begins and ends."""
        self.attribute(item.nodeid)
        result = yield
        self.attribute(IMPORT)
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, object, object]:
        """What a fixture does for several tests belongs to all of them."""
        test = self._test
        self.attribute(test if fixturedef.scope == "function" else IMPORT)
        result = yield
        self.attribute(test)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Durations, and the first failure."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed and self.failed is None:
            self.failed = report.nodeid

    def trace(self, frame: FrameType, event: str, argument: object) -> Tracer | None:
        """For sys.settrace: only the traced files are followed line by line."""
        return self._tracers.get(frame.f_code.co_filename)


def _tracer(numbers: set[int]) -> Tracer:
    def line(frame: FrameType, event: str, argument: object) -> Tracer:
        numbers.add(frame.f_lineno)
        return line

    return line


def serve() -> None:
    """Until standard input ends, or SIGTERM."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    for name in SHARED:
        importlib.import_module(name)
    # Shrinking a counterexample takes long and tells nothing here; the same mutant must always meet the same examples.
    quick = settings(
        phases=(Phase.explicit, Phase.generate), database=None, derandomize=True, report_multiple_bugs=False
    )
    settings.register_profile("mutation", quick)
    settings.load_profile("mutation")
    for line in sys.stdin:
        with tempfile.NamedTemporaryFile() as report:
            result = _run(json.loads(line), report.name)
        sys.stdout.write(json.dumps(result) + "\n")
        sys.stdout.flush()


def _run(job: dict[str, Any], report: str) -> dict[str, Any]:
    child = os.fork()
    if child == 0:
        _child(job, report)
    ended = os.pidfd_open(child)
    try:
        in_time = bool(select.select([ended], [], [], job["limit_s"])[0])
    finally:
        os.close(ended)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    seen = Path(report).read_text(encoding="utf-8")
    return {"status": status if in_time else None, **(json.loads(seen) if seen else {})}


def _child(job: dict[str, Any], report: str) -> None:
    """Never returns."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nothing, descriptor)
    watch = Watch(job["tests"], job["traced"])
    options = [*OPTIONS, job["file"]]
    if job["traced"]:
        sys.settrace(watch.trace)
    status = 70
    try:
        status = int(pytest.main(options, plugins=[watch]))
    finally:
        sys.settrace(None)
        watch.attribute(IMPORT)
        lines = {test: sorted(lines) for test, lines in watch.lines.items()}
        seen = {"failed": watch.failed, "seconds": watch.seconds, "lines": lines}
        Path(report).write_text(json.dumps(seen), encoding="utf-8")
        os._exit(status)


if __name__ == "__main__":
    sys.path[:0] = [str(Path.cwd())]
    serve()
