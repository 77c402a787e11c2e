"""All commands in one table; each lives in the module named after what it is about.

Only the module of the command that is called is imported: the daemon must not carry what the others need (Rerun
alone would cost it 80 MB and half a second), and a stop should not wait for imports either.
"""

import sys
from importlib import import_module
from typing import Annotated

import typer

from gateway.build import version
from gateway.cli.output import EXIT_CONFIG, complain, console
from gateway.config import ConfigError
from gateway.edges.claims import InUseError
from gateway.edges.zenoh_session import LinkError
from gateway.recording.recorder import RecorderError

EXIT_UNAVAILABLE = 69  # EX_UNAVAILABLE of sysexits.h
COMMANDS = {  # command: module of gateway.cli that has a function (or a group) of that name
    "run": "run",
    "check": "check",
    "doctor": "doctor",
    "drive": "drive",
    "send": "operate",
    "path": "path",
    "watch": "operate",
    "stop": "operate",
    "reference": "reference",
    "stand": "stand",
    "set": "setting",
    "calibrate": "calibrate",
    "setup": "setup",
    "demo": "demo",
    "sim": "sim",
    "scenario": "scenario",
    "replay": "replay",
    "reproduce": "reproduce",
}


def _show_version(asked: bool) -> None:
    if asked:
        console.print(f"drivegate {version()}", highlight=False)
        raise typer.Exit


def build(called: str | None) -> typer.Typer:
    """The command line with the command that is called; with all of them when that is none or unknown."""
    app = typer.Typer(
        name="drivegate",
        help="From a velocity command over Zenoh to CAN motor controllers, recorded and replayable.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # joins the lines of a docstring
    )
    app.callback()(_options)  # also keeps the command's name in use even when it is the only one
    for name in [called] if called in COMMANDS else COMMANDS:
        command = getattr(import_module(f"gateway.cli.{COMMANDS[name]}"), name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Version and form of the core.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Options of the command line itself."""


def main() -> None:
    """Entry point of the console script: errors of the user's making are words, not tracebacks."""
    try:
        build(sys.argv[1] if len(sys.argv) > 1 else None)()
    except ConfigError as error:
        complain(str(error))
        sys.exit(EXIT_CONFIG)
    except (LinkError, InUseError, RecorderError) as error:
        complain(str(error))
        sys.exit(EXIT_UNAVAILABLE)
