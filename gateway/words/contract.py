"""What is said of one code: the shape of every table in this folder."""

from typing import NamedTuple


class Words(NamedTuple):
    """What a code means; its likely causes, the likeliest first; what to do, in that order too.

    Codes that only tell what was wanted have neither causes nor anything to do.
    """

    meaning: str
    causes: tuple[str, ...] = ()
    cures: tuple[str, ...] = ()
