"""The browser of `python -m tests.browser` is installed where it is missing; without one the lane fails."""

import shutil

import pytest

from tests.browser import __main__ as lane
from tests.browser import debian
from tests.vm import packages


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What is installed: nothing is there, and an installation brings nothing."""
    asked: list[list[str]] = []
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr(packages, "install", asked.append)
    monkeypatch.setattr("sys.argv", ["tests.browser"])
    return asked


def test_a_machine_without_a_browser_fails(installed: list[list[str]], capsys: pytest.CaptureFixture[str]) -> None:
    assert lane.main() == 1
    assert "FAIL no browser" in capsys.readouterr().out
    assert {"chromium-headless-shell", "chromium"} <= {package for wanted in installed for package in wanted}


def test_the_first_that_comes_is_taken(installed: list[list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    def which(name: str, **_: object) -> str | None:
        return f"/usr/bin/{name}" if any(name in wanted for wanted in installed) else None

    monkeypatch.setattr(shutil, "which", which)
    assert debian.program() == "/usr/bin/chromium-headless-shell"
    assert len(installed) == 1
