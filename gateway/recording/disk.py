"""Folders, names and room on the disk of recorded sessions; knows nothing of what is in a segment.

How this works
--------------
Each session folder holds its segments and its number, one more than the largest one there was when it was made: what
is older is read from that and never from a clock, which may start in 1970. Whoever writes a session holds a lock on
its folder, which the kernel frees with the process. Room is made among the sessions of one robot only: older sessions
first, then the oldest closed segments of the one being written. Links are neither followed nor deleted. What a segment
cannot say of its own last bytes stands beside it in `SHA256SUMS`, as the program of that name writes it.
Incidents are single files in a folder of their own, with a number each, and room of their own. Of a fault that comes
and goes for hours the first one tells most: what is neither the first nor the last of its cause on a day goes first.
"""

import contextlib
import fcntl
import os
import re
import stat
import threading
from collections.abc import Collection, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

FOLDER_MODE, FILE_MODE = 0o750, 0o640  # readable for the group of the service, whatever umask it was started with
SUMS = "SHA256SUMS"
INCIDENTS = "incidents"  # folder in the directory of the sessions
UNFINISHED = ".part"
_NUMBER_FILE = ".sequence"
_SEGMENT = re.compile(r"segment-(\d{5,})\.rrd")
_SUM = re.compile(r"([0-9a-f]{64})  ([\w.-]+\.rrd)")
_DIGITS = 18  # of the longest number that is believed


class Disposable(NamedTuple):
    """What may be deleted to make room: an older session whole, or one closed segment of the running one."""

    path: Path
    bytes: int
    segment: int | None  # its number; None for a session


class IncidentFile(NamedTuple):
    """An incident by its name: number, day by the clock (UTC, as in the name), cause."""

    number: int
    day: str
    cause: str
    path: Path


def new_session(directory: Path, robot: str, started_wall_ns: int) -> Path:
    """Make the folder of a new session: robot, UTC start, and a number if there is one of that name already."""
    stamp = _stamp(started_wall_ns)
    directory.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
    after = max((_number(path) for path in sessions(directory, robot)), default=0)
    number = 1
    while True:
        folder = directory / (f"{robot}-{stamp}" if number == 1 else f"{robot}-{stamp}-{number}")
        try:
            make_folder(folder)
        except FileExistsError:
            number += 1
            continue
        _write_number(folder, after + 1)
        return folder


def make_folder(folder: Path) -> None:
    """Make a session folder with its mode. Raises OSError."""
    folder.mkdir(mode=FOLDER_MODE)
    folder.chmod(FOLDER_MODE)


def sessions(directory: Path, robot: str) -> list[Path]:
    """Session folders of this robot, oldest first: those without a number by their names, then by number."""
    name = re.compile(rf"{re.escape(robot)}-(\d{{8}}T\d{{6}}Z)(?:-(\d{{1,{_DIGITS}}}))?")
    found = ((name.fullmatch(path.name), path) for path in directory.iterdir())
    ours = [
        ((_number(path), match[1], int(match[2] or 1)), path)
        for match, path in found
        if match and path.is_dir() and not path.is_symlink()
    ]
    return [path for _, path in sorted(ours)]


def segments(folder: Path) -> list[Path]:
    """Segments of a session in the order of their numbers."""
    found = ((segment_number(path), path) for path in folder.iterdir())
    return [path for _, path in sorted((number, path) for number, path in found if number is not None)]


def segment_number(path: Path) -> int | None:
    """Place of a segment in its session, from its name; None if it is not named as one."""
    match = _SEGMENT.fullmatch(path.name)
    return int(match[1]) if match else None


def next_segment(folder: Path) -> int:
    """Number of the segment to write next."""
    return max((segment_number(path) or 0 for path in segments(folder)), default=0) + 1


def segment_path(folder: Path, number: int) -> Path:
    """Where that segment lies."""
    return folder / f"segment-{number:05d}.rrd"


def add_sum(segment: Path, sha256: str) -> None:
    """Note the digest of a closed segment beside it. Raises OSError."""
    path = segment.with_name(SUMS)
    with path.open("a", encoding="ascii") as file:
        file.write(f"{sha256}  {segment.name}\n")
    path.chmod(FILE_MODE)
    sync(path)


def noted_sums(folder: Path) -> dict[str, str] | None:
    """Digest of each closed segment by its name; None if nobody has noted any. Raises OSError."""
    try:
        text = (folder / SUMS).read_text(encoding="latin-1")
    except FileNotFoundError:
        return None
    return {match[2]: match[1] for match in map(_SUM.fullmatch, text.splitlines()) if match}


def forget_sums(folder: Path, names: Collection[str]) -> None:
    """Of files that are deleted. Raises OSError."""
    noted = noted_sums(folder)
    if noted is None or noted.keys().isdisjoint(names):
        return
    new = (folder / SUMS).with_suffix(UNFINISHED)
    new.write_text("".join(f"{sum_}  {name}\n" for name, sum_ in noted.items() if name not in names), encoding="ascii")
    new.chmod(FILE_MODE)
    new.rename(folder / SUMS)


def incidents(folder: Path, robot: str) -> list[tuple[int, Path]]:
    """Incidents of this robot with their numbers, oldest first."""
    return [(one.number, one.path) for one in incident_files(folder, robot)]


def incident_files(folder: Path, robot: str) -> list[IncidentFile]:
    """The same with what their names say."""
    found = (incident_file(path, robot) for path in folder.iterdir())
    return sorted(one for one in found if one is not None and not one.path.is_symlink())


def incident_file(path: Path, robot: str) -> IncidentFile | None:
    """What a name says; None: it is none of this robot's."""
    match = re.fullmatch(rf"{re.escape(robot)}-(\d{{8}})T\d{{6}}Z-([a-z_]+)-(\d{{1,{_DIGITS}}})\.rrd", path.name)
    return None if match is None else IncidentFile(int(match[3]), match[1], match[2], path)


def expendable(found: Sequence[IncidentFile], coming: IncidentFile) -> list[IncidentFile]:
    """In which order they go to make room for the one that comes; oldest first in `found`.

    First those that are neither the first nor the last of their cause on a day; then day by day, and in each the first
    ones behind the others. Which day is older is told by numbers, and not by the clock.
    """
    every = [*found, coming]
    first = {(one.day, one.cause): one for one in reversed(every)}
    last = {(one.day, one.cause): one for one in every}
    begins = {one.day: one.number for one in reversed(every)}

    def place(one: IncidentFile) -> tuple[bool, int, bool, int]:
        series = one.day, one.cause
        is_first, is_last = one == first[series], one == last[series]
        if not (is_first or is_last):
            return False, 0, False, one.number
        return True, begins[one.day], is_first, one.number

    return sorted(found, key=place)


def new_incident(folder: Path, robot: str, wall_ns: int, cause: str) -> str:
    """Name of one, without suffix: robot, UTC, cause, and a number that is larger than all there are."""
    number = max((number for number, _ in incidents(folder, robot)), default=0) + 1
    return f"{robot}-{_stamp(wall_ns)}-{cause}-{number}"


def free_bytes(folder: Path) -> int:
    """Room left for an ordinary user on the file system of the folder."""
    system = os.statvfs(folder)
    return system.f_bavail * system.f_frsize


def stored_bytes(directory: Path, robot: str) -> int:
    """Bytes of all segments of this robot's sessions."""
    return sum(_own_bytes(segment) for session in sessions(directory, robot) for segment in segments(session))


def disposable(current: Path, robot: str, *, writing: Path | None) -> list[Disposable]:
    """What may go while `current` is recorded, in the order in which it goes; `writing` is the open segment."""
    present = sessions(current.parent, robot)
    older = present[: present.index(current)] if current in present else []
    found = [Disposable(path, sum(map(_own_bytes, segments(path))), None) for path in older if not _is_held(path)]
    own = segments(current) if current in present else []
    found += [Disposable(path, _own_bytes(path), segment_number(path)) for path in own if path != writing]
    return [one for one in found if one.bytes]


def delete(one: Disposable) -> None:
    """Delete it, of a session only what is named as ours: a folder into which a person put notes keeps them."""
    if one.segment is not None:
        one.path.unlink()
        return
    with hold(one.path) as held:
        if held:
            for path in segments(one.path):
                if not path.is_symlink():
                    path.unlink()
            for name in (_NUMBER_FILE, SUMS):
                (one.path / name).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # not empty
                one.path.rmdir()


class Hold:
    """The lock on a session folder while this process writes it; another process' pruning leaves such a folder alone.

    `held` is False when somebody else has it, or when the file system knows no locks: recording goes on without.
    """

    def __init__(self, folder: Path) -> None:
        self._descriptor: int | None = None
        with contextlib.suppress(OSError):
            self._descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        if self._descriptor is not None:
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                self.release()

    @property
    def held(self) -> bool:
        """Whether the folder is ours."""
        return self._descriptor is not None

    def release(self) -> None:
        """Let go; the end of the process does, too."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


@contextlib.contextmanager
def hold(folder: Path) -> Iterator[bool]:
    """Hold a folder for a moment; False if somebody else holds it."""
    lock = Hold(folder)
    try:
        yield lock.held
    finally:
        lock.release()


def _is_held(folder: Path) -> bool:
    with hold(folder) as free:
        return not free


def _own_bytes(segment: Path) -> int:
    """Size of a segment; 0 for a link, whose target is not ours, and for one that has just gone."""
    try:
        found = segment.lstat()
    except OSError:
        return 0
    return found.st_size if stat.S_ISREG(found.st_mode) else 0


def _stamp(wall_ns: int) -> str:
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")


def _number(folder: Path) -> int:
    """Number of a session; 0 for one recorded before sessions had numbers."""
    try:
        text = (folder / _NUMBER_FILE).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return 0
    return int(text) if text.isdecimal() and len(text) <= _DIGITS else 0


def _write_number(folder: Path, number: int) -> None:
    path = folder / _NUMBER_FILE
    path.write_text(f"{number}\n", encoding="ascii")
    path.chmod(FILE_MODE)
    sync(path)
    sync(folder)
    sync(folder.parent)


class Syncer:
    """Asks the kernel after each batch, in its own thread, to bring the open segment to the disk.

    Rerun hands its data to the kernel and never syncs; without this a power cut would cost half a minute. A disk that
    takes longer than from one batch to the next is asked again when it is done, and nobody waits for it.
    """

    def __init__(self) -> None:
        self.error: str | None = None
        self._path: Path | None = None
        self._synced: Path | None = None
        self._written = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="syncer", daemon=True)
        self._thread.start()

    def watch(self, path: Path | None) -> None:
        """Sync this file from now on."""
        self._path = path

    def written(self) -> None:
        """The kernel has something new of it."""
        self._written.set()

    def close(self) -> None:
        """Sync once more and end."""
        self._ended = True
        self._written.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended:
            self._written.wait()
            self._written.clear()
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
