"""The tool on a small project with one rule that is tested, one that is not, and one that nothing runs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutation.__main__ import Report, run
from tests.mutation.mutants import mutants
from tests.mutation.running import BaselineError, Runner
from tests.mutation.survivors import Survivor

LIMIT_S = 60.0  # reached by nothing that ends
MODULE = "gateway/rule.py"
TEST = "tests/test_rule.py"
RULE = """
LIMIT = 3

def allowed(speed):
    return speed <= LIMIT

def careful(speed):
    return speed < 1

def countdown(steps):
    while steps != 0:
        steps -= 1
    return steps

def unused():
    return True
"""
TESTS = """
from gateway.rule import allowed, careful, countdown

def test_allowed():
    assert allowed(3)
    assert not allowed(4)

def test_careful():
    careful(0.5)

def test_countdown():
    assert countdown(2) == 0
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    files = {MODULE: RULE, TEST: TESTS, "gateway/__init__.py": "", "pyproject.toml": "[tool.pytest.ini_options]\n"}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.fixture
def runner(checkout: Path) -> Iterator[Runner]:
    runner = Runner(checkout, {MODULE: [TEST]}, jobs=2, limit_s=LIMIT_S)
    yield runner
    runner.close()


def lines(report: Report, *, killed: bool) -> set[str]:
    return {outcome.mutant.mutation for outcome in report.outcomes if outcome.killed is killed}


def test_planted_mutants_are_killed_and_planted_survivors_found(runner: Runner, checkout: Path) -> None:
    judged = Survivor(MODULE, "careful", "return speed < 1", "speed < 1 -> speed <= 1", judgement="planted")
    found = [mutant for mutant in mutants(MODULE, RULE) if "steps" not in mutant.line]
    report = run(runner, {MODULE: found}, [judged])

    assert {"speed <= LIMIT -> speed < LIMIT", "3 -> 3 * 2", "3 -> 3 // 2"} <= lines(report, killed=True)
    assert lines(report, killed=False) == {
        *("speed < 1 -> None", "speed < 1 -> speed >= 1", "1 -> 0", "1 -> 2"),  # runs, but nothing is asserted
        *("True -> None", "True -> False"),  # nothing runs it
    }
    by = {outcome.mutant.mutation: outcome.by for outcome in report.outcomes}
    assert by["speed <= LIMIT -> speed < LIMIT"] == f"{TEST}::test_allowed"
    score = report.total
    assert score.judged == 1
    assert score.killed + score.survived + score.judged == score.mutants
    assert not report.passed
    assert (checkout / MODULE).read_text(encoding="utf-8") == RULE, "the checkout is never touched"


def test_a_mutant_that_never_ends_is_killed_by_the_limit(checkout: Path) -> None:
    found = [mutant for mutant in mutants(MODULE, RULE) if mutant.mutation == "steps -= 1 -> steps += 1"]
    runner = Runner(checkout, {MODULE: [TEST]}, jobs=1, limit_s=1.0)
    try:
        (outcome,) = run(runner, {MODULE: found}, []).outcomes
    finally:
        runner.close()

    assert outcome.killed
    assert outcome.timeout


def test_sample_is_drawn_from_the_seed(runner: Runner) -> None:
    found = {MODULE: [mutant for mutant in mutants(MODULE, RULE) if "LIMIT" in mutant.line]}

    first, again, other = (run(runner, found, [], sample=2, seed=seed).outcomes for seed in (1, 1, 2))

    assert len(first) == 2
    assert first == again
    assert first != other
    assert all(outcome.killed for outcome in first)


def test_tests_that_fail_without_a_mutant_judge_nothing(checkout: Path) -> None:
    (checkout / TEST).write_text(f"{TESTS}\ndef test_broken():\n    assert False\n", encoding="utf-8")
    runner = Runner(checkout, {MODULE: [TEST]}, jobs=1, limit_s=LIMIT_S)
    try:
        with pytest.raises(BaselineError, match="test_broken"):
            runner.baseline()
    finally:
        runner.close()


def test_a_module_that_no_test_file_runs_is_no_target(checkout: Path) -> None:
    (checkout / "gateway/other.py").write_text("A = 1\n", encoding="utf-8")
    runner = Runner(checkout, {MODULE: [TEST], "gateway/other.py": [TEST]}, jobs=1, limit_s=LIMIT_S)
    try:
        with pytest.raises(BaselineError, match=r"gateway/other\.py"):
            runner.baseline()
    finally:
        runner.close()
