"""`drivegate format`: the whole format of the robot file, from the models that judge it."""

from typing import Annotated

import typer

from gateway.chassis import CHASSIS
from gateway.cli.explain import document, show
from gateway.cli.output import EXIT_CONFIG, complain, print_json
from gateway.config import RobotConfig
from gateway.file_keys import rules
from gateway.guess import guess


def format(  # the command's name
    chassis: Annotated[str | None, typer.Option(help="Only this kind of [robot].", show_default="all")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable list.")] = False,
) -> None:
    """Print every key of the robot file with its range, unit, default and meaning."""
    if chassis is not None and chassis not in CHASSIS:
        complain(f"--chassis = {chassis!r}: must be one of {', '.join(CHASSIS)}{guess(chassis, CHASSIS)}")
        raise typer.Exit(EXIT_CONFIG)
    found = [rule for rule in rules(RobotConfig) if chassis is None or rule.chassis in (None, chassis)]
    if json:
        print_json({"keys": [document(rule) for rule in found]})
        return
    for rule in found:
        show(rule)
