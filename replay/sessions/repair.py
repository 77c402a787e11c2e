"""A session that was cut or damaged, once more in a folder of its own: every whole message, and words of what is not.

How this works
--------------
Segments in which nothing is wrong are copied as they are. Of the others every whole message is, byte for byte and in
its order (`replay.sessions.framing`), but no end: what was lost stays lost, and the reader goes on saying so. The copy
is for others: Rerun's own reader and viewer, which stop at the first damage or open nothing at all. The original is
only read.
"""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from gateway.recording.disk import FILE_MODE, add_sum, make_folder, noted_sums, segment_path, sync
from gateway.recording.packets import Gap
from replay.sessions.framing import Kept, read, repair
from replay.sessions.reader import Session, SessionError, open_session

SUFFIX = "-repaired"


class RepairedSegment(NamedTuple):
    """What became of a segment. `kept`: None, it is copied whole. `problem`: why there is nothing of it in the copy."""

    name: str
    kept: Kept | None
    problem: str | None = None

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        dropped = [] if self.kept is None else [list(stretch) for stretch in self.kept.dropped]
        return {
            "name": self.name,
            "whole": self.kept is None and self.problem is None,
            "messages": None if self.kept is None else self.kept.messages,
            "dropped": dropped,
            "problem": self.problem,
        }


class Repaired(NamedTuple):
    """What a repair led to. `out`: None where nothing had to be repaired. `gaps`, `problem`: of the copy."""

    session: Path
    out: Path | None
    segments: tuple[RepairedSegment, ...]
    cycles: int
    gaps: tuple[Gap, ...]
    problem: str | None

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {
            "session": str(self.session),
            "out": None if self.out is None else str(self.out),
            "segments": [segment.as_json() for segment in self.segments],
            "cycles": self.cycles,
            "gaps": [{"first_cycle": a, "last_cycle": b, "reason": reason} for a, b, reason in self._gaps()],
            "problem": self.problem,
        }

    def _gaps(self) -> list[tuple[int, int, str]]:
        return [(gap.first_cycle, gap.last_cycle, gap.reason) for gap in self.gaps]


def repaired(path: Path, out: Path | None = None, progress: Callable[[int], None] = lambda _: None) -> Repaired:
    """Write the whole messages of a session to `out`, by default a folder beside it; a complete one is left alone.

    `progress` is told how many more bytes are done. Raises SessionError, OSError.
    """
    session = open_session(path)
    if session.complete:
        return Repaired(path, None, (), session.cycle_count, (), None)
    out = out or path.with_name((path.name if path.is_dir() else path.stem) + SUFFIX)
    _make_empty(out, path)
    try:
        segments = tuple(_segment(source, _target(source, out, session), progress) for source in session.segments)
        sync(out)
    except BaseException:
        shutil.rmtree(out)  # what there is of it would pass for all that was left
        raise
    found = open_session(out)
    return Repaired(path, out, segments, found.cycle_count, found.gaps, found.problem)


def _make_empty(out: Path, path: Path) -> None:
    """Raises SessionError if something is there."""
    if not out.exists():
        out.parent.mkdir(parents=True, exist_ok=True)
        make_folder(out)
    elif not out.is_dir() or any(out.iterdir()):
        raise SessionError(f"{out}: is there already: choose another folder with --out")
    if path.is_dir() and out.resolve() == path.resolve():
        raise SessionError(f"{out}: is the session itself, which is never changed")


def _target(source: Path, out: Path, session: Session) -> Path:
    """A segment keeps its name; a file of another name gets that of the segment it is by its header."""
    return out / source.name if session.path.is_dir() else segment_path(out, session.header.segment)


def _segment(source: Path, target: Path, progress: Callable[[int], None]) -> RepairedSegment:
    try:
        if read(source, ()).problem is None:
            shutil.copyfile(source, target)
            progress(source.stat().st_size)
            kept = None
        else:
            kept = repair(source, target, progress)
    except ValueError as error:
        return RepairedSegment(source.name, None, str(error))
    target.chmod(FILE_MODE)
    sync(target)
    noted = (noted_sums(source.parent) or {}).get(source.name)
    if kept is None and noted is not None:
        add_sum(target, noted)
    return RepairedSegment(source.name, kept)
