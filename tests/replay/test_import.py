"""A log becomes a session: its frames, as they were and when they were, and what the core would have heard in them."""

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import can
import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.config import parse
from gateway.types import Twist
from replay.compare.retrace import frames as frames_in_words
from replay.compare.retrace import rows
from replay.compare.verify import EXIT_NOT_REPLAYABLE, verify
from replay.drive.closed_loop import FIRST_NS
from replay.drive.player import Direction, play, recorded
from replay.logs import formats
from replay.logs.export import Format, export, logged
from replay.logs.intake import PAUSE_NS, Imported, import_log
from replay.logs.logged import LogError, Logged
from replay.sessions.reader import Session, open_session
from replay.sessions.summary import summary
from tests.recordings import write_drive
from tests.world import BUNDLED, World, robot_text

RATE_HZ = 250.0


def driven(name: str, tmp_path: Path) -> Session:
    world = World(name)
    world.start()
    world.run(0.6, Twist(0.2, 0.0, 0.1))
    return open_session(write_drive(tmp_path / "first", world))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return driven("moby", tmp_path_factory.mktemp("s"))


def imported(path: Path, name: str, directory: Path, buses: dict[str, str], interval_ns: int | None = None) -> Imported:
    text = robot_text(name)
    config = parse(text, name)
    return import_log(path, config, text, name, directory=directory, buses=buses, interval_ns=interval_ns)


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "import", *map(str, arguments)])


@pytest.mark.parametrize("to", [Format.CANDUMP, Format.ASC, Format.BLF, Format.MF4, Format.MCAP])
def test_there_and_back_again(session: Session, to: Format, tmp_path: Path) -> None:
    path = tmp_path / "log"
    export(session, path, to)
    channel = "1" if to in {Format.ASC, Format.BLF, Format.MF4} else "can0"
    found = imported(path, "moby", tmp_path / "second", {channel: "can0"})
    again = open_session(found.session)
    step = 1000 if to is Format.CANDUMP else 1
    before = [one._replace(time_ns=(one.time_ns or 0) // step * step) for one in map(bare, logged(session))]
    if to is Format.MF4:  # it does not tell the order of remote frames among others of the same time
        before.sort(key=lambda one: (one.time_ns, one.frame.remote))
    assert [bare(one) for one in logged(again)] == before
    assert not found.account.left_out
    assert (found.pauses, found.backwards) == (0, 0)
    assert again.complete


def bare(one: Logged) -> Logged:
    return one._replace(frame=one.frame._replace(received_ns=None))


@pytest.mark.parametrize("name", BUNDLED)
def test_what_is_a_command_is_told_by_the_drivers(name: str, tmp_path: Path) -> None:
    """Of every robot with the directions taken away, as a sniffer has them."""
    first = driven(name, tmp_path)
    path = tmp_path / "drive.asc"
    export(first, path, Format.ASC)
    path.write_text(path.read_text().replace(" Tx ", " Rx "))
    buses = {str(number): bus.name for number, bus in enumerate(parse(robot_text(name), name).bus, start=1)}
    found = imported(path, name, tmp_path / "second", buses)
    assert [one.sent for one in logged(open_session(found.session))] == [one.sent for one in logged(first)]


def test_the_core_hears_what_it_heard(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "drive.blf"
    export(session, path, Format.BLF)
    again = open_session(imported(path, "moby", tmp_path / "second", {"1": "can0"}).session)
    names = ["vx_measured", "vy_measured", "wz_measured"]
    first, second = (last_of(one, names) for one in (session, again))
    assert second == pytest.approx(first, abs=1e-3)
    assert first[0] == pytest.approx(0.2, abs=0.02)


def last_of(session: Session, names: list[str]) -> list[float]:
    from replay.compare.retrace import columns  # noqa: PLC0415

    last = list(rows(session))[-1]
    places = [columns(session).index(name) for name in names]
    return [float(last[place] or 0.0) for place in places]


def test_every_command_of_replay_takes_it(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    export(session, path, Format.CANDUMP)
    found = open_session(imported(path, "moby", tmp_path / "second", {"can0": "can0"}).session)
    told = summary(found)
    assert told.imported == "drive.log (candump -L, times since 1970, UTC)"
    assert told.began == summary(session).began
    words = list(frames_in_words(found))
    assert len(words) == told.frames_received + told.frames_sent
    assert any("Set_Input_Vel" in one.words for one in words if one.sent)
    verdict = verify(found)
    assert verdict.exit_code == EXIT_NOT_REPLAYABLE
    assert "a log of frames tells no commands" in (verdict.problem or "")


def test_commands_of_a_log_are_played_as_commands(session: Session, tmp_path: Path) -> None:
    """And so refused on a bus that may have motors: a player knows them by having no time of arrival."""
    path = tmp_path / "drive.log"
    export(session, path, Format.CANDUMP)
    found = open_session(imported(path, "moby", tmp_path / "second", {"can0": "can0"}).session)
    both, sent, heard = (recorded(found, "can0", only) for only in (None, Direction.TX, Direction.RX))
    assert len(both) == len(sent) + len(heard)
    assert all(due.frame.received_ns is None for due in sent)
    assert all(due.frame.received_ns is not None for due in heard)
    assert all(before.time_ns <= after.time_ns for before, after in pairwise(both))
    with (
        can.Bus(interface="virtual", channel="played") as target,
        can.Bus(interface="virtual", channel="played") as other,
    ):
        played = play(both[:50], target, speed=100.0)
        assert played.frames == 50
        assert [message.arbitration_id for message in iter(lambda: other.recv(0), None)] == [
            d.frame.id for d in both[:50]
        ]


def test_frames_of_a_cycle_are_played_in_the_order_in_which_they_were_seen(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    ids = ["7FF", "02D", "7FE", "04D", "7FD"]
    path.write_text("".join(f"(1672531200.001{place}) can0 {one}#0000000000000000\n" for place, one in enumerate(ids)))
    found = open_session(imported(path, "moby", tmp_path / "s", {"can0": "can0"}).session)
    assert [f"{due.frame.id:03X}" for due in recorded(found, "can0", None)] == ids
    assert [f"{due.frame.id:03X}" for due in recorded(found, "can0", Direction.TX)] == ids[1::2]


LOG = """(1672531200.000000) can0 029#DB0F494000000000
(1672531200.010000) vcan1 021#0000000001000000
(1672531200.010000) can0 20000004#0000000000000000
(1672531200.005000) can0 7FF#01
(1672531230.000000) can0 02D#0000000000000000
"""


def test_cycles_pauses_and_what_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(LOG)
    found = imported(path, "moby", tmp_path / "s", {"can0": "can0"})
    assert (found.received, found.sent, found.pauses, found.backwards) == (2, 1, 1, 0)
    assert found.account.left_out["error frame"].times == 1
    assert "frames of channel vcan1, which --map does not tell of: 1" in found.account.left_out
    cycles = list(open_session(found.session).cycles())
    period_ns = round(1e9 / RATE_HZ)
    assert [inputs.cycle for inputs, _ in cycles] == list(range(found.cycles))
    assert [inputs.now_ns for inputs, _ in cycles] == [FIRST_NS + n * period_ns for n in (0, 1, 2, 7500)]
    assert [frame.id for frame in cycles[2][0].frames] == [0x7FF]
    assert [frame.id for frame in cycles[3][1].frames] == [0x02D]
    assert cycles[3][0].now_ns - cycles[2][0].now_ns > PAUSE_NS


def test_times_that_go_backwards_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(
        "(1672531200.100000) can0 7FF#01\n(1672531200.050000) can0 7FF#02\n(1672531200.200000) can0 7FF#03\n"
    )
    found = imported(path, "moby", tmp_path / "s", {"can0": "can0"})
    assert found.backwards == 1
    begin_ns = 1_672_531_200_000_000_000
    assert sorted((one.time_ns or 0) - begin_ns for one in logged(open_session(found.session))) == [
        50_000_000,
        100_000_000,
        200_000_000,
    ]


def test_a_log_that_cannot_be_read_to_its_end_leaves_no_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(frames: Iterator[Logged]) -> Iterator[Logged]:
        yield next(frames)
        raise OSError(5, "Input/output error")

    path = tmp_path / "drive.log"
    path.write_text(LOG)
    sound = formats._frames
    monkeypatch.setattr(formats, "_frames", lambda *arguments: broken(sound(*arguments)))
    with pytest.raises(LogError, match=r"drive\.log: cannot be read: Input/output error"):
        imported(path, "moby", tmp_path / "s", {"can0": "can0"})
    assert not list((tmp_path / "s").iterdir())


def test_a_session_that_cannot_be_written_is_not_the_fault_of_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drive.log"
    path.write_text(LOG)
    (tmp_path / "file").touch()
    told = asked(path, "moby", "--map", "can0=can0", "--out", tmp_path / "file", "--json")
    assert (told.exit_code, json.loads(told.stdout)["problem"]) == (2, f"{tmp_path / 'file'}: File exists")
    monkeypatch.setattr("replay.drive.recording.free_bytes", lambda _: 1000)
    told = asked(path, "moby", "--map", "can0=can0", "--out", tmp_path / "s", "--json")
    assert told.exit_code == 2
    assert "disk full: 1000 bytes free" in json.loads(told.stdout)["problem"]
    assert not list((tmp_path / "s").iterdir())


def test_a_log_without_times_needs_an_interval(tmp_path: Path) -> None:
    path = tmp_path / "drive.txt"
    path.write_text("  can0  7FF   [1]  01\n" * 5)
    with pytest.raises(LogError, match="--interval"):
        imported(path, "moby", tmp_path / "s", {"can0": "can0"})
    found = imported(path, "moby", tmp_path / "s", {"can0": "can0"}, 2_000_000)
    assert (found.received, found.began_ns, found.cycles) == (5, None, 3)


@pytest.mark.parametrize(
    ("text", "buses", "words"),
    [
        (LOG, {}, r"--map CHANNEL=BUS which is which: it has can0 \(3 frames\), vcan1 \(1 frames\); buses: can0"),
        (LOG, {"can0": "can7"}, "no bus can7, but can0"),
        (LOG, {"can5": "can0"}, "no frame of can5"),
        (
            "(1.0) can0 20000004#\n",
            {"can0": "can0"},
            r"no frame of can0 in it: candump -L; error frame \(1, first at line 1",
        ),
        ("(1.0) can0 20000004#\n", {}, r"no frame in it: candump -L; error frame \(1, first at line 1"),
        ("nonsense\n", {"can0": "can0"}, "expected candump"),
    ],
)
def test_what_cannot_be_imported(text: str, buses: dict[str, str], words: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_text(text)
    with pytest.raises(LogError, match=words):
        imported(path, "moby", tmp_path / "s", buses)
    assert not (tmp_path / "s").exists()


def test_other_sessions_are_not_deleted_for_it(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    export(session, path, Format.CANDUMP)
    text = robot_text("moby").replace("[recording]", "[recording]\ndisk_budget = 2_000_000", 1)
    if "[recording]" not in text:
        text += "\n[recording]\ndisk_budget = 2_000_000\n"
    config = parse(text, "moby")
    made = [import_log(path, config, text, "moby", directory=tmp_path / "s", buses={"can0": "can0"}) for _ in range(9)]
    assert sum(file.stat().st_size for one in made for file in one.session.glob("*.rrd")) > 2_000_000
    assert all(open_session(one.session).complete for one in made)


def test_the_command(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    export(session, path, Format.MCAP)
    result = asked(path, "moby", "--map", "can0=can0", "--out", tmp_path / "s", "--json")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 0
    assert (told["format"], told["left_out"]) == ("MCAP", {})
    assert open_session(Path(told["session"])).complete
    (tmp_path / "log").write_text(LOG)
    assert asked(tmp_path / "log", "moby", "--map", "can0=can0", "--out", tmp_path / "s").exit_code == 3
    for wrong in (("--map", "can0"), ("--map", "=can0"), ()):
        assert asked(path, "moby", *wrong, "--out", tmp_path / "s").exit_code == 2
    assert asked(path, "no_such_robot", "--map", "can0=can0").exit_code == 2
