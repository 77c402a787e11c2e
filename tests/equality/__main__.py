"""A session recorded here gives the same bytes on every processor: one drive of each bundled robot, replayed.

Lane `variants`: on this machine with its vector instructions hidden from the C library and from BLAS, `replay verify`
and the digest of all outputs. Lane `aarch64`: the core under an emulated arm64, the digest alone; lane `compiled`: the
same with the core compiled for it, by a compiler that would fuse multiplications and additions if it was let. In each
of them the whole sessions of the corpus (tests/corpus.py) are read and verified as well, by that processor, and the
verdict must be the same document, byte for byte.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.robot_files import bundled
from tests.compiled import CHECKOUT
from tests.corpus import FOLDER as CORPUS
from tests.equality import emulator, verdicts
from tests.equality.drive import record
from tests.equality.judge import Judgement

LANES = ("variants", "aarch64", "compiled")
WITHOUT = "AVX,AVX2,AVX512F,AVX512VL,FMA,FMA4"

# What each pretends to be. The order of sets of strings differs too: each has another PYTHONHASHSEED.
VARIANTS: Mapping[str, Mapping[str, str]] = {
    "as it is": {},
    "C library without FMA and AVX": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{name}" for name in WITHOUT.split(","))
    },
    "BLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS for Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
}


class Run(NamedTuple):
    """What one environment made of the drives and of the corpus; `failure`: what it did not even get to say."""

    name: str
    judgements: tuple[Judgement, ...] = ()
    corpus: Mapping[str, verdicts.Told] = {}
    failure: str | None = None


def main() -> int:
    """0 if all that was asked for ran and agreed; what cannot run has failed."""
    arguments = _parser().parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="drivegate-equality-") as directory:
        folder = Path(directory)
        sessions = {name: record(name, folder) for name in bundled()}
        runs = [_judged("as it is", [sys.executable], folder, _environment(0, {}))]
        expected = runs[0]
        if arguments.lane in {None, "variants"}:
            runs[0] = _verified(runs[0], sessions, _environment(0, {}))
            runs += [_variant(place, name, folder, sessions) for place, name in enumerate(VARIANTS) if place > 0]
        if arguments.lane in {None, "aarch64"}:
            runs.append(_emulated(folder, compiled=False))
        if arguments.lane in {None, "compiled"}:
            runs.append(_emulated(folder, compiled=True))
    failed = [problem for one in runs for problem in _problems(one, expected)]
    for one in runs:
        sys.stdout.write(_line(one, expected) + "\n")
    sys.stdout.write(f"{time.monotonic() - begin:.0f} s\n")
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.equality", description=__doc__, allow_abbrev=False)
    parser.add_argument("lane", nargs="?", choices=LANES, help="default: all")
    return parser


def _environment(place: int, variant: Mapping[str, str]) -> Mapping[str, str]:
    return {**os.environ, "PYTHONHASHSEED": str(place + 1), "PYTHONDONTWRITEBYTECODE": "1", **variant}


def _variant(place: int, name: str, folder: Path, sessions: Mapping[str, Path]) -> Run:
    environment = _environment(place, VARIANTS[name])
    return _verified(_judged(name, [sys.executable], folder, environment), sessions, environment)


def _emulated(folder: Path, *, compiled: bool) -> Run:
    form = "compiled core" if compiled else "pure Python core"
    name = f"emulated aarch64, {form}"
    try:
        python = emulator.python()
        tree = python.compiled(folder) if compiled else CHECKOUT
        found = _judged(name, python.command(tree), folder, _environment(len(VARIANTS), {}), tree)
    except emulator.EmulatorError as error:
        return Run(name, failure=str(error))
    strange = {(one.machine, one.form) for one in found.judgements} - {("aarch64", form)}
    return found._replace(failure=f"it was another one that ran: {strange}") if strange else found


def _judged(
    name: str, python: Sequence[str], folder: Path, environment: Mapping[str, str], tree: Path = CHECKOUT
) -> Run:
    drives = [*python, "-m", "tests.equality.judge", str(folder)]
    corpus = [*python, "-m", "tests.equality.verdicts", *map(str, sorted(CORPUS.iterdir()))]
    said = []
    for command in (drives, corpus):
        try:
            done = emulator.run(command, environment, tree)
        except (OSError, subprocess.TimeoutExpired) as error:
            return Run(name, failure=str(error))
        if done.returncode != 0:
            return Run(name, failure=done.stderr.strip()[-500:] or f"exit {done.returncode}")
        said.append(json.loads(done.stdout))
    judgements = tuple(Judgement(**one) for one in said[0])
    told = verdicts.Verdicts(**said[1])
    if {(one.machine, one.form) for one in judgements} - {(told.machine, told.form)}:
        return Run(name, failure=f"the corpus was verified elsewhere: on {told.machine}, {told.form}")
    return Run(name, judgements, told.sessions)


def _verified(run: Run, sessions: Mapping[str, Path], environment: Mapping[str, str]) -> Run:
    """The command that people use must come to the same verdict."""
    if run.failure is not None:
        return run
    for robot, session in sessions.items():
        done = emulator.run([sys.executable, "-m", "gateway", "replay", "verify", "--json", str(session)], environment)
        if done.returncode != 0:
            return run._replace(failure=f"replay verify of {robot}: {_words(done)}")
    return run


def _words(done: subprocess.CompletedProcess[str]) -> str:
    """Why it was not identical, or why there was no verdict."""
    try:
        verdict = json.loads(done.stdout)
        difference = verdict["first_difference"]
        return (
            f"{difference['field']} differs in cycle {difference['cycle']}" if difference else str(verdict["problem"])
        )
    except (LookupError, TypeError, ValueError):
        return (done.stderr or done.stdout).strip()[-500:] or f"exit {done.returncode}"


def _problems(run: Run, expected: Run) -> list[str]:
    if run.failure is not None:
        return [run.failure]
    problems = [
        f"{one.robot}: differs from the recording in cycle {one.first_difference}"
        for one in run.judgements
        if one.first_difference is not None
    ]
    digests = {one.robot: one.digest for one in run.judgements}
    problems += [
        f"{one.robot}: other bits than here" for one in expected.judgements if digests.get(one.robot) != one.digest
    ]
    problems += verdicts.problems(expected.corpus, run.corpus)
    nothing = [f"no {what} was judged" for what, there in _judgeable(expected) if not there]
    return problems or nothing


def _judgeable(expected: Run) -> list[tuple[str, bool]]:
    return [("drive", bool(expected.judgements)), ("session of the corpus", bool(expected.corpus))]


def _line(run: Run, expected: Run) -> str:
    problems = _problems(run, expected)
    if problems:
        return f"FAIL {run.name}: {'; '.join(problems)}"
    drives = ", ".join(f"{one.robot} {one.digest[:12]} ({one.cycles} cycles)" for one in run.judgements)
    cycles = sum(int(str(told["cycles"])) for told in run.corpus.values())
    corpus = f"corpus of {len(run.corpus)} identical ({cycles} cycles)"
    other = run.judgements[0].mathematics != expected.judgements[0].mathematics
    return f"PASS {run.name}: {drives}; {corpus}{'; its libraries compute other bits than those here' if other else ''}"


if __name__ == "__main__":
    sys.exit(main())
