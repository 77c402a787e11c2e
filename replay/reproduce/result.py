"""What comes of an experiment: rows of a table, a picture, sessions, and what has to be said of them."""

from collections.abc import Callable
from math import inf, isfinite
from pathlib import Path
from typing import NamedTuple

from replay.reproduce.picture import Picture


class Row(NamedTuple):
    """One quantity. `paper`: as printed there, None where it is not; `allowed`: where science section 6 bounds it.

    `ours` is infinite where what is waited for never comes.
    """

    quantity: str
    unit: str
    ours: float
    paper: float | None = None
    note: str = ""
    allowed: tuple[float, float] | None = None

    @property
    def missed(self) -> bool:
        """Outside of what is allowed; a number that is none is outside of everything."""
        return self.allowed is not None and not self.allowed[0] <= self.ours <= self.allowed[1]

    @property
    def difference(self) -> float | None:
        """Of ours from the paper's, as a share of it."""
        return None if not self.paper else self.ours / self.paper - 1.0

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {
            "quantity": self.quantity,
            "paper": self.paper,
            "ours": self.ours if isfinite(self.ours) else None,
            "unit": self.unit,
            "note": self.note,
        }


class Found(NamedTuple):
    """What an experiment gives back. `sessions`: each under the words that say what was driven, the main one first."""

    rows: tuple[Row, ...]
    picture: Picture
    notes: tuple[str, ...]
    sessions: dict[str, Path]


class Result(NamedTuple):
    """The same when its picture and table are on the disk."""

    name: str
    title: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    sessions: dict[str, Path]
    picture: Path
    table: Path

    @property
    def missed(self) -> tuple[Row, ...]:
        """Rows that miss what they are allowed."""
        return tuple(row for row in self.rows if row.missed)

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {
            "name": self.name,
            "rows": [row.as_json() for row in self.rows],
            "session": str(next(iter(self.sessions.values()))),
            "sessions": {words: str(path) for words, path in self.sessions.items()},
            "picture": str(self.picture),
            "table": str(self.table),
            "missed": [row.quantity for row in self.missed],
        }


class Stage(NamedTuple):
    """Where an experiment plays: its folder, the wall time that its sessions begin at, and who is told each part."""

    folder: Path
    started_wall_ns: int
    tell: Callable[[str], None]


class ReproduceError(Exception):
    """An experiment that could not be driven, and why."""


def within(reference: float, tolerance: float) -> tuple[float, float]:
    """What is allowed around a reference."""
    return reference - tolerance, reference + tolerance


def at_most(bound: float) -> tuple[float, float]:
    """Of a magnitude."""
    return 0.0, bound


def at_least(bound: float) -> tuple[float, float]:
    """Without an upper end."""
    return bound, inf
