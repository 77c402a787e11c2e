"""`drivegate drive`: by hand, with the keys of a terminal or with a gamepad.

What they ask for is made into a command in one place (`gateway.teleop.hand`). At exit and on any error, zero is sent;
if even that fails the robot's own command timeout stops it.

Nothing here waits for the robot: a stop is put at once, and threads of their own wait for what it answers.
"""

import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Annotated, Protocol, TextIO

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
from gateway.cli.output import complain, console, note
from gateway.client import Client
from gateway.commander import COMMAND_RATE_HZ, objection
from gateway.edges.evdev import Gamepad, open_gamepad, words
from gateway.edges.messages import ResetAnswer
from gateway.teleop.hand import Hand, Wish
from gateway.teleop.keys import HELP, MOVING_HELP, Keys
from gateway.types import ZERO_TWIST, Level, Region, Twist

MAX_READ = 1024  # bytes; a second of keys is far less
ENDING = (signal.SIGTERM, signal.SIGHUP)  # as Ctrl-C
# It goes on while the computer sleeps, which a hand that is held over it should not survive.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


def drive(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    name: RobotName,
    speed: Annotated[float, typer.Option(min=0.01, max=5.0, help="Speed at full scale, m/s.")] = 0.3,
    turn: Annotated[float, typer.Option(min=0.01, max=10.0, help="Turn rate at full scale, rad/s.")] = 0.6,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    region: Annotated[Region, typer.Option(help="Which way round the chassis is to go; it may turn round first.")] = (
        Region.ANY
    ),
    gamepad: Annotated[
        bool,
        typer.Option("--gamepad", help="With a gamepad; the keys of a terminal still stop, reset and quit."),
    ] = False,
    device: Annotated[
        str | None, typer.Option(help="With --gamepad: which one, by its path or a part of its name.")
    ] = None,
    connect: Connect = None,
) -> None:
    """Drive with the keyboard or a gamepad; zero as soon as no key or dead-man is held, and when this ends."""
    if device is not None and not gamepad:
        raise typer.BadParameter("needs --gamepad", param_hint="--device")
    if not gamepad and not sys.stdin.isatty():
        complain("drive needs a terminal, or --gamepad; use `drivegate send` in scripts")
        raise typer.Exit(2)
    for number in ENDING:
        signal.signal(number, _interrupt)
    with ExitStack() as opened:
        pad = opened.enter_context(open_gamepad(device)) if gamepad else None
        client = opened.enter_context(open_client(name, connect, zero_on_exit=True))
        if sys.stdin.isatty():
            opened.enter_context(_raw(sys.stdin))
        waiting = opened.enter_context(ThreadPoolExecutor(2))
        robot = _Robot(client, source, region)
        _loop(robot, _Keyboard() if pad is None else _Pad(pad), Hand(Twist(speed, speed, turn)), waiting)
    if robot.stop is not None and not robot.stop.result():
        complain(f"{name} did not confirm the emergency stop")
        raise typer.Exit(EXIT_REFUSED)


class _Device(Protocol):
    """What a hand is on. `help`: how it is used; `again`: how what does not count is made to; `why`: it does not."""

    help: str
    again: str

    @property
    def why(self) -> str: ...

    def wish(self, timeout: float) -> Wish: ...


@dataclass(slots=True)
class _Keyboard:
    help: str = f"{MOVING_HELP}  {HELP}"
    again: str = "let go of the keys (or press space), then press anew"
    why: str = ""
    _keys: Keys = field(default_factory=Keys)

    def wish(self, timeout: float) -> Wish:
        """What the keys ask for that come within the timeout."""
        return self._keys.press(_read(timeout), _now())


class _Pad:
    """A gamepad; where there is a terminal its keys stop, reset and quit."""

    def __init__(self, gamepad: Gamepad) -> None:
        layout = gamepad.layout
        note(f"gamepad {words(gamepad.device)}")
        self.help = (
            f"hold {layout.deadman_name}: left stick drives, right stick turns  d-pad up/down speed  "
            f"{layout.stop_name} emergency stop{'  ' + HELP if sys.stdin.isatty() else ''}"
        )
        self.again = f"press {layout.deadman_name} anew, with the sticks at rest"
        self._gamepad = gamepad
        self._terminal = [sys.stdin] if sys.stdin.isatty() else []

    @property
    def why(self) -> str:
        """What is held does not count; empty where nothing of the pad is in its way."""
        return self._gamepad.pad.why

    def wish(self, timeout: float) -> Wish:
        """What it asks for after the timeout, or at once where it lets go or stops. Raises GamepadError."""
        deadline, keys = time.monotonic() + timeout, ""
        while not keys and (left := deadline - time.monotonic()) > 0.0:
            ready = select.select([self._gamepad.descriptor, *self._terminal], [], [], left)[0]
            keys = _read(0.0) if sys.stdin in ready else ""
            if self._gamepad.descriptor in ready and self._gamepad.read(_now()):
                break
        asked = Keys().press(keys, 0.0)
        found = self._gamepad.pad.wish(_now())
        return found._replace(stop=found.stop or asked.stop, reset=asked.reset and not found.stop, quit=asked.quit)


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

    def ready(self) -> bool:
        """Whether it drives what we send."""
        return not self.stopping and objection(self.client, self.source) is None

    def send(self, twist: Twist) -> None:
        """One command."""
        self.client.send_twist(*twist, source=self.source, region=self.region)

    def ask(self, wish: Wish, waiting: ThreadPoolExecutor) -> None:
        """A stop is put at once, whatever is still waited for."""
        if wish.stop:
            self.client.stop(timeout=0.0)
            self.stop = self.stop if self.stopping else waiting.submit(self.client.stop)
        if wish.reset and (self.reset is None or self.reset.done()):
            self.reset = waiting.submit(self.client.reset)

    def hear(self) -> None:
        """Keeps the newest event that a driver should see."""
        for event in self.client.events():
            manoeuvre = event.code.startswith("manoeuvre_")
            if event.level is not Level.INFO or manoeuvre or is_refusal(event, self.source):
                self.told = f"{event.code}: {event.text}"


def _loop(robot: _Robot, device: _Device, hand: Hand, waiting: ThreadPoolExecutor) -> None:
    """Until it is quit; zero is sent at its end, whatever ends it."""
    with Live(console=console, refresh_per_second=10) as live, suppress(KeyboardInterrupt):
        try:
            while True:
                wish = device.wish(1.0 / COMMAND_RATE_HZ)
                robot.ask(wish, waiting)  # also in the look that quits: no stop is lost
                if wish.quit:
                    break
                twist = hand.order(wish, _now(), ready=robot.ready())
                robot.send(twist)
                robot.hear()
                live.update(Text("\n".join(_lines(robot, device, hand, wish, twist))))
        finally:
            robot.send(ZERO_TWIST)


def _read(timeout: float) -> str:
    """The keys pressed within the timeout; the end of the terminal counts as the key that quits."""
    # Not through sys.stdin: what it buffers, select does not see, and a stop key would wait for the next key.
    if not select.select([sys.stdin], [], [], timeout)[0]:
        return ""
    return os.read(sys.stdin.fileno(), MAX_READ).decode(errors="ignore") or "x"


def _lines(robot: _Robot, device: _Device, hand: Hand, wish: Wish, twist: Twist) -> Iterator[str]:
    client, odometry = robot.client, robot.client.odometry()
    yield device.help
    yield f"speed    {hand.scale:.0%} of {hand.top.vx:g} m/s, {hand.top.wz:g} rad/s"
    yield f"command  vx {twist.vx:+.2f}  vy {twist.vy:+.2f}  wz {twist.wz:+.2f}"
    if not hand.counts and (wish.press is not None or device.why):
        yield f"held     does not count: {device.why or 'it was held before the robot was ready'}; {device.again}"
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


def _now() -> float:
    return time.clock_gettime(_CLOCK)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def _raw(terminal: TextIO) -> Iterator[None]:
    """Keys without Enter and without echo; restored whatever happens."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
