"""The table of survivors that were looked at and may live."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.mutation.mutants import Mutant

TABLE = Path(__file__).with_name("survivors.toml")


class Survivor(NamedTuple):
    """One row of survivors.toml."""

    module: str
    where: str
    line: str
    mutation: str
    judgement: str


class Sorted(NamedTuple):
    """Mutants still to be killed, mutants judged before, and rows that match no mutant."""

    open: list[Mutant]
    judged: list[Mutant]
    stale: list[Survivor]


def load(path: Path = TABLE) -> list[Survivor]:
    """The table. Raises ValueError for a row without its five texts."""
    rows = tomllib.loads(path.read_text(encoding="utf-8")).get("survivor", [])
    for row in rows:
        if set(row) != set(Survivor._fields) or not all(
            isinstance(text, str) and (text.strip() or name == "where") for name, text in row.items()
        ):
            raise ValueError(f"{path}: {row}: a survivor has the texts {', '.join(Survivor._fields)}")
    return [Survivor(**row) for row in rows]


def sort(mutants: Sequence[Mutant], table: Sequence[Survivor]) -> Sorted:
    """All mutants of some modules, by the rows about those modules."""
    modules = {mutant.module for mutant in mutants}
    rows = {row[:4]: row for row in table if row.module in modules}
    judged = [mutant for mutant in mutants if _key(mutant) in rows]
    found = {_key(mutant) for mutant in judged}
    return Sorted(
        open=[mutant for mutant in mutants if _key(mutant) not in rows],
        judged=judged,
        stale=[row for key, row in rows.items() if key not in found],
    )


def _key(mutant: Mutant) -> tuple[str, str, str, str]:
    return mutant.module, mutant.where, mutant.line, mutant.mutation
