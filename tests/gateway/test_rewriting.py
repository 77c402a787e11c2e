"""A file of a person is changed whole or not at all, and never over what somebody wrote meanwhile."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.cli.correcting import correct
from gateway.cli.rewriting import RewriteError, create, rewrite, rewrite_keeping
from gateway.config import load
from gateway.setup.correction import Change
from tests.world import robot_text

CHANGE = Change("front_left", "direction", 1, -1)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(robot_text("omni4"))
    return path


def test_line_ends_are_kept(file: Path) -> None:
    before = file.read_bytes().replace(b"\n", b"\r\n")
    file.write_bytes(before)
    kept = correct(file, load(file)[1], [CHANGE], yes=True)
    assert kept is not None
    assert kept.read_bytes() == before
    assert file.read_bytes() == before.replace(b"direction = 1\r", b"direction = -1\r", 1)


@pytest.mark.parametrize("write", [rewrite, rewrite_keeping])
def test_what_somebody_wrote_meanwhile_is_not_overwritten(
    file: Path, write: Callable[[Path, str, str], object]
) -> None:
    text = load(file)[1]
    file.write_text(f"{text}# by somebody else\n")
    with pytest.raises(RewriteError, match="changed meanwhile"):
        write(file, text, "new")
    assert file.read_text() == f"{text}# by somebody else\n"
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("place", [1, 2])
def test_a_full_disk_leaves_nothing_half_written(file: Path, monkeypatch: pytest.MonkeyPatch, place: int) -> None:
    text, asked = load(file)[1], []

    def full(_descriptor: int) -> None:
        asked.append(1)
        if len(asked) == place:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RewriteError, match="No space left"):
        rewrite_keeping(file, text, "new")
    assert file.read_text() == text
    assert list(file.parent.iterdir()) == [file]


def test_a_full_disk_leaves_no_half_of_a_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        create(tmp_path / "courses.toml", "new")
    assert list(tmp_path.iterdir()) == []


def test_a_link_stays_one(file: Path) -> None:
    link = file.with_name("link.toml")
    link.symlink_to(file)
    rewrite(link, load(link)[1], "new")
    assert link.is_symlink()
    assert file.read_text() == "new"
