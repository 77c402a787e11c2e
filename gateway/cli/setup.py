"""`drivegate setup`: from a box of parts to a first safe motion."""

import typer

from gateway.cli.setup_calibrate import calibrate
from gateway.cli.setup_covariance import covariance
from gateway.cli.setup_directions import directions
from gateway.cli.setup_id import id
from gateway.cli.setup_jog import jog
from gateway.cli.setup_new import new
from gateway.cli.setup_prepare import prepare
from gateway.cli.setup_reference import reference
from gateway.cli.setup_scan import scan
from gateway.cli.setup_tune import tune

setup = typer.Typer(no_args_is_help=True, help="From a box of parts to a first safe motion, step by step.")
setup.command()(new)
setup.command()(scan)
setup.command()(id)
setup.command()(prepare)
setup.command()(directions)
setup.command()(reference)
setup.command()(jog)
setup.command()(tune)
setup.command()(calibrate)
setup.command()(covariance)
