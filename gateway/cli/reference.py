"""`drivegate reference`: tell a running robot at which angle a steered joint stands."""

from typing import Annotated

import typer

from gateway.cli.operate import EXIT_REFUSED, Connect, RobotName, open_client, tell
from gateway.cli.output import complain
from gateway.edges.messages import encode_reference


def reference(
    name: RobotName,
    motor: Annotated[str | None, typer.Option(help="Motor of the joint; not needed where only one is steered.")] = None,
    angle: Annotated[float, typer.Option(help="Where it stands now, rad at the output, from its zero.")] = 0.0,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Say at which angle a steered joint stands; the robot believes it, so measure or align it first."""
    try:
        encode_reference(motor, angle)
    except ValueError as error:
        complain(str(error))
        raise typer.Exit(EXIT_REFUSED) from None
    with open_client(name, connect) as client:
        answer = client.reference(motor, angle)
    tell(
        answer,
        json=json,
        done=f"{motor or 'the steered joint'} stands at {angle:g} rad, as you said: the robot believes it",
    )
