"""Where sessions are."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from gateway.recording.disk import INCIDENTS, segments
from replay.sessions.remote import Place, sessions_below


def sessions(places: Iterable[Place]) -> list[Place]:
    """Every session in these folders, by name, none twice, and every incident that was kept.

    A place in which there is none stands for itself.
    """
    return list(dict.fromkeys(found for place in places for found in _sessions(place)))


def _sessions(path: Place) -> Sequence[Place]:
    if isinstance(path, str):
        return sessions_below(path)
    if not path.is_dir() or segments(path):
        return [path]
    found = {file.parent for file in path.rglob("segment-*.rrd")}
    return [*sorted(folder for folder in found if segments(folder)), *incidents(path)] or [path]


def incidents(path: Path) -> list[Path]:
    """Files of the incidents in this folder and below."""
    return sorted(path.glob("*.rrd") if path.name == INCIDENTS else path.rglob(f"{INCIDENTS}/*.rrd"))
