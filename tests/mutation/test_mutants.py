"""Which changes a module gets, and which texts are left alone."""

import pytest

from tests.mutation.__main__ import CHECKOUT
from tests.mutation.mutants import mutants
from tests.mutation.survivors import Survivor, load, sort
from tests.mutation.targets import TARGETS

# statement: its mutants, in words
IN_A_FUNCTION = {
    "return a < b": {"a < b -> a <= b", "a < b -> a >= b", "a < b -> None"},
    "return a == b": {"a == b -> a != b", "a == b -> None"},
    "return a is None": {"a is None -> a is not None", "a is None -> None"},
    "return not a": {"not a -> a", "not a -> None"},
    "return a and b": {"a and b -> a or b", "a and b -> a", "a and b -> b", "a and b -> None"},
    "return a + b": {"a + b -> a - b", "a + b -> None"},
    "return min(a, b)": {"min(a, b) -> max(a, b)", "min(a, b) -> None"},
    "return abs(a)": {"abs(a) -> a", "abs(a) -> None"},
    "return -a": {"-a -> a", "-a -> None"},
    "return True": {"True -> False", "True -> None"},
    "return 0": {"0 -> 1", "0 -> None"},
    "return 1.0": {"1.0 -> 0.0", "1.0 -> 2.0", "1.0 -> None"},
    "return 4": {"4 -> 5", "4 -> None"},
    "return 0.25": {"0.25 -> 0.5", "0.25 -> None"},
    "return None": {"None -> 0"},
    "return a if b else c": {"b -> True", "b -> False", "a if b else c -> None"},
    "return [x for x in a if x]": {"x -> True", "x -> False", "[x for x in a if x] -> None"},
    "return {a, b}": {"without a", "without b", "{a, b} -> None"},
    "return a in (b, c)": {"a in (b, c) -> a not in (b, c)", "without b", "without c", "a in (b, c) -> None"},
    "if a: b()": {"a -> True", "a -> False", "without b()"},
    "while a: break": {"a -> False", "without break"},
    "a.b = c": {"without a.b = c"},
    "a += (b, c)": {"a += (b, c) -> a -= (b, c)", "without a += (b, c)", "without b", "without c"},
    "a = b": set(),  # without it the name is missing, and every test notices
    "raise ValueError(1)": {"without raise ValueError(1)"},
    # texts
    "logger.warning('a %s', 1)": set(),
    "'docstring'": set(),
    "a = 'text'": set(),
    "a = f'{1 + 1}'": set(),
    "a = 'x' if b else f'{1}'": set(),
    "a: int | None = b": set(),
    "assert a == 1": set(),
    "zip(a, b, strict=True)": {"without zip(a, b, strict=True)"},
    "import a": set(),
}
ON_MODULE_LEVEL = {
    "LIMIT = 3": {"3 -> 3 * 2", "3 -> 3 // 2"},
    "LIMIT = 0": {"0 -> 1"},
    "LIMIT = 0.3": {"0.3 -> 0.3 * 2", "0.3 -> 0.3 / 2"},
    "TIME = 20 * MS": {"20 * MS -> 20 * MS * 2", "20 * MS -> 20 * MS // 2"},
    "TABLE = {A: ((b, M.C), (d, M.E))}": {"without A: ((b, M.C), (d, M.E))", "without (b, M.C)", "without (d, M.E)"},
    "STEPS = (Step.A, Step.B)": {"without Step.A", "without Step.B"},
    "ALIAS = tuple[int, float]": set(),
    "__slots__ = ('a', 'b')": set(),
    "class A:\n    'docstring'\n    b: bool = False": {"False -> True"},
    "class A:\n    def __str__(self): return self.a + 1": set(),
    "def f(a: int = 0) -> bool: return a": {"0 -> 1", "a -> True", "a -> False"},
}


def words(source: str) -> set[str]:
    return {mutant.mutation for mutant in mutants("m.py", source)}


@pytest.mark.parametrize(("statement", "expected"), IN_A_FUNCTION.items())
def test_changes_in_a_function(statement: str, expected: set[str]) -> None:
    assert words(f"def f():\n    {statement}\n") == expected


@pytest.mark.parametrize(("statement", "expected"), ON_MODULE_LEVEL.items())
def test_changes_on_module_level(statement: str, expected: set[str]) -> None:
    assert words(statement) == expected


def test_only_the_changed_node_is_rewritten() -> None:
    source = "# é\ndef f(a):  # why\n    return (a   <\n        1)  # ü\n"
    (mutant,) = [mutant for mutant in mutants("m.py", source) if mutant.mutation == "a < 1 -> a <= 1"]

    assert mutant.source == "# é\ndef f(a):  # why\n    return ((a <= 1))  # ü\n"
    assert mutant.number == 3
    assert mutant.line == "return (a   <"
    assert list(mutant.statement) == [3, 4]


def test_statement_of_a_condition_is_its_header() -> None:
    found = mutants("m.py", "def f(a):\n    if (a and\n        a):\n        g()\n")

    assert {tuple(mutant.statement) for mutant in found if mutant.number == 2} == {(2, 3)}


@pytest.mark.parametrize("module", TARGETS)
def test_every_mutant_of_a_target_is_another_program(module: str) -> None:
    source = (CHECKOUT / module).read_text(encoding="utf-8")
    found = mutants(module, source)

    assert len({mutant.source for mutant in found} | {source}) == len(found) + 1
    for mutant in found:
        compile(mutant.source, module, "exec")
    assert all((CHECKOUT / file).is_file() for file in TARGETS[module])


def test_judged_mutants_do_not_count_and_unknown_rows_are_told() -> None:
    found = mutants("m.py", "def f(a):\n    return a + 1\n")
    judged = Survivor("m.py", "f", "return a + 1", "a + 1 -> a - 1", judgement="a is infinite")
    stale = judged._replace(line="return a + 2")
    elsewhere = judged._replace(module="other.py")

    result = sort(found, [judged, stale, elsewhere])

    assert [mutant.mutation for mutant in result.judged] == ["a + 1 -> a - 1"]
    assert len(result.open) == len(found) - 1
    assert result.stale == [stale]


def test_the_same_change_elsewhere_is_another() -> None:
    found = mutants("m.py", "class A:\n    def f(self):\n        a = 1 + b\n\ndef f():\n    a = 1 + b\n")
    changes = [(mutant.where, mutant.line, mutant.mutation) for mutant in found]
    assert ("A.f", "a = 1 + b", "1 + b -> 1 - b") in changes
    assert ("f", "a = 1 + b", "1 + b -> 1 - b") in changes
    assert len(set(changes)) == len(changes)


def test_table_of_survivors_is_well_formed() -> None:
    load()
