"""`drivegate setup` as a person calls it, on a simulated robot in real time; waits are for what is told."""

import errno
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from gateway.cli import output
from gateway.edges.claims import Claims
from gateway.edges.turning import turn
from gateway.setup.jog import Ending, Outcome
from tests.setup_robots import TRUE, wronged
from tests.setup_stand import Stand, called, document, stands


@pytest.fixture
def stand(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Callable[..., Stand]]:
    with stands(tmp_path, request.node.name) as make:
        yield make


def test_scan(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi", lambda text: wronged(text, {"front": 6}, {}))
    arguments = ["scan", one.channel, "--interface", "virtual", "--file", one.file]
    result = called(*arguments, "--ask", "--json")
    assert result.exit_code == 0, result.output
    found = document(result)
    assert [(entry["driver"], entry["id"], entry["told"]["firmware"]) for entry in found["found"]] == [  # type: ignore[attr-defined]
        ("odrive", node, "0.6.10") for node in (2, 5, 9)
    ]
    assert found["file"] == {
        "there": ["rear_left", "rear_right"],
        "missing": ["front"],
        "strangers": ["odrive 0.6 id 5"],
    }
    assert not one.moved
    shown = called(*arguments)
    assert "motor front does not answer" in shown.output


def test_scan_of_what_is_not_there() -> None:
    result = called("scan", "nonsense0", "--json")
    assert (result.exit_code, document(result)["ok"]) == (69, False)
    assert "nonsense0: No such device" in result.stderr


def test_a_conflict_is_an_exit_code(stand: Callable[..., Stand]) -> None:
    one = stand("rectangular")
    heartbeat = can.Message(arbitration_id=0x201, data=bytes((0, 0, 0, 0, 1, 0, 0, 0)), is_extended_id=False)
    with (
        can.Bus(interface="virtual", channel=f"{one.channel}2") as bus,
        can.Bus(interface="virtual", channel=f"{one.channel}2"),
    ):
        task = bus.send_periodic(heartbeat, 0.05)
        result = called("scan", f"{one.channel}2", "--interface", "virtual", "--json")
        task.stop()
    assert result.exit_code == 1
    assert "may be of" in str(document(result)["conflicts"])


@pytest.mark.parametrize("name", TRUE)
def test_jog(stand: Callable[..., Stand], name: str) -> None:
    one = stand(name)
    motor = one.config.motors_in_order()[0].name
    result = called("jog", one.file, motor, "--yes", "--json")
    assert result.exit_code == 0, result.output
    assert document(result)["ending"] == "turned"
    assert "Lift the robot" in result.stderr
    angle, *others = one.plant.angles
    assert 0.2 < angle < 0.5
    assert others == [0.0] * len(others)


def test_without_a_yes_nothing_moves(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    result = called("jog", one.file, "front", "--json")
    assert (result.exit_code, document(result)["ok"]) == (1, False)
    assert "a person has to let it happen" in str(document(result)["reason"])
    result = called("directions", one.file, "--json")
    assert (result.exit_code, document(result)["ok"]) == (1, False)
    assert not one.moved
    assert one.file.read_text() == one.true


@pytest.mark.parametrize("command", [("jog", "front", "--yes"), ("directions", "--yes"), ("scan",)])
def test_a_gateway_on_the_bus_is_left_alone(stand: Callable[..., Stand], command: tuple[str, ...]) -> None:
    one = stand("kiwi")
    claims = Claims("virtual", one.channel, [0x7FF])  # of motors that are in no file here
    arguments = [one.file, *command[1:]] if command[0] != "scan" else [one.channel, "--interface", "virtual"]
    result = called(command[0], *arguments)
    claims.release()
    assert type(result.exception).__name__ == "InUseError"
    assert not one.moved


def test_ctrl_c_at_the_very_end_is_heeded(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    """No other motor turns, and nothing is written."""

    def turned(*arguments: object, period_ns: int) -> None:
        turn(*arguments, period_ns=period_ns)  # type: ignore[arg-type]
        arguments[2].ask("signal 2")  # type: ignore[attr-defined]

    monkeypatch.setattr("gateway.cli.setup_jog.turn", turned)
    one = stand("kiwi")
    result = called("directions", one.file, "--yes", "--json", answers="b\nb\nb\n")
    assert (result.exit_code, "signal 2" in str(document(result)["reason"])) == (1, True)
    assert sum(angle != 0.0 for angle in one.plant.angles) == 1
    assert one.file.read_text() == one.true


def test_what_may_still_hold_is_not_well(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    held = Outcome("front", Ending.TURNED, "", 0.4, released=False)
    monkeypatch.setattr("gateway.cli.setup_jog.run", lambda *_: held)
    one = stand("kiwi")
    result = called("jog", one.file, "front", "--yes", "--json")
    assert (result.exit_code, document(result)["ok"]) == (1, False)
    assert "cut its power" in called("jog", one.file, "front", "--yes").output


def test_ctrl_c_at_the_question_is_told(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    one = stand("kiwi")
    monkeypatch.setattr("gateway.cli.setup_jog.allow", interrupted)
    result = called("jog", one.file, "front", "--json")
    assert (result.exit_code, document(result)) == (1, {"ok": False, "reason": "interrupted"})
    assert not one.moved


def test_ctrl_c_ends_it(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    main, before = threading.get_ident(), signal.getsignal(signal.SIGINT)

    def watch() -> None:
        while one.plant.rates[0] < 0.3:
            if done.wait(0.002):
                return
        signal.pthread_kill(main, signal.SIGINT)

    done = threading.Event()
    watcher = threading.Thread(target=watch)
    watcher.start()
    result = called("jog", one.file, "front", "--seconds", "5", "--yes", "--json")
    done.set()
    watcher.join()
    assert (result.exit_code, document(result)["ending"]) == (1, "asked"), result.output
    assert document(result)["reason"] == f"signal {signal.SIGINT.value}"
    assert document(result)["released"]
    assert one.plant.angles[0] < 1.0
    assert signal.getsignal(signal.SIGINT) is before


def test_id(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    arguments = ["id", one.channel, "odrive-0.6", "--interface", "virtual", "--json"]
    ids = document(called(*arguments))["ids"]
    assert isinstance(ids, dict)
    assert sorted(ids.values()) == [2, 5, 9]
    serial = next(serial for serial, at in ids.items() if at == 9)
    result = called(*arguments, "--to", 7, "--serial", serial, "--yes")
    assert result.exit_code == 0, result.output
    assert document(result) == {"ok": True, "serial": serial, "from": 9, "to": 7}
    assert not one.moved


SWAPPED = {"left": 3, "right": 1}
WRONG_IDS = {"front_left": 2, "front_right": 1, "rear_right": 5}  # really 7, as which a GM6020 of id 3 would speak too


def test_directions_by_turning(stand: Callable[..., Stand]) -> None:
    one = stand("mobyish", lambda text: wronged(text, SWAPPED, {}))
    before = one.file.read_text()
    result = called("directions", one.file, "--yes", "--json", answers="left b\nwing f\nf\nf\n")
    assert result.exit_code == 0, result.output
    assert one.file.read_text() == one.true
    found = document(result)
    assert found["ok"]
    assert Path(str(found["kept"])).read_text() == before
    assert "-id = 3   # as its switch says\n+id = 1   # as its switch says" in result.stderr
    assert "must be f, b or n" in result.stderr
    again = called("directions", one.file, "--yes", "--json", answers="f\nf\nf\n")
    assert (again.exit_code, document(again)["changes"]) == (0, []), again.output


def test_directions_by_hand(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    one = stand("rectangular", lambda text: wronged(text, WRONG_IDS, {"rear_left": -1}))
    names = [motor.name for motor in one.config.motors_in_order()]

    def told(text: str, **_: object) -> None:
        words = text.split()
        if words[:1] == ["Turn"]:
            one.plant.turn_by_hand(names.index(words[1]), 2.0, 0.5)

    monkeypatch.setattr(output.errors, "print", told)
    result = called("directions", one.file, "--by-hand", "--yes", "--json")
    assert result.exit_code == 0, result.output
    assert one.file.read_text() == one.true


def test_a_file_that_cannot_be_written_is_said_before_anything_turns(
    stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = stand("kiwi")

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("gateway.cli.rewriting.tempfile.NamedTemporaryFile", refuse)
    result = called("directions", one.file, "--yes", "--json", answers="f\n")
    assert (result.exit_code, document(result)["ok"]) == (1, False)
    assert "cannot be written: Read-only" in str(document(result)["reason"])
    assert not one.moved


def test_answers_that_end_leave_the_file(stand: Callable[..., Stand]) -> None:
    one = stand("mobyish", lambda text: wronged(text, SWAPPED, {}))
    before = one.file.read_text()
    result = called("directions", one.file, "--yes", "--json", answers="left b\n")
    assert (result.exit_code, document(result)["ok"]) == (1, False)
    assert one.file.read_text() == before


@pytest.mark.parametrize("speed", ["-0.5", "0", "nan"])
def test_directions_turn_forward_alone(stand: Callable[..., Stand], speed: str) -> None:
    """What turned backward and was seen so would get the wrong sign."""
    one = stand("kiwi")
    result = called("directions", one.file, f"--speed={speed}", "--yes", "--json", answers="b\nb\nb\n")
    assert (result.exit_code, "must be above 0" in str(document(result)["reason"])) == (1, True)
    assert not one.moved
