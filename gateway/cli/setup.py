"""`drivegate setup`: from a box of parts to a first safe motion."""

import typer

from gateway.cli.setup_directions import directions
from gateway.cli.setup_jog import jog
from gateway.cli.setup_new import new
from gateway.cli.setup_prepare import prepare
from gateway.cli.setup_scan import scan

setup = typer.Typer(no_args_is_help=True, help="From a box of parts to a first safe motion, step by step.")
setup.command()(new)
setup.command()(scan)
setup.command()(prepare)
setup.command()(directions)
setup.command()(jog)
