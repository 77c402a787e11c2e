"""Which commit would first have driven otherwise: halving the history between one that is good and one that is bad.

Git orders the commits that are left, best to ask first; what is asked of each is the verdict of its own software on one
session. A commit that gives none is skipped, and the next best is asked, so that a few broken ones cost little; where
only such stand in front of the first bad one, nobody can say which of them it was.
"""

from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple

Halve = Callable[[str, Sequence[str]], Sequence[str]]  # (bad, goods) -> what is left, best to ask first, bad with it


class Answer(Enum):
    """What a commit's software says of the session."""

    GOOD = "the same"
    BAD = "differently"
    SKIPPED = "no verdict"


class Asked(NamedTuple):
    """One commit's answer. `why`: the first difference, or why there is no verdict; "" where all is the same."""

    commit: str
    answer: Answer
    why: str = ""


class BisectError(Exception):
    """The history cannot be halved; the text says why."""


class Found(NamedTuple):
    """`first`: the commits one of which is the first bad one; a single one where none had to be skipped there."""

    first: tuple[str, ...]
    asked: tuple[Asked, ...]

    def why(self, commit: str) -> str:
        """What a commit that was asked has said."""
        return next((one.why for one in self.asked if one.commit == commit), "")


def bisect(good: str, bad: str, *, halve: Halve, ask: Callable[[str], Asked]) -> Found:
    """Between two full commit names, of which the good one is an ancestor of the bad one. Raises BisectError.

    `ask` is called once for each commit, for the two ends first: they must be what they are said to be.
    """
    asked = [_expected(ask(good), Answer.GOOD, "--good"), _expected(ask(bad), Answer.BAD, "--bad")]
    goods, skipped = [good], set[str]()
    while True:
        left = [commit for commit in halve(bad, goods) if commit != bad]
        commit = next((one for one in left if one not in skipped), None)
        if commit is None:
            return Found((*left, bad), tuple(asked))
        answered = ask(commit)
        asked.append(answered)
        if answered.answer is Answer.BAD:
            bad = commit
        elif answered.answer is Answer.GOOD:
            goods.append(commit)
        else:
            skipped.add(commit)


def _expected(asked: Asked, answer: Answer, option: str) -> Asked:
    if asked.answer is answer:
        return asked
    reason = f": {asked.why}" if asked.why else ""
    wanted = f"{option} must be a commit whose software would drive {answer.value}"
    if asked.answer is Answer.SKIPPED:
        raise BisectError(f"{wanted}, and {asked.commit[:12]} gives no verdict on the session{reason}")
    raise BisectError(f"{wanted}, and {asked.commit[:12]} would drive {asked.answer.value}{reason}")
