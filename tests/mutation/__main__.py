"""Changes the rules of the core and the drivers one by one and asks whether the tests notice.

Exit 0 if at least 95 % of the mutants that nobody has judged are killed and every judged one still exists, 1 if not,
2 if the tests fail without any mutant. A lane of its own: a full run takes the better part of an hour.
"""

import argparse
import json
import os
import random
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

from tests.mutation import survivors
from tests.mutation.mutants import Mutant, mutants
from tests.mutation.running import BaselineError, Outcome, Runner
from tests.mutation.targets import TARGETS

# The tool is our own because no library changes what is safety here: mutmut leaves everything outside functions alone,
# so neither a row of a transition table nor a named limit, and changes the texts of messages; cosmic-ray works in the
# checkout itself and starts the interpreter and all tests anew for each mutant; neither removes a statement or forces
# an `if`.
CHECKOUT = Path(__file__).parents[2]
REQUIRED = 0.95


class Score(NamedTuple):
    """Of one module, or of all."""

    mutants: int
    judged: int
    killed: int
    timeouts: int
    survived: int

    @property
    def share(self) -> float:
        """Killed, of those that ran; 1 if there was nothing to kill."""
        return self.killed / (self.killed + self.survived) if self.killed + self.survived else 1.0


class Report(NamedTuple):
    """Everything a run found out."""

    scores: dict[str, Score]
    outcomes: list[Outcome]
    stale: list[survivors.Survivor]

    @property
    def total(self) -> Score:
        """Over all modules."""
        return Score(*(sum(column) for column in zip(*self.scores.values(), strict=True)))

    @property
    def passed(self) -> bool:
        """Whether the tests are good enough, and the table is up to date."""
        return self.total.share >= REQUIRED and not self.stale


def main() -> int:
    """The command line."""
    arguments = _parser().parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    targets = {module: TARGETS[module] for module in arguments.module or TARGETS}
    found = {module: mutants(module, (CHECKOUT / module).read_text(encoding="utf-8")) for module in targets}
    table = survivors.load()
    runner = Runner(CHECKOUT, targets, jobs=arguments.jobs, limit_s=arguments.seconds_per_mutant)
    try:
        report = run(runner, found, table, sample=arguments.sample, seed=arguments.seed)
    except BaselineError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    finally:
        runner.close()
    sys.stdout.write(json.dumps(_as_json(report)) + "\n" if arguments.json else _as_text(report))
    return 0 if report.passed else 1


def run(
    runner: Runner,
    found: dict[str, list[Mutant]],
    table: Sequence[survivors.Survivor],
    *,
    sample: int | None = None,
    seed: int = 0,
) -> Report:
    """Judge the mutants of each module, or a random `sample` of them. Raises BaselineError."""
    everything = survivors.sort([mutant for mutants in found.values() for mutant in mutants], table)
    chosen = [mutant for module in found for mutant in _sampled(everything.open, module, sample, seed)]
    console = Console(stderr=True)
    columns = (*Progress.get_default_columns()[:-1], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("tests without a mutant", total=None)
        runner.baseline()
        progress.update(task, description="mutants", total=len(chosen))
        outcomes = runner.judge(chosen, told=lambda _: progress.advance(task))
    scores = {module: _score(module, len(found[module]), everything.judged, outcomes) for module in found}
    return Report(scores, outcomes, everything.stale)


def _sampled(mutants: Sequence[Mutant], module: str, sample: int | None, seed: int) -> list[Mutant]:
    mine = [mutant for mutant in mutants if mutant.module == module]
    if sample is None or sample >= len(mine):
        return mine
    return random.Random(f"{seed} {module}").sample(mine, sample)


def _score(module: str, size: int, judged: Sequence[Mutant], outcomes: Sequence[Outcome]) -> Score:
    mine = [outcome for outcome in outcomes if outcome.mutant.module == module]
    return Score(
        mutants=size,
        judged=sum(mutant.module == module for mutant in judged),
        killed=sum(outcome.killed for outcome in mine),
        timeouts=sum(outcome.timeout for outcome in mine),
        survived=sum(not outcome.killed for outcome in mine),
    )


def _as_text(report: Report) -> str:
    lines: list[str] = []
    for outcome in report.outcomes:
        if not outcome.killed or outcome.timeout:
            mutant = outcome.mutant
            what = "killed by the time limit" if outcome.timeout else "survived"
            lines += [
                f"{mutant.module}:{mutant.number}: {mutant.where}: {what}",
                f"  {mutant.line}",
                f"  {mutant.mutation}",
                "",
            ]
    for row in report.stale:
        lines += [
            f"survivors.toml: no such mutant: {row.module}: {row.where}",
            f"  {row.line}",
            f"  {row.mutation}",
            "",
        ]
    lines.append(f"{'module':28}{'mutants':>9}{'judged':>9}{'killed':>9}{'by time':>9}{'survived':>10}{'score':>9}")
    for name, score in {**report.scores, "all": report.total}.items():
        lines.append(
            f"{name:28}{score.mutants:9}{score.judged:9}{score.killed:9}{score.timeouts:9}{score.survived:10}"
            f"{score.share:9.1%}"
        )
    return "\n".join(lines) + "\n"


def _as_json(report: Report) -> dict[str, object]:
    return {
        "passed": report.passed,
        "score": report.total.share,
        "modules": {name: {**score._asdict(), "score": score.share} for name, score in report.scores.items()},
        "survivors": [_row(outcome.mutant) for outcome in report.outcomes if not outcome.killed],
        "timeouts": [_row(outcome.mutant) for outcome in report.outcomes if outcome.timeout],
        "stale": [row._asdict() for row in report.stale],
    }


def _row(mutant: Mutant) -> dict[str, object]:
    place = {"module": mutant.module, "where": mutant.where, "number": mutant.number}
    return {**place, "line": mutant.line, "mutation": mutant.mutation}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__, allow_abbrev=False)
    parser.add_argument("--module", action="append", choices=tuple(TARGETS), help="only this one; may be repeated")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="mutants at a time")
    parser.add_argument(
        "--seconds-per-mutant",
        type=float,
        default=30.0,
        metavar="S",
        help="a test file that takes longer, and ten times longer than without a mutant, has killed it (default: 30)",
    )
    parser.add_argument("--sample", type=int, metavar="N", help="only N mutants of each module, drawn at random")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the sample")
    parser.add_argument("--json", action="store_true", help="the report as one line of JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
