"""What a person who mistyped a word may have meant. Pure."""

from collections.abc import Iterable
from difflib import get_close_matches

LIKENESS = 0.6  # of 1; difflib's own bound, at which two letters of a word of eight may be wrong


def meant(word: str, known: Iterable[str]) -> str | None:
    """The known word that is most like this one; None where none is like it."""
    by_lower = {one.lower(): one for one in known}
    found = get_close_matches(word.lower(), by_lower, n=1, cutoff=LIKENESS)
    return by_lower[found[0]] if found else None


def guess(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'x'?`, to be put behind what is wrong with the word; empty where nothing is like it."""
    found = meant(word, known)
    return "" if found is None else f"; did you mean {found!r}?"
