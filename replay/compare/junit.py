"""Verdicts as JUnit XML, which every CI service shows: one test case per session."""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

from replay.compare.fleet import Judged
from replay.compare.verify import EXIT_DIFFERENT, EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE

# Where a session is not identical: a failure is what the software did, or may have done; an error is no verdict at all.
_TAGS = {EXIT_DIFFERENT: "failure", EXIT_INCOMPLETE: "failure", EXIT_NOT_REPLAYABLE: "error"}
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class JUnit:
    """Add every session, then write."""

    def __init__(self) -> None:
        self._suite = Element("testsuite", name="drivegate replay verify")
        self._elapsed_s = 0.0

    def add(self, one: Judged) -> None:
        """One more."""
        self._elapsed_s += one.elapsed_s
        named = {"classname": _text(one.robot or "unknown"), "name": _text(one.path)}
        case = SubElement(self._suite, "testcase", {**named, "time": f"{one.elapsed_s:.3f}"})
        tag = _TAGS.get(one.verdict.exit_code)
        if tag is not None:
            SubElement(case, tag, type=one.word, message=_text(one.reason or one.word)).text = _text(_details(one))

    def write(self, path: Path) -> None:
        """Raises OSError."""
        cases = list(self._suite)
        self._suite.attrib |= {
            "tests": str(len(cases)),
            "failures": str(_having(cases, "failure")),
            "errors": str(_having(cases, "error")),
            "time": f"{self._elapsed_s:.3f}",
        }
        root = Element("testsuites")
        root.append(self._suite)
        ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _having(cases: Sequence[Element], tag: str) -> int:
    return sum(case.find(tag) is not None for case in cases)


def _details(one: Judged) -> str:
    lines = [one.verdict.problem or ""]
    for episode in () if one.differences is None else one.differences.episodes:
        lines.append(f"cycles {episode.first_cycle} to {episode.last_cycle}: {episode.cause.value}: {episode.why}")
        lines += [
            f"  {group.motor or '-'} {group.field}: {group.cycles} cycles, {group.first_cycle} to {group.last_cycle}, "
            f"largest {'-' if group.largest is None else f'{group.largest:g}'}"
            for group in episode.groups
        ]
    return "\n".join(line for line in lines if line)


def _text(text: str) -> str:
    """Without the characters that XML cannot hold."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
