"""A file that a person wrote is changed whole or not at all, and keeps its place, rights and owner."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


class RewriteError(RuntimeError):
    """Why a file cannot be changed; it is as it was."""


@contextmanager
def drafted(file: Path, text: str) -> Iterator[Path]:
    """The new text beside the file, with its rights; gone at the end unless it was moved. Raises RewriteError."""
    try:
        place = file.resolve()
        if not os.access(place, os.W_OK):
            raise RewriteError(f"{file} cannot be written: it is read-only")
        with tempfile.NamedTemporaryFile("wb", dir=place.parent, prefix=f".{place.name}.", delete=False) as new:
            try:
                new.write(text.encode())
                new.flush()
                os.fsync(new.fileno())
                _as_of(place, new.fileno())
                yield Path(new.name)
            finally:
                Path(new.name).unlink(missing_ok=True)
    except OSError as error:
        raise RewriteError(f"{file} cannot be written: {error.strerror}") from None


def rewrite(file: Path, old: str, new: str) -> None:
    """Put the new text in place of the old one. Raises RewriteError, also where the file has another one by now."""
    with _put(file, old, new):
        pass


def rewrite_keeping(file: Path, old: str, new: str) -> Path:
    """The same; the old text is kept beside it, under a name that nobody has yet."""
    with _put(file, old, new):
        return _keep(file, old)


@contextmanager
def _put(file: Path, old: str, new: str) -> Iterator[None]:
    """Put the new text into the file at the end."""
    with drafted(file, new) as draft:
        if file.read_bytes() != old.encode():
            raise RewriteError(f"{file} was changed meanwhile, and that is not overwritten: run it again")
        yield
        draft.replace(file.resolve())


def _keep(file: Path, text: str) -> Path:
    """The copy. Raises RewriteError."""
    place = file.resolve()
    number = 0
    while True:
        number += 1
        copy = place.with_name(f"{place.name}.before{number}")
        try:
            create(copy, text)
        except FileExistsError:
            continue
        except OSError as error:
            raise RewriteError(f"no copy of {file} can be kept: {error.strerror}") from None
        return copy


def create(file: Path, text: str) -> None:
    """A new file, whole or not at all. Raises OSError, FileExistsError where there is one."""
    with file.open("xb") as new:
        try:
            new.write(text.encode())
            new.flush()
            os.fsync(new.fileno())
        except OSError:
            file.unlink()
            raise


def _as_of(file: Path, new: int) -> None:
    """Rights and, as far as whoever calls may give it away, owner of another file."""
    was = file.stat()
    os.fchmod(new, was.st_mode & 0o7777)
    with suppress(PermissionError):
        os.fchown(new, was.st_uid, was.st_gid)
