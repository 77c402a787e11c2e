"""A page of the documentation as text: its blocks of code, and what stands in front of them.

How this works
--------------
A fenced block may have markers in the lines in front of it, comments that no reader sees:

    <!-- covered: tests/vm/test_systemd_drive.py -->   it cannot run here, and this test covers it
    <!-- terminal: 1 -->                               runs in a terminal of its own, until the page ends
    <!-- ended: 1 -->                                  in front of it, that terminal got a Ctrl-C
    <!-- exit: 1 -->                                   ends with this code
    <!-- file: square.toml -->                         is a file of this name

Blocks of `sh` and `python` without `covered` are run, in their order, see `tests.docs.running`.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).parent.parent.parent
DOCS: Final = ROOT / "deploy" / "docs"
MARKERS: Final = ("covered", "terminal", "ended", "exit", "file")
_MARKER: Final = re.compile(r"^<!-- (\w+): (.+?) -->$")
_FENCE: Final = re.compile(r"^(`{3,})(\w*)(.*)$")


class Block(NamedTuple):
    """A fenced block: its language, its text, its first line on the page, the markers in front of it."""

    language: str
    text: str
    line: int
    markers: Mapping[str, str]

    @property
    def runs(self) -> bool:
        """Whether it can be run here."""
        return self.language in ("sh", "python") and "covered" not in self.markers


def sources() -> list[Path]:
    """Every page of the site, and what else of the project a person reads."""
    return [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "deploy" / "README.md"]


def name(page: Path) -> str:
    """Of a page, for people."""
    return str(page.relative_to(ROOT))


def blocks(text: str) -> Iterator[Block]:
    """Every fenced block of a page. Raises ValueError for one that has no end, and for an unknown marker."""
    lines = iter(enumerate(text.splitlines(), start=1))
    markers: dict[str, str] = {}
    for number, line in lines:
        marker, fence = _MARKER.match(line), _FENCE.match(line)
        if marker is not None and marker[1] in MARKERS:
            markers[marker[1]] = marker[2]
            continue
        if fence is not None:
            yield Block(fence[2], _inside(lines, fence[1], number), number, markers)
        elif markers:
            raise ValueError(f"line {number}: a marker belongs right in front of a block")
        markers = {}


def _inside(lines: Iterator[tuple[int, str]], fence: str, begun: int) -> str:
    inside: list[str] = []
    for _, line in lines:
        if line == fence:
            return "\n".join(inside) + "\n"
        inside.append(line)
    raise ValueError(f"line {begun}: a block without an end")


def prose(text: str) -> str:
    """A page without its fenced blocks."""
    kept, fence = [], ""
    for line in text.splitlines():
        found = _FENCE.match(line)
        if fence:
            fence = "" if line == fence else fence
        elif found is not None:
            fence = found[1]
        else:
            kept.append(line)
    return "\n".join(kept)
