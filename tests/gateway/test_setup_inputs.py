"""Whatever is typed into `drivegate setup`: nothing moves without a yes, and with one nothing runs beyond its bound.

The commands run as they are; the bus, its clock and the terminal are simulated.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from io import StringIO
from math import pi
from pathlib import Path
from unittest.mock import patch
from zlib import crc32

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.contract import CanFrame
from gateway.cli import setup_directions, setup_id, setup_jog, setup_reference, setup_scan
from gateway.cli.app import build
from gateway.config import ConfigError, RobotConfig, parse
from gateway.edges.listening import Place
from gateway.edges.turning import turn
from gateway.setup.jog import Jog
from gateway.setup.renaming import KINDS
from gateway.types import BusEvent
from tests.gateway.test_jog import FAULTS
from tests.jogging import QUARTER_TURN, Bench
from tests.setup_robots import TRUE
from tests.world import robot_text

ROBOTS = {**{name: text() for name, text in TRUE.items()}, "omni4_vesc": robot_text("omni4_vesc")}
WORDS = ["yes", "y", "no", "", "Yes", "yes!", "f", "b", "n", "left f", "front b", "front_left f", "rear_left b", "\x00"]
NO_QUESTIONS: Callable[..., object] = lambda _gone: ()  # noqa: E731  # a default is one line
SLOW = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


class Terminal(StringIO):
    """What a person types, or a script pipes."""

    def __init__(self, lines: Sequence[str], *, terminal: bool) -> None:
        super().__init__("".join(f"{line}\n" for line in lines))
        self._terminal = terminal

    def isatty(self) -> bool:
        return self._terminal


class Buses:
    """The edge of the commands, on the simulated bus; every jog is looked at."""

    def __init__(self, bench: Bench, disturb: Callable[[Bench], None]) -> None:
        self._bench = bench
        self._disturb = disturb

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        self._disturb(self._bench)
        return self._bench.bus.receive(now_ns)[0], []

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        self._bench.sent += [(now_ns, frame) for frame in frames]
        self._bench.bus.send(frames, now_ns)

    def close(self) -> None:
        pass


class Told:
    """What came of a call. `ways`: rad by which the joint that went furthest moved, of each jog, and what was asked."""

    def __init__(self) -> None:
        self.ways: list[tuple[float, float]] = []
        self.code: object = None


@contextmanager
def simulated(bench: Bench, told: Told, disturb: Callable[[Bench], None]) -> Iterator[None]:
    """The commands' edges, replaced."""

    def sleep(seconds: float) -> None:
        bench.now_ns += max(1, round(seconds * 1e9))

    def listen(
        place: Place, seconds: float, take: Callable[[CanFrame], None], **more: Callable[..., object]
    ) -> dict[str, int]:
        end_ns = bench.now_ns + min(round(seconds * 1e9), 2_000_000_000)
        while bench.now_ns < end_ns and more.get("going_on", lambda: True)():
            for frame in bench.cycle():
                take(frame)
        return {}

    def asking(
        place: Place, seconds: float, take: Callable[[CanFrame], None], **more: Callable[..., object]
    ) -> dict[str, int]:
        begin_ns, questions = bench.now_ns, more.get("questions", NO_QUESTIONS)
        while (gone := (bench.now_ns - begin_ns) * 1e-9) < min(seconds, 10.0) and more.get("going_on", lambda: True)():
            bench.send([frame._replace(bus="can0") for frame in questions(gone)])  # type: ignore[attr-defined]
            disturb(bench)
            for frame in bench.cycle():
                take(frame)
        return {}

    def turned(bus: Buses, jog: Jog, *rest: object, period_ns: int) -> None:
        before = bench.bus.robot.truth.joint_angles
        loop = partial(turn, clock=lambda: bench.now_ns, sleep=sleep, period_ns=period_ns)
        loop(bus, jog, *rest)  # type: ignore[arg-type]
        for _ in range(250):
            disturb(bench)
            bench.cycle()
        after = bench.bus.robot.truth.joint_angles
        way = max(abs(one - other) for one, other in zip(before, after, strict=True))
        told.ways.append((way, abs(jog._speed) * jog._seconds))

    with (
        patch.object(setup_jog, "CanBuses", lambda _config: Buses(bench, disturb)),
        patch.object(setup_jog, "turn", turned),
        patch.object(setup_jog, "refuse_where_absent", lambda _place: None),
        patch.object(setup_directions, "listen", listen),
        patch.object(setup_scan, "listen", listen),
        patch.object(setup_id, "listen", asking),
        patch.object(setup_reference, "listen", listen),
    ):
        yield


def typed(
    bench: Bench,
    arguments: Sequence[str],
    terminal: Terminal,
    disturb: Callable[[Bench], None] = lambda _bench: None,
) -> Told:
    """Calls a command; whatever it prints is dropped."""
    told = Told()
    with simulated(bench, told, disturb), patch.object(sys, "stdin", terminal):
        out = StringIO()
        with redirect_stdout(out), redirect_stderr(out), patch.object(sys, "argv", ["drivegate"]):
            try:
                build("setup")(["setup", *arguments])
            except SystemExit as error:  # also of what is no option
                told.code = error.code or None
            except ConfigError as error:
                told.code = error
    return told


def written(name: str, directory: str) -> tuple[RobotConfig, str]:
    file = Path(directory) / f"{name}.toml"
    file.write_text(ROBOTS[name])
    return parse(ROBOTS[name], name), str(file)


numbers = st.one_of(st.floats(-3.0, 8.0), st.sampled_from([float("nan"), float("inf"), 0.0, 0.5, 1.0]))
options = st.lists(
    st.one_of(
        st.just(["--json"]),
        st.just(["--by-hand"]),
        numbers.map(lambda value: [f"--speed={value}"]),
        numbers.map(lambda value: [f"--seconds={value}"]),
    ),
    max_size=4,
)


def call(command: str, config: RobotConfig, file: str, which: int, more: Sequence[Sequence[str]]) -> list[str]:
    if command == "scan":
        return ["scan", "can0", "--ask", f"--file={file}"]
    options = [word for option in more for word in option if command in TURNING or not word.startswith(MOVING)]
    if command == "id":
        motor = config.motor[which % len(config.motor)]
        kind = next(kind for kind, of in KINDS.items() if of == (motor.driver, motor.variant))
        serial = f"--serial={crc32(motor.name.encode()):X}"
        return ["id", CHANNEL, kind, f"--to={which + 4}", *options, *([serial] if "odrive" in kind else [])]
    names = config.robot.motor_names()
    target = [file, names[which % len(names)]] if command in ("jog", "tune") else [file]
    return [command, *target, *options]


CHANNEL = f"can{os.getpid()}"  # `id` claims identifiers on it, and the names are of the whole computer
TURNING = ("jog", "directions")
MOVING = ("--speed", "--seconds", "--by-hand")
COMMANDS = ("scan", "id", "jog", "directions", "reference", "tune")


def harmless(frame: CanFrame) -> bool:
    """A question: who is there (ODrive), or a ping (VESC)."""
    return frame.remote or (frame.extended and frame.id >> 8 == 17)


def nodes(bench: Bench) -> list[int]:
    return [getattr(device, "node", device.setup.id) for device in bench.bus.robot.devices.values()]


@SLOW
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    command=st.sampled_from(COMMANDS),
    which=st.integers(0, 3),
    more=options,
    lines=st.lists(st.sampled_from(WORDS), max_size=6),
    terminal=st.booleans(),
)
def test_nothing_moves_without_a_yes(  # noqa: PLR0917
    name: str, command: str, which: int, more: list[list[str]], lines: list[str], terminal: bool
) -> None:
    """On a terminal it is typed as asked, first of all; elsewhere nothing typed is one."""
    with tempfile.TemporaryDirectory() as directory:
        config, file = written(name, directory)
        bench = Bench(config)
        said = [line for line in lines if line != "yes"] if terminal else lines
        before = nodes(bench)
        typed(bench, call(command, config, file, which, more), Terminal(said, terminal=terminal))
        assert all(harmless(frame) for _, frame in bench.sent)
        assert command == "id" or bench.sent == []
        assert nodes(bench) == before
        assert set(bench.plant.angles) == {0.0}
        assert Path(file).read_text() == ROBOTS[name]


@SLOW
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    command=st.sampled_from([one for one in COMMANDS if one != "scan"]),
    which=st.integers(0, 3),
    more=options.map(lambda given: [option for option in given if option != ["--by-hand"]]),
    lines=st.lists(st.sampled_from(WORDS), max_size=6),
    fault=st.sampled_from([None, "phases swapped", "no power", "a twin"]),
    at_ms=st.integers(0, 4000),
)
def test_with_a_yes_nothing_runs_beyond_its_bound(  # noqa: PLR0917
    name: str, command: str, which: int, more: list[list[str]], lines: list[str], fault: str | None, at_ms: int
) -> None:
    """Whatever is typed after it, and whatever breaks at any time; the tests of the jog have more faults."""
    with tempfile.TemporaryDirectory() as directory:
        config, file = written(name, directory)
        bench = Bench(config)
        broken_ns = bench.now_ns + at_ms * 1_000_000
        motor = config.robot.motor_names()[which % len(config.motor)]

        def disturb(bench: Bench) -> None:
            nonlocal broken_ns
            if fault is not None and bench.now_ns >= broken_ns > 0:
                broken_ns = 0
                FAULTS[fault](bench, motor)

        arguments = [*call(command, config, file, which, more), "--yes"]
        told = typed(bench, arguments, Terminal(lines, terminal=False), disturb)
        for way, asked in told.ways:
            assert asked <= pi + 1e-9
            assert way <= asked + QUARTER_TURN
        assert bench.bus.robot.truth.joint_rates == pytest.approx([0.0] * len(config.motor), abs=0.05)


def test_these_tests_can_fail() -> None:
    with tempfile.TemporaryDirectory() as directory:
        config, file = written("kiwi", directory)
        bench = Bench(config)
        told = typed(bench, ["jog", file, "front"], Terminal(["yes"], terminal=True))
        assert told.code is None
        assert told.ways[0][0] == pytest.approx(0.375, abs=0.05)
        assert bench.sent != []
        before = nodes(bench)
        told = typed(bench, call("id", config, file, 0, []), Terminal(["yes"], terminal=True))
        assert told.code is None
        assert nodes(bench) != before
        config, file = written("rectangular", directory)
        told = typed(Bench(config), call("tune", config, file, 0, []), Terminal(["yes", "yes"], terminal=True))
        assert told.code is None
        assert told.ways[0][0] > 1.5
        assert Path(file).read_text() != ROBOTS["rectangular"]
