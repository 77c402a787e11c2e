"""`drivegate mark`: a person's words, to be found in the recording of a running robot."""

from typing import Annotated

import typer

from gateway.cli.operate import EXIT_REFUSED, Connect, RobotName, open_client, tell
from gateway.cli.output import complain
from gateway.edges.messages import encode_mark


def mark(
    name: RobotName,
    text: Annotated[str, typer.Argument(metavar="WORDS", help='What is to be found again, e.g. "it squeals".')],
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Put words into the recording of a running robot, and keep the seconds around them as an incident.

    `drivegate replay incidents DIR` finds them again. Nothing moves.
    """
    try:
        encode_mark(text)
    except ValueError as error:
        complain(str(error))
        raise typer.Exit(EXIT_REFUSED) from None
    with open_client(name, connect) as client:
        answer = client.mark(text)
    tell(answer, json=json, done="marked: it is in the recording, and the seconds around it are kept as an incident")
