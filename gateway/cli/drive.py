"""`drivegate drive`: keyboard teleoperation in a terminal.

A terminal reports presses and repeats, no releases: a key counts as held until its repeats stop for RELEASE_S. Then,
at exit and on any error, zero is sent; if even that fails the robot's own command timeout stops it.

Nothing here waits for the robot: a stop is put at once, and threads of their own wait for what it answers.
"""

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, TextIO

import typer
from rich.live import Live
from rich.text import Text

from gateway.cli.operate import (
    EXIT_REFUSED,
    Connect,
    RobotName,
    is_refusal,
    mode_words,
    open_client,
)
from gateway.cli.output import complain, console
from gateway.client import Client
from gateway.commander import COMMAND_RATE_HZ, objection
from gateway.edges.messages import ResetAnswer
from gateway.types import ZERO_TWIST, Level, Region, Twist

MAX_READ = 1024  # bytes; a second of keys is far less
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


def drive(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    name: RobotName,
    speed: Annotated[float, typer.Option(min=0.01, max=5.0, help="Speed while a key is held, m/s.")] = 0.3,
    turn: Annotated[float, typer.Option(min=0.01, max=10.0, help="Turn rate while a key is held, rad/s.")] = 0.6,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    region: Annotated[Region, typer.Option(help="Which way round the chassis is to go; it may turn round first.")] = (
        Region.ANY
    ),
    connect: Connect = None,
) -> None:
    """Drive with the keyboard; zero as soon as no key is held and when this ends."""
    if not sys.stdin.isatty():
        complain("drive needs a terminal; use `drivegate send` in scripts")
        raise typer.Exit(2)
    with open_client(name, connect, zero_on_exit=True) as client:
        robot = _Robot(client, source, region)
        with ThreadPoolExecutor(2) as waiting, _raw(sys.stdin):
            _loop(robot, Keys(Twist(speed, speed, turn)), waiting)
    if robot.stop is not None and not robot.stop.result():
        complain(f"{name} did not confirm the emergency stop")
        raise typer.Exit(EXIT_REFUSED)


@dataclass(slots=True)
class Keys:
    """What the keys ask for. Time is an argument, s."""

    scale: Twist
    stop: bool = False  # asked for by the last read; so for the next two
    reset: bool = False
    quit: bool = False
    _held: Twist = ZERO_TWIST
    _held_since: float = 0.0

    def press(self, keys: str, now: float) -> None:
        """All keys of one read: of those that move the last one counts, and a stop wins over all that move or reset."""
        self.stop, self.quit = STOP_KEY in keys, not QUIT_KEYS.isdisjoint(keys)
        self.reset = RESET_KEY in keys and not self.stop
        for key in keys:
            if key in KEYS:
                self._held, self._held_since = KEYS[key], now
        if self.stop or now - self._held_since > RELEASE_S:
            self._held = ZERO_TWIST

    @property
    def twist(self) -> Twist:
        """What is to be sent."""
        return Twist(*(part * size for part, size in zip(self._held, self.scale, strict=True)))


@dataclass(slots=True)
class _Robot:
    """The robot as this command sees it: what it was asked, what it answered, and its last word on our source."""

    client: Client
    source: str
    region: Region = Region.ANY
    stop: Future[bool] | None = None
    reset: Future[ResetAnswer] | None = None
    told: str = ""

    @property
    def stopping(self) -> bool:
        return self.stop is not None and not self.stop.done()

    def ask(self, keys: Keys, waiting: ThreadPoolExecutor) -> None:
        """A stop is put at once, whatever is still waited for."""
        if keys.stop:
            self.client.stop(timeout=0.0)
            self.stop = self.stop if self.stopping else waiting.submit(self.client.stop)
        if keys.reset and (self.reset is None or self.reset.done()):
            self.reset = waiting.submit(self.client.reset)

    def hear(self) -> None:
        """Keeps the newest event that a driver should see."""
        for event in self.client.events():
            manoeuvre = event.code.startswith("manoeuvre_")
            if event.level is not Level.INFO or manoeuvre or is_refusal(event, self.source):
                self.told = f"{event.code}: {event.text}"


def _loop(robot: _Robot, keys: Keys, waiting: ThreadPoolExecutor) -> None:
    with Live(console=console, refresh_per_second=10) as live:
        while True:
            keys.press(_read(1.0 / COMMAND_RATE_HZ), time.monotonic())
            robot.ask(keys, waiting)
            if keys.quit:
                return
            twist = ZERO_TWIST if robot.stopping else keys.twist
            robot.client.send_twist(*twist, source=robot.source, region=robot.region)
            robot.hear()
            live.update(Text("\n".join(_lines(robot, twist))))


def _read(timeout: float) -> str:
    """The keys pressed within the timeout; the end of the terminal counts as the key that quits."""
    # Not through sys.stdin: what it buffers, select does not see, and a stop key would wait for the next key.
    if not select.select([sys.stdin], [], [], timeout)[0]:
        return ""
    return os.read(sys.stdin.fileno(), MAX_READ).decode(errors="ignore") or "x"


def _lines(robot: _Robot, twist: Twist) -> Iterator[str]:
    client, odometry = robot.client, robot.client.odometry()
    yield HELP
    yield f"command  vx {twist.vx:+.2f}  vy {twist.vy:+.2f}  wz {twist.wz:+.2f}"
    yield f"mode     {mode_words(client)}"
    yield f"source   {objection(client, robot.source) or f'{robot.source} drives'}"
    if odometry is not None:
        yield f"pose     x {odometry.x:+.2f}  y {odometry.y:+.2f}  theta {odometry.theta:+.2f}"
    if robot.stop is not None:
        yield f"stop     {'sent' if robot.stopping else 'confirmed' if robot.stop.result() else 'NOT CONFIRMED'}"
    if robot.reset is not None and robot.reset.done():
        answer = robot.reset.result()
        yield f"reset    {'granted' if answer.ok else answer.reason}"
    if robot.told:
        yield f"last     {robot.told}"


@contextmanager
def _raw(terminal: TextIO) -> Iterator[None]:
    """Keys without Enter and without echo; restored whatever happens."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
