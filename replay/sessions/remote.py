"""Sessions that are elsewhere (s3://, https://, file://, ...): listed and fetched through fsspec.

How this works
--------------
A session is fetched whole into a folder of its own, read there like any other, and deleted again before the next one:
what that takes on the disk is one session for each process that reads some. Whoever reads it fetches it, so a worker
of a cluster does so for itself, with its own credentials; these are for the file system's package to find (environment
or its own files). What comes is held against the sizes that were listed: a download that was cut is no verdict on the
recording.
"""

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from gateway.recording.disk import SUMS, segment_number
from replay.sessions.reader import SessionError

EXTRA = "needs the package `fsspec`: pip install 'drivegate[fleet]'"
SCHEME = "://"
Place = Path | str  # a string is a URL

_T = TypeVar("_T")


class _Remote(NamedTuple):
    """A file to fetch. `size`: bytes; None: nobody tells."""

    path: str
    name: str
    size: int | None


def place(text: str) -> Place:
    """What a person wrote: a URL if it has a scheme, else a path."""
    return text if SCHEME in text else Path(text)


def sessions_below(url: str) -> list[str]:
    """Every session there, by name; the URL itself where none is, or where nothing can be listed."""
    if _is_segment(url):
        return [url]
    try:
        files, path = _opened(url)
        found = _asked(url, lambda: files.find(path))
    except SessionError:
        return [url]
    base = PurePosixPath(path)
    below = [PurePosixPath(name).relative_to(base) for name in found if _below(name, base)]
    folders = {one.parent for one in below if segment_number(Path(one.name)) is not None}
    if PurePosixPath() in folders or not folders:
        return [url]
    return [f"{url.rstrip('/')}/{folder}" for folder in sorted(folders)]


@contextmanager
def local(where: Place) -> Iterator[Path]:
    """A session as files of this machine: a path as it is; what a URL names only until this ends.

    Raises SessionError, in words that name the URL.
    """
    if isinstance(where, Path):
        yield where
        return
    with tempfile.TemporaryDirectory(prefix="drivegate-") as directory:
        path = _fetched(where, Path(directory))
        try:
            yield path
        except SessionError as error:
            raise SessionError(str(error).replace(str(path), where)) from None


def _fetched(url: str, directory: Path) -> Path:
    """The folder, or the segment, as it is there. Raises SessionError."""
    files, path = _opened(url)
    folder = directory / (_name(url) or "session")
    if _is_segment(url):
        folder = directory
        wanted = [_Remote(path, _name(url), _asked(url, lambda: files.size(path)))]
        sums = f"{path.rpartition('/')[0]}/{SUMS}"
        if _asked(url, lambda: files.exists(sums)):
            wanted.append(_Remote(sums, SUMS, None))
    else:
        folder.mkdir()
        wanted = [one for one in _listed(url, files, path) if _is_of_session(one.name)]
    _check_room(url, wanted, directory)
    for one in wanted:
        target = folder / one.name
        _asked(url, lambda one=one, target=target: files.get_file(one.path, str(target)))  # type: ignore[misc]
        came = target.stat().st_size
        if one.size not in {None, came}:
            raise SessionError(f"{url}: of {one.name} came {came} bytes of {one.size}")
    return folder / wanted[0].name if _is_segment(url) else folder


def _listed(url: str, files: Any, path: str) -> list[_Remote]:  # noqa: ANN401  # fsspec has no types
    entries = _asked(url, lambda: files.ls(path, detail=True))
    found = [(str(entry["name"]), entry) for entry in entries if entry["type"] == "file"]
    return [_Remote(name, PurePosixPath(name).name, entry.get("size")) for name, entry in found]


def _is_of_session(name: str) -> bool:
    return name == SUMS or segment_number(Path(name)) is not None


def _check_room(url: str, wanted: list[_Remote], directory: Path) -> None:
    needed, free = sum(one.size or 0 for one in wanted), shutil.disk_usage(directory).free
    if needed > free:
        raise SessionError(
            f"{url}: it needs {needed / 1e6:.1f} MB in {directory.parent}, where {free / 1e6:.1f} MB are free; "
            "TMPDIR names another place"
        )


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and what it is there. Raises SessionError."""
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415  # an extra
    except ImportError:
        raise SessionError(f"{url}: {EXTRA}") from None
    files, path = _asked(url, lambda: url_to_fs(url))
    return files, path.rstrip("/")


def _asked(url: str, ask: Callable[[], _T]) -> _T:
    """What a file system answers. Raises SessionError for whatever it raises: each has errors of its own."""
    try:
        return ask()
    except FileNotFoundError:
        raise SessionError(f"{url}: there is no such file or folder") from None
    except ImportError as error:  # of the package that knows this scheme
        raise SessionError(f"{url}: {error}") from None
    except Exception as error:
        raise SessionError(f"{url}: {str(error) or type(error).__name__}") from None


def _is_segment(url: str) -> bool:
    return _name(url).endswith(".rrd")


def _name(url: str) -> str:
    """The last part of its path, without what a signature adds."""
    return PurePosixPath(url.partition("?")[0]).name.strip(".")


def _below(name: str, base: PurePosixPath) -> bool:
    return PurePosixPath(name).is_relative_to(base)
