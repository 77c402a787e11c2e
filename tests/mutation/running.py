"""Runs mutants: copies of the checkout, a worker in each, and for every mutant the tests that run its lines."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

from tests.mutation.mutants import Mutant
from tests.mutation.worker import IMPORT

COPIED = ("README.md", "deploy", "drivers", "gateway", "pyproject.toml", "replay", "tests")
WORKER = Path(__file__).with_name("worker.py")
PATIENCE = 10.0  # a test file may take so many times longer than without a mutant
BASELINE_LIMIT_S = 1800.0
PASSED, NO_TESTS = 0, 5  # pytest's exit codes

Targets = Mapping[str, Sequence[str]]  # module: test files, cheapest first


class BaselineError(Exception):
    """The tests cannot judge mutants: they fail without one."""


class Outcome(NamedTuple):
    """What became of a mutant. `by`: the test that failed first, None if none did or the modules did not import."""

    mutant: Mutant
    killed: bool
    timeout: bool = False
    by: str | None = None


class Seen(NamedTuple):
    """One test file without a mutant. `lines`: those of the mutated modules, by test; seconds by test."""

    lines: Mapping[str, frozenset[tuple[str, int]]]
    seconds: Mapping[str, float]

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that run the mutant's statement, quickest first."""
        wanted = {(mutant.module, number) for number in mutant.statement}
        everything = not wanted.isdisjoint(self.lines[IMPORT])
        tests = [test for test in self.seconds if everything or not wanted.isdisjoint(self.lines.get(test, ()))]
        return sorted(tests, key=lambda test: self.seconds[test])


class Workplace:
    """A copy of the checkout and the worker in it."""

    def __init__(self, checkout: Path, directory: Path) -> None:
        self._root = directory
        for name in COPIED:
            source = checkout / name
            if source.is_dir():
                shutil.copytree(source, directory / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
            elif source.is_file():
                shutil.copy(source, directory / name)
        self._worker = subprocess.Popen(
            [sys.executable, "-P", str(WORKER)],
            cwd=directory,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # an interrupt from the keyboard is for us, we end the worker
        )

    def close(self) -> None:
        """End the worker, and with it the tests it runs."""
        self._worker.terminate()
        self._worker.communicate()

    def run(self, file: str, *, tests: Sequence[str] | None, traced: Sequence[str], limit_s: float) -> dict[str, Any]:
        """One job of the worker, see there."""
        assert self._worker.stdin is not None
        assert self._worker.stdout is not None
        job = {"file": file, "tests": tests, "traced": traced, "limit_s": limit_s}
        self._worker.stdin.write(json.dumps(job) + "\n")
        self._worker.stdin.flush()
        result: dict[str, Any] = json.loads(self._worker.stdout.readline())
        return result

    @contextlib.contextmanager
    def mutated(self, mutant: Mutant) -> Iterator[None]:
        """The copy with this mutant in it."""
        path = self._root / mutant.module
        original = path.read_bytes()
        try:
            self._write(path, mutant.source.encode())
            yield
        finally:
            self._write(path, original)

    @staticmethod
    def _write(path: Path, source: bytes) -> None:
        # Compiled code is matched to its source by size and whole seconds: too coarse for what changes this often.
        for compiled in path.parent.glob(f"__pycache__/{path.stem}.*"):
            compiled.unlink()
        path.write_bytes(source)


class Runner:
    """Judges mutants, several at a time. To be closed: it holds processes and copies of the checkout."""

    def __init__(self, checkout: Path, targets: Targets, *, jobs: int, limit_s: float) -> None:
        self._targets = targets
        self._limit_s = limit_s
        self._seen: dict[str, Seen] = {}
        self._resources = contextlib.ExitStack()
        self._threads = self._resources.enter_context(ThreadPoolExecutor(jobs))  # ends last, once no worker answers
        self._free: SimpleQueue[Workplace] = SimpleQueue()
        for _ in range(jobs):
            directory = self._resources.enter_context(tempfile.TemporaryDirectory(prefix="drivegate-mutation-"))
            workplace = Workplace(checkout, Path(directory))
            self._resources.callback(workplace.close)
            self._free.put(workplace)

    def close(self) -> None:
        """End every process and remove every copy."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        self._resources.close()

    def baseline(self) -> None:
        """Run every test file once without a mutant. Raises BaselineError if one does not pass or runs no target."""
        files = sorted({file for files in self._targets.values() for file in files})
        self._seen = dict(zip(files, self._threads.map(self._watch, files), strict=True))
        for module, files_of in self._targets.items():
            ran = {path for file in files_of for lines in self._seen[file].lines.values() for path, _ in lines}
            if module not in ran:
                raise BaselineError(f"{module}: none of its test files runs it")

    def judge(self, mutants: Sequence[Mutant], told: Callable[[Outcome], None]) -> list[Outcome]:
        """Outcomes in the order of the mutants; each is told as soon as it is known, from any thread."""

        def judged(mutant: Mutant) -> Outcome:
            outcome = self._judge(mutant)
            told(outcome)
            return outcome

        return list(self._threads.map(judged, mutants))

    @contextlib.contextmanager
    def _workplace(self) -> Iterator[Workplace]:
        workplace = self._free.get()
        try:
            yield workplace
        finally:
            self._free.put(workplace)

    def _watch(self, file: str) -> Seen:
        with self._workplace() as workplace:
            result = workplace.run(file, tests=None, traced=list(self._targets), limit_s=BASELINE_LIMIT_S)
        if result["status"] != PASSED:
            raise BaselineError(f"{file} fails without a mutant: {result.get('failed') or 'it cannot be run'}")
        lines = {test: frozenset((path, line) for path, line in seen) for test, seen in result["lines"].items()}
        return Seen(lines, result["seconds"])

    def _judge(self, mutant: Mutant) -> Outcome:
        with self._workplace() as workplace, workplace.mutated(mutant):
            for file in self._targets[mutant.module]:
                seen = self._seen[file]
                tests = seen.tests_of(mutant)
                if not tests:
                    continue
                limit_s = max(self._limit_s, PATIENCE * sum(seen.seconds.values()))
                result = workplace.run(file, tests=tests, traced=(), limit_s=limit_s)
                if result["status"] is None:
                    return Outcome(mutant, killed=True, timeout=True)
                if result["status"] not in (PASSED, NO_TESTS):
                    return Outcome(mutant, killed=True, by=result.get("failed"))
        return Outcome(mutant, killed=False)
