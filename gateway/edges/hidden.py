"""Packages that a process does without though they are installed, because they cost it seconds and megabytes.

Asked of the import system and not by a None in `sys.modules`: compiled modules take that for the package (measured with
Arrow, which then ends its first array with an AttributeError).
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


class _Absent(MetaPathFinder):
    """Says of one package that it is not there."""

    def __init__(self, package: str) -> None:
        self._package = package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Nothing, and for that package an error, as from an import of what is not installed."""
        if fullname == self._package:
            message = f"this process does without {fullname}"
            raise ModuleNotFoundError(message, name=fullname)
        return None


def hide(package: str) -> None:
    """From now on; what was imported before stays."""
    sys.meta_path.insert(0, _Absent(package))


@contextmanager
def hidden(package: str) -> Iterator[None]:
    """As long as the block runs."""
    absent = _Absent(package)
    sys.meta_path.insert(0, absent)
    try:
        yield
    finally:
        sys.meta_path.remove(absent)
