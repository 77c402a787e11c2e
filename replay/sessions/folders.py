"""Where sessions are."""

from collections.abc import Iterable, Sequence

from gateway.recording.disk import segments
from replay.sessions.remote import Place, sessions_below


def sessions(places: Iterable[Place]) -> list[Place]:
    """Every session in these folders, by name, none twice; a place in which there is none stands for itself."""
    return list(dict.fromkeys(found for place in places for found in _sessions(place)))


def _sessions(path: Place) -> Sequence[Place]:
    if isinstance(path, str):
        return sessions_below(path)
    if not path.is_dir() or segments(path):
        return [path]
    found = {file.parent for file in path.rglob("segment-*.rrd")}
    return sorted(folder for folder in found if segments(folder)) or [path]
