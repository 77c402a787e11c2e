"""All commands in one list; each lives in the module named after what it is about."""

import sys

import typer

from gateway.cli.check import check
from gateway.cli.demo import demo
from gateway.cli.drive import drive
from gateway.cli.operate import send, stop, watch
from gateway.cli.output import EXIT_CONFIG, complain
from gateway.cli.replay import replay
from gateway.cli.run import run
from gateway.cli.sim import sim
from gateway.config import ConfigError
from gateway.exclusive import InUseError
from gateway.zenoh_session import LinkError

EXIT_UNAVAILABLE = 69  # EX_UNAVAILABLE of sysexits.h

app = typer.Typer(
    name="drivegate",
    help="From a velocity command over Zenoh to CAN motor controllers, recorded and replayable.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (run, check, drive, send, watch, stop, demo, sim):
    app.command()(command)
app.add_typer(replay, name="replay")


def main() -> None:
    """Entry point of the console script: errors of the user's making are words, not tracebacks."""
    try:
        app()
    except ConfigError as error:
        complain(str(error))
        sys.exit(EXIT_CONFIG)
    except (LinkError, InUseError) as error:
        complain(str(error))
        sys.exit(EXIT_UNAVAILABLE)
