"""The command line itself: every command is there, and the daemon carries nothing it does not need."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from gateway.cli.app import COMMANDS, build, said_of
from gateway.errors import UserError

LOADED = "import sys; from gateway.cli.app import build; build({!r}); print(*sorted(sys.modules))"


def modules(command: str | None) -> set[str]:
    run = [sys.executable, "-c", LOADED.format(command)]
    return set(subprocess.run(run, capture_output=True, text=True, timeout=60, check=True).stdout.split())


def test_the_daemon_never_imports_rerun() -> None:
    assert not modules("run") & {"rerun", "pyarrow"}
    assert not modules("scenario") & {"rerun", "pyarrow"}
    assert "pyarrow" in modules("demo"), "so that the test above can fail"


def test_the_daemon_of_a_real_robot_knows_of_no_faults_that_can_be_given() -> None:
    assert not {one for one in modules("run") if one.startswith("replay.drive") or one == "gateway.cli.simulation"}
    assert "replay.drive.live_faults" in modules("fault"), "so that the test above can fail"


def test_the_list_of_commands_needs_none_of_them() -> None:
    heavy = {"zenoh", "can", "rerun", "pyarrow", "numpy", "pydantic"}
    assert not modules(None) & heavy
    assert not modules("check") & (heavy - {"pydantic"} | {"matplotlib", "jinja2", "scipy", "tomlkit", "msgspec"})
    assert not modules("check") & {"gateway.setup.picture", "gateway.cli.picture", "xml.etree", "asyncio"}
    assert "zenoh" in modules("send"), "so that the test above can fail"


def test_garbage_is_collected_again_once_everything_is_imported() -> None:
    """A switch that stays off would fill the memory of a daemon."""
    code = (
        "import atexit, gc, sys; from gateway.cli import main; sys.argv = ['drivegate', 'check', 'moby', '--json']; "
        "atexit.register(lambda: print(gc.isenabled(), gc.get_freeze_count() > 10_000)); main()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.splitlines()[-1] == "True True"


@pytest.mark.parametrize("name", COMMANDS)
def test_what_the_list_says_is_what_the_command_says(name: str) -> None:
    command = getattr(import_module(f"gateway.cli.{COMMANDS[name]}"), name)
    said = command.info.help if isinstance(command, typer.Typer) else command.__doc__
    assert said_of(name).split() == str(said).split()
    assert CliRunner().invoke(build(name), [name, "--help"]).exit_code == 0


def test_a_command_that_is_not_in_its_module() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(COMMANDS, "fly", "check")
        with pytest.raises(LookupError, match="fly"):
            said_of("fly")


def test_errors_of_the_users_making_have_their_exit_codes() -> None:
    for module, name, code in (
        ("gateway.config", "ConfigError", 78),
        ("gateway.edges.zenoh_session", "LinkError", 69),
        ("gateway.edges.claims", "InUseError", 69),
        ("gateway.recording.recorder", "RecorderError", 69),
    ):
        error = getattr(import_module(module), name)
        assert issubclass(error, UserError)
        assert error.exit_code == code


def test_help_names_every_command() -> None:
    run = [sys.executable, "-m", "gateway", "--help"]
    shown = subprocess.run(run, capture_output=True, text=True, timeout=60, check=True).stdout
    assert all(f" {name} " in shown for name in COMMANDS)


def test_an_unknown_command_is_an_error() -> None:
    run = [sys.executable, "-m", "gateway", "fly"]
    result = subprocess.run(run, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert "fly" in result.stderr


def test_the_readme_has_a_line_for_each_command_and_for_no_other() -> None:
    readme = (Path(__file__).parent.parent.parent / "README.md").read_text(encoding="utf-8")
    told = set(re.findall(r"^\| `drivegate (\w+)", readme, re.MULTILINE))
    assert told == set(COMMANDS)
