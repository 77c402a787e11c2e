"""`drivegate stand`: tell a robot that balances that somebody holds it, so that it may stand up, or let itself down."""

from enum import Enum
from typing import Annotated

import typer

from gateway.cli.operate import Connect, RobotName, open_client, tell


class Way(Enum):
    """Which way."""

    UP = "up"
    DOWN = "down"


_DONE = {
    Way.UP: "granted: it stands up with the next zero command, within 10 s",
    Way.DOWN: "granted: it lets go within a second",
}


def stand(
    name: RobotName,
    way: Annotated[Way, typer.Argument(help="Hold it upright before either.")],
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Of a robot that balances: you hold it, and it stands up (with the next zero command), or lets go within 1 s."""
    with open_client(name, connect) as client:
        answer = client.stand_up() if way is Way.UP else client.let_down()
    tell(answer, json=json, done=_DONE[way])
