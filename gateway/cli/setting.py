"""`drivegate set`: change a setting of a running robot, until it is restarted."""

from typing import Annotated

import typer

from gateway.cli.operate import EXIT_REFUSED, Connect, RobotName, open_client, tell
from gateway.cli.output import complain
from gateway.edges.messages import encode_setting


def set(  # the command's name
    name: RobotName,
    setting: Annotated[str, typer.Argument(help="Name of the setting, e.g. speed_override.")],
    value: Annotated[float, typer.Argument(help="Its new value.")],
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Change a setting of a running robot; `drivegate watch NAME --json` shows them all, with their ranges."""
    try:
        encode_setting(setting, value)
    except ValueError as error:
        complain(str(error))
        raise typer.Exit(EXIT_REFUSED) from None
    with open_client(name, connect) as client:
        answer = client.set(setting, value)
    tell(answer, json=json, done=f"{setting} = {value:g} until the robot is restarted")
