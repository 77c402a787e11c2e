"""`drivegate set`: change a setting of a running robot, until it is restarted."""

from typing import Annotated

import typer

from gateway.cli.operate import EXIT_REFUSED, Connect, RobotName, open_client, tell
from gateway.cli.output import complain
from gateway.edges.messages import encode_setting


def set(  # the command's name
    name: RobotName,
    setting: Annotated[str, typer.Argument(help="Name of the setting, e.g. speed_override.")],
    value: Annotated[str, typer.Argument(help="Its new value, a number.")],
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Change a setting of a running robot; `drivegate watch NAME --json` shows them all, with their ranges.

    No setting makes a stop weaker (but a commanded zero brakes on the `friction` that is said), and a restart goes back
    to the robot file.
    """
    try:
        encode_setting(setting, 0.0)  # a wrong name before a wrong value: it may be a text that no setting takes
        number = _number(value)
        encode_setting(setting, number)
    except ValueError as error:
        complain(str(error))
        raise typer.Exit(EXIT_REFUSED) from None
    with open_client(name, connect) as client:
        answer = client.set(setting, number)
    tell(answer, json=json, done=f"{setting} = {number:g} until the robot is restarted")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        message = f"value = {text!r}: must be a number"
        raise ValueError(message) from None
