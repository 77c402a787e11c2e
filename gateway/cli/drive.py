"""`drivegate drive`: keyboard teleoperation in a terminal.

A terminal reports presses and repeats, no releases: a key counts as held until its repeats stop for RELEASE_S. Then,
at exit and on any error, zero is sent; if even that fails the robot's own command timeout stops it.
"""

import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, TextIO

import typer
from rich.live import Live
from rich.text import Text

from gateway.cli.operate import COMMAND_RATE_HZ, Connect, RobotName, open_client
from gateway.cli.output import complain, console
from gateway.client import Client
from gateway.types import ZERO_TWIST, Twist

RELEASE_S = 0.6  # terminals wait up to half a second before the first repeat
KEYS = {
    "w": Twist(1.0, 0.0, 0.0),
    "s": Twist(-1.0, 0.0, 0.0),
    "a": Twist(0.0, 1.0, 0.0),
    "d": Twist(0.0, -1.0, 0.0),
    "q": Twist(0.0, 0.0, 1.0),
    "e": Twist(0.0, 0.0, -1.0),
    " ": ZERO_TWIST,
}
QUIT_KEYS = frozenset({"x", "\x03", "\x04"})
STOP_KEY, RESET_KEY = "!", "r"
HELP = "w/s forward/back  a/d left/right  q/e turn  space zero  ! emergency stop  r reset  x quit"


def drive(
    name: RobotName,
    speed: Annotated[float, typer.Option(min=0.01, max=5.0, help="Speed while a key is held, m/s.")] = 0.3,
    turn: Annotated[float, typer.Option(min=0.01, max=10.0, help="Turn rate while a key is held, rad/s.")] = 0.6,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    connect: Connect = None,
) -> None:
    """Drive with the keyboard; zero as soon as no key is held and when this ends."""
    if not sys.stdin.isatty():
        complain("drive needs a terminal; use `drivegate send` in scripts")
        raise typer.Exit(2)
    with open_client(name, connect, zero_on_exit=True) as client, _raw(sys.stdin):
        _loop(client, source, Twist(speed, speed, turn))


def _loop(client: Client, source: str, scale: Twist) -> None:
    held, held_since = ZERO_TWIST, 0.0
    with Live(console=console, refresh_per_second=10) as live:
        while True:
            key = _key(1.0 / COMMAND_RATE_HZ)
            if key in QUIT_KEYS:
                return
            if key == STOP_KEY:
                client.stop()
            elif key == RESET_KEY:
                client.reset()
            elif key in KEYS:
                held, held_since = KEYS[key], time.monotonic()
            if time.monotonic() - held_since > RELEASE_S:
                held = ZERO_TWIST
            twist = Twist(*(part * size for part, size in zip(held, scale, strict=True)))
            client.send_twist(*twist, source=source)
            live.update(_picture(client, twist))


def _key(timeout: float) -> str | None:
    """The newest key pressed within the timeout."""
    key = None
    while select.select([sys.stdin], [], [], timeout)[0]:
        key, timeout = sys.stdin.read(1), 0.0
        if key == "":
            return "x"
    return key


def _picture(client: Client, twist: Twist) -> Text:
    state, odometry = client.state(), client.odometry()
    lines = [HELP, f"command  vx {twist.vx:+.2f}  vy {twist.vy:+.2f}  wz {twist.wz:+.2f}"]
    if state is not None:
        lines.append(f"mode     {state.status.mode.value}  {state.status.reason or ''}")
    if odometry is not None:
        lines.append(f"pose     x {odometry.x:+.2f}  y {odometry.y:+.2f}  theta {odometry.theta:+.2f}")
    return Text("\n".join(lines))


@contextmanager
def _raw(terminal: TextIO) -> Iterator[None]:
    """Keys without Enter and without echo; restored whatever happens."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
