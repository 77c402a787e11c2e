"""Folders, names and room on the disk of recorded sessions; knows nothing of what is in a segment."""

import os
import re
import threading
from datetime import UTC, datetime
from pathlib import Path

SYNC_PERIOD_S = 1.0
_SESSION = re.compile(r"[a-z][a-z0-9_-]*-\d{8}T\d{6}Z(-\d+)?")
_SEGMENT = re.compile(r"segment-(\d{5,})\.rrd")


def new_session(directory: Path, robot: str, started_wall_ns: int) -> Path:
    """Make the folder of a new session: robot, UTC start, and a number if there is one of that name already."""
    stamp = datetime.fromtimestamp(started_wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    directory.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        folder = directory / (f"{robot}-{stamp}" if number == 1 else f"{robot}-{stamp}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            number += 1
            continue
        return folder


def segments(folder: Path) -> list[Path]:
    """Segments of a session in the order of their numbers."""
    found = ((_SEGMENT.fullmatch(path.name), path) for path in folder.iterdir())
    return [path for _, path in sorted((int(match[1]), path) for match, path in found if match)]


def next_segment(folder: Path) -> int:
    """Number of the segment to write next."""
    present = segments(folder)
    if not present:
        return 1
    return int(present[-1].stem.removeprefix("segment-")) + 1


def segment_path(folder: Path, number: int) -> Path:
    """Where that segment lies."""
    return folder / f"segment-{number:05d}.rrd"


def free_bytes(folder: Path) -> int:
    """Room left for an ordinary user on the file system of the folder."""
    system = os.statvfs(folder)
    return system.f_bavail * system.f_frsize


def prune(directory: Path, *, current: Path, budget: int) -> list[Path]:
    """Delete the oldest sessions until all together fit the budget, never the current one; what was deleted.

    Only files named as ours are deleted: a folder into which a person put notes keeps them.
    """
    sessions = [path for path in directory.iterdir() if path.is_dir() and _SESSION.fullmatch(path.name)]
    sizes = {path: sum(segment.stat().st_size for segment in segments(path)) for path in sessions}
    total = sum(sizes.values())
    gone = []
    for path in sorted(sessions, key=_age):
        if total <= budget:
            break
        if path == current or not sizes[path]:
            continue
        for segment in segments(path):
            segment.unlink()
        if not any(path.iterdir()):
            path.rmdir()
        total -= sizes[path]
        gone.append(path)
    return gone


def _age(path: Path) -> tuple[str, str]:
    """Sort key: UTC start as written in the name, oldest first, whatever the robot is called."""
    stamp = re.search(r"\d{8}T\d{6}Z", path.name)
    return (stamp[0] if stamp else "", path.name)


class Syncer:
    """Asks the kernel about once per second, in its own thread, to bring the open segment to the disk.

    Rerun hands its data to the kernel and never syncs; without this a power cut would cost half a minute.
    """

    def __init__(self) -> None:
        self.error: str | None = None
        self._path: Path | None = None
        self._synced: Path | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="syncer", daemon=True)
        self._thread.start()

    def watch(self, path: Path | None) -> None:
        """Sync this file from now on."""
        self._path = path

    def close(self) -> None:
        """Sync once more and end."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(SYNC_PERIOD_S):
            self._sync()
        self._sync()

    def _sync(self) -> None:
        path = self._path
        if path is None:
            return
        try:
            sync(path)
            if path != self._synced:
                sync(path.parent)  # so that the file itself is found after a power cut
                self._synced = path
        except OSError as error:
            self.error = f"{path}: cannot be brought to the disk: {error.strerror}"
        else:
            self.error = None


def sync(path: Path) -> None:
    """Bring a file or folder to the disk. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fdatasync(descriptor)
    finally:
        os.close(descriptor)
