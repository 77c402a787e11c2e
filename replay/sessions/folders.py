"""Where sessions are."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from gateway.recording.disk import INCIDENTS, segments


def sessions(paths: Iterable[Path]) -> list[Path]:
    """Every session in these folders, by name, none twice, and every incident that was kept.

    A path in which there is none stands for itself.
    """
    return list(dict.fromkeys(found for path in paths for found in _sessions(path)))


def _sessions(path: Path) -> Sequence[Path]:
    if not path.is_dir() or segments(path):
        return [path]
    found = {file.parent for file in path.rglob("segment-*.rrd")}
    return [*sorted(folder for folder in found if segments(folder)), *incidents(path)] or [path]


def incidents(path: Path) -> list[Path]:
    """Files of the incidents in this folder and below."""
    return sorted(path.glob("*.rrd") if path.name == INCIDENTS else path.rglob(f"{INCIDENTS}/*.rrd"))
