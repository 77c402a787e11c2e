"""The command line itself: every command is there, and the daemon carries nothing it does not need."""

import subprocess
import sys

from gateway.cli.app import COMMANDS

LOADED = "import sys; from gateway.cli.app import build; build({!r}); print(*sorted(sys.modules))"


def modules(command: str) -> set[str]:
    run = [sys.executable, "-c", LOADED.format(command)]
    return set(subprocess.run(run, capture_output=True, text=True, timeout=60, check=True).stdout.split())


def test_the_daemon_never_imports_rerun() -> None:
    assert not modules("run") & {"rerun", "pyarrow"}
    assert not modules("scenario") & {"rerun", "pyarrow"}
    assert "pyarrow" in modules("demo"), "so that the test above can fail"


def test_help_names_every_command() -> None:
    run = [sys.executable, "-m", "gateway", "--help"]
    shown = subprocess.run(run, capture_output=True, text=True, timeout=60, check=True).stdout
    assert all(f" {name} " in shown for name in COMMANDS)


def test_an_unknown_command_is_an_error() -> None:
    run = [sys.executable, "-m", "gateway", "fly"]
    result = subprocess.run(run, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert "fly" in result.stderr
