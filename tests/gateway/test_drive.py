"""The loop of `drivegate drive`, its keyboard and its gamepad; on a real robot: `tests.e2e`, `tests.vm`."""

import os
import select
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest

from gateway.cli.drive import _Device, _Keyboard, _loop, _Pad, _raw, _Robot
from gateway.client import Client
from gateway.edges.evdev import Gamepad, GamepadError
from gateway.edges.messages import StateMessage
from gateway.teleop import pad as codes
from gateway.teleop.hand import Hand, Wish
from gateway.types import ZERO_TWIST, Mode, Region, Twist
from tests.gateway.test_evdev import CENTRED, XPAD, Machine, put
from tests.gateway.test_operate import _state

TOP = Twist(0.5, 0.5, 1.0)
FORWARD = Twist(0.5, 0.0, 0.0)
DRIVES = _state(Mode.DRIVE)
QUIT = Wish(quit=True)
WAIT_S = 10.0


def held(press: int) -> Wish:
    return Wish(Twist(1.0, 0.0, 0.0), press)


@dataclass
class FakeClient:
    """A robot that says one state after the other, one per command; `heard`: twists, and of stops their timeouts."""

    states: list[StateMessage] = field(default_factory=lambda: [DRIVES])
    alive: bool = True
    heard: list[Twist | float] = field(default_factory=list)

    @property
    def sent(self) -> list[Twist]:
        return [one for one in self.heard if isinstance(one, Twist)]

    def state(self) -> StateMessage:
        return self.states[min(len(self.sent), len(self.states) - 1)]

    def state_age(self) -> float:
        return 0.0

    def odometry(self) -> None:
        return None

    def events(self) -> list[Any]:
        return []

    def send_twist(self, vx: float, vy: float, wz: float, *, source: str, region: Region) -> None:
        assert (source, region) == ("teleop", Region.ANY)
        self.heard.append(Twist(vx, vy, wz))

    def stop(self, timeout: float = 2.0) -> bool:
        self.heard.append(timeout)
        return True

    def reset(self) -> None:
        raise AssertionError("no thread asks")


@dataclass
class Unanswered:
    """Threads of which none has begun yet."""

    asked: list[Callable[[], object]] = field(default_factory=list)

    def submit(self, ask: Callable[[], object]) -> Future[object]:
        self.asked.append(ask)
        return Future()


@dataclass
class Script:
    """A device that tells one wish per look; an error is raised."""

    looks: Iterator[Wish | BaseException]
    help: str = ""
    again: str = ""
    why: str = ""

    def wish(self, timeout: float) -> Wish:
        assert timeout > 0.0
        look = next(self.looks)
        if isinstance(look, BaseException):
            raise look
        return look


@pytest.fixture(autouse=True)
def _no_look_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.cli.drive._now", lambda: 0.0)


def run(client: FakeClient, device: _Device) -> Unanswered:
    waiting = Unanswered()
    _loop(_Robot(cast(Client, client), "teleop"), device, Hand(TOP), cast(ThreadPoolExecutor, waiting))
    return waiting


def script(*looks: Wish | BaseException) -> Script:
    return Script(iter(looks))


# what is held


def test_what_is_held_drives() -> None:
    client = FakeClient()
    run(client, script(Wish(), held(1), held(1), Wish(), QUIT))
    assert client.sent == [ZERO_TWIST, FORWARD, FORWARD, ZERO_TWIST, ZERO_TWIST]


@pytest.mark.parametrize("objects", [_state(Mode.IDLE), _state(Mode.FAULT), _state(Mode.DRIVE, winner="joy")])
def test_what_is_held_over_an_objection_wants_another_press(objects: StateMessage) -> None:
    client = FakeClient([DRIVES, DRIVES, objects, DRIVES])
    run(client, script(Wish(), held(1), held(1), held(1), held(2), QUIT))
    assert client.sent == [ZERO_TWIST, FORWARD, ZERO_TWIST, ZERO_TWIST, FORWARD, ZERO_TWIST]


def test_what_is_pressed_before_a_stop_is_answered_does_not_count() -> None:
    client = FakeClient()
    run(client, script(Wish(), Wish(stop=True), held(1), held(1), QUIT))
    assert set(client.sent) == {ZERO_TWIST}


# stop


def test_a_stop_is_put_at_once_and_waited_for_elsewhere() -> None:
    client = FakeClient()
    waiting = run(client, script(Wish(), held(1), held(1)._replace(stop=True), Wish(stop=True), QUIT))
    assert client.heard == [ZERO_TWIST, FORWARD, 0.0, ZERO_TWIST, 0.0, ZERO_TWIST, ZERO_TWIST]
    assert waiting.asked == [client.stop], "the one that is waited for puts it again by itself"


def test_a_stop_is_put_while_a_reset_is_waited_for() -> None:
    client = FakeClient()
    waiting = run(client, script(Wish(reset=True), Wish(reset=True), Wish(stop=True), QUIT))
    assert waiting.asked == [client.reset, client.stop]
    assert 0.0 in client.heard


# the end


@pytest.mark.parametrize("end", [QUIT, KeyboardInterrupt(), GamepadError("it is gone")], ids=["quit", "Ctrl-C", "gone"])
def test_zero_is_the_last_that_is_sent(end: Wish | BaseException) -> None:
    client = FakeClient()
    with suppress(GamepadError):
        run(client, script(Wish(), held(1), end))
    assert client.heard == [ZERO_TWIST, FORWARD, ZERO_TWIST]


def test_a_pad_that_is_gone_is_told() -> None:
    with pytest.raises(GamepadError, match="it is gone"):
        run(FakeClient(), script(GamepadError("it is gone")))


# keys of a terminal


class Typist:
    """Somebody at a terminal, which is our standard input."""

    def __init__(self, keyboard: int, terminal: int) -> None:
        self._keyboard, self._terminal = keyboard, terminal

    def type(self, keys: str) -> None:
        """They can be read when this returns."""
        os.write(self._keyboard, keys.encode())
        if keys:
            assert select.select([self._terminal], [], [], WAIT_S)[0]


@pytest.fixture
def typist(monkeypatch: pytest.MonkeyPatch) -> Iterator[Typist]:
    keyboard, terminal = os.openpty()
    with os.fdopen(terminal) as stdin, _raw(stdin):
        monkeypatch.setattr(sys, "stdin", stdin)
        yield Typist(keyboard, terminal)
    os.close(keyboard)


@pytest.mark.parametrize("keys", ["!x", "x!", "w!x"])
def test_a_stop_in_the_look_that_quits_is_put(typist: Typist, keys: str) -> None:
    client = FakeClient()
    typist.type(keys)
    waiting = run(client, _Keyboard())
    assert client.heard == [0.0, ZERO_TWIST]
    assert waiting.asked == [client.stop], "and it is confirmed before the command ends"


# a gamepad beside them


@pytest.fixture
def pad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typist: Typist) -> Iterator[tuple[_Pad, int]]:
    """The device of the loop, and where its events go in; there is a terminal."""
    assert typist is not None
    monkeypatch.setattr(Gamepad, "_axis", lambda _self, _code: CENTRED)
    machine = Machine(tmp_path)
    node = machine.plug(*XPAD)
    with machine.open() as gamepad:
        events = os.open(node, os.O_WRONLY)
        yield _Pad(gamepad), events
        os.close(events)


STOP = (codes.EV_KEY, codes.BTN_EAST, codes.PRESSED)
DEADMAN = (codes.EV_KEY, codes.BTN_TL, codes.PRESSED)


@pytest.mark.parametrize(
    ("keys", "events", "wish"),
    [
        ("!", [], Wish(stop=True)),
        ("!", [DEADMAN], Wish(press=1, stop=True)),
        ("", [STOP], Wish(stop=True)),
        ("!", [STOP], Wish(stop=True)),
        ("r", [], Wish(reset=True)),
        ("r", [STOP], Wish(stop=True)),
        ("r!", [], Wish(stop=True)),
        ("x", [], Wish(quit=True)),
        ("x", [STOP], Wish(stop=True, quit=True)),
        ("w+", [], Wish()),
    ],
)
def test_keys_beside_a_gamepad(
    typist: Typist, pad: tuple[_Pad, int], keys: str, events: Iterable[tuple[int, int, int]], wish: Wish
) -> None:
    device, node = pad
    put(node, *events)
    typist.type(keys)
    assert device.wish(WAIT_S) == wish
