"""A session as a log of its frames for other tools, or as a table of what the core made of it."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from enum import Enum
from pathlib import Path
from typing import IO, NamedTuple

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.types import Inputs
from replay.compare.retrace import columns, rows
from replay.logs import asc, blf, candump, mf4
from replay.logs.logged import LogError, Logged, LogWriter
from replay.sessions.reader import Session

ROWS = 4096  # of a group in a Parquet file


class Format(Enum):
    """What a session can be written as."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"
    MCAP = "mcap"
    PARQUET = "parquet"


SUFFIXES = {
    ".log": Format.CANDUMP,
    ".asc": Format.ASC,
    ".blf": Format.BLF,
    ".mf4": Format.MF4,
    ".mcap": Format.MCAP,
    ".parquet": Format.PARQUET,
}


class Exported(NamedTuple):
    """What was written: frames, or rows of a table; the channel of each bus; what the format cannot hold."""

    format: str
    frames: int
    rows: int
    channels: dict[str, str]
    left_out: dict[str, int]


def format_of(path: Path) -> Format:
    """By its suffix. Raises LogError."""
    found = SUFFIXES.get(path.suffix.lower())
    if found is None:
        raise LogError(f"{path}: say with --format what to write, or give it a suffix of {', '.join(SUFFIXES)}")
    return found


def logged(session: Session) -> Iterator[Logged]:
    """Every frame in the order of the cycles, in each by its time: a received one when it came, else its cycle."""
    offset_ns = session.header.wall_minus_mono_ns
    for inputs, outputs in session.cycles():
        found = [
            Logged(_time_ns(frame, inputs) + offset_ns, frame, sent)
            for sent, frames in ((False, inputs.frames), (True, outputs.frames))
            for frame in frames
        ]
        yield from sorted(found, key=_when) if len(found) > 1 else found


def export(session: Session, path: Path, to: Format) -> Exported:
    """Write all of it, or leave the file as it was. Raises LogError, ConfigError, SessionError."""
    part = path.with_name(f".{path.name}.part")
    try:
        written = _written(session, part, to)
        part.replace(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with suppress(OSError):  # there is no such folder, or it cannot be written
            part.unlink(missing_ok=True)
    return written


def _written(session: Session, path: Path, to: Format) -> Exported:
    if to is Format.PARQUET:
        return Exported(to.value, 0, _parquet(session, path), {}, {})
    buses = [bus.name for bus in parse(session.config_text, "robot file of the session").bus]
    channels = {name: number for number, name in enumerate(buses, start=1)}
    with _file(path, to) as file:
        writer = _WRITERS[to](file, channels)
        frames = 0
        for one in logged(session):
            if one.frame.bus not in channels:
                channels[one.frame.bus] = len(channels) + 1
            writer.add(one)
            frames += 1
        writer.close()
    names = {name: str(number) if to in _NUMBERED else name for name, number in channels.items()}
    return Exported(to.value, frames, 0, names, dict(writer.left_out))


def _time_ns(frame: CanFrame, inputs: Inputs) -> int:
    return inputs.now_ns if frame.received_ns is None else frame.received_ns


def _when(one: Logged) -> int:
    assert one.time_ns is not None
    return one.time_ns


def _file(path: Path, to: Format) -> AbstractContextManager[IO[bytes] | IO[str]]:
    return path.open("w", encoding="ascii", errors="replace") if to in _TEXTS else path.open("wb")


def _mcap(file: IO[bytes], _: Mapping[str, int]) -> LogWriter:
    from replay.logs import mcap_frames  # noqa: PLC0415  # two packages that nothing else needs

    return mcap_frames.Writer(file)


def _mf4(file: IO[bytes], channels: Mapping[str, int]) -> LogWriter:
    """Raises LogError."""
    if not mf4.is_installed():
        raise LogError(mf4.EXTRA)
    from replay.logs import mf4_files  # noqa: PLC0415  # an extra, and a second to import

    return mf4_files.Writer(file, channels)


_NUMBERED = {Format.ASC, Format.BLF, Format.MF4}  # these have numbers for channels, from 1
_TEXTS = {Format.CANDUMP, Format.ASC}
_WRITERS: Mapping[Format, Callable[..., LogWriter]] = {
    Format.CANDUMP: lambda file, _: candump.Writer(file),
    Format.ASC: asc.Writer,
    Format.BLF: blf.Writer,
    Format.MF4: _mf4,
    Format.MCAP: _mcap,
}


def _parquet(session: Session, path: Path) -> int:
    """A row per cycle that can be run again: `time` (UTC, ns) and the cells of `drivegate replay trace`."""
    import pyarrow as pa  # noqa: PLC0415  # large
    from pyarrow import parquet  # noqa: PLC0415

    names = columns(session)
    kinds = {"cycle": pa.int64(), "mode": pa.string()}
    schema = pa.schema(
        [("time", pa.timestamp("ns", tz="UTC")), *((name, kinds.get(name, pa.float64())) for name in names)],
        metadata={"session": session.header.session, "robot": session.header.robot},
    )
    written = 0
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for group in _groups(session):
            cells = zip(*group, strict=True)
            arrays = [pa.array(column, field.type) for column, field in zip(cells, schema, strict=True)]
            writer.write_table(pa.table(arrays, schema=schema))
            written += len(group)
    return written


def _groups(session: Session) -> Iterator[list[list[object]]]:
    """Rows, each with its wall time in front."""
    first_ns = next((inputs.now_ns for inputs, _ in session.again().cycles()), 0) + session.header.wall_minus_mono_ns
    group: list[list[object]] = []
    for row in rows(session):
        group.append([first_ns + round(float(row[1] or 0.0) * 1e9), *row])
        if len(group) >= ROWS:
            yield group
            group = []
    if group:
        yield group
