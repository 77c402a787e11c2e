"""An incident is one file with the seconds around its cause, and verifies on its own wherever the cause falls."""

import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.recording.bundle import UNKNOWN, kept
from gateway.recording.incident import Incident
from gateway.recording.judge import COMPARED
from gateway.recording.packets import Packet, Record
from gateway.types import Mode, RequestKind
from replay.compare.fleet import judged
from replay.compare.verify import verify
from replay.drive.pieces import cut
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.folders import sessions
from replay.sessions.incidents import listed
from replay.sessions.reader import Session, open_session
from tests.incidents import (
    POST_S,
    PRE_S,
    RATE_HZ,
    SESSION,
    MarkedWorld,
    bundles,
    orders,
    short,
    with_snapshots,
    without,
)
from tests.recordings import expected
from tests.world import BUNDLED

PRE, POST = round(PRE_S * RATE_HZ), round(POST_S * RATE_HZ)
SNAPSHOTS = (0, 120, 240, 360, 480)
LAST = 600
# At the borders of what is kept in front of a cause, of snapshots, of the beginning and of the end.
MARKED = [1, 2, PRE - 1, PRE, PRE + 1, 119, 120, 121, 122, 119 + PRE, 120 + PRE, 121 + PRE, 240 + PRE, 399]
MARKED += [LAST - POST - 1, LAST - POST, LAST - 2, LAST - 1]
EXIT_OF = {"identical": 0, "different": 1, "not replayable": 2, "incomplete": 3}


@cache
def world(*marked: int) -> tuple[MarkedWorld, list[Record]]:
    made = MarkedWorld("moby", marked)
    made.drive(LAST)
    return made, made.packets[:LAST]


def told(session: Session) -> Incident:
    incident = session.header.incident
    assert incident is not None
    return incident


def agrees(session: Session) -> int:
    """The exit code of verify, which is what the recorder said in a word."""
    verdict, then = verify(session), told(session).judgement
    assert then is not None
    assert EXIT_OF[then.verdict] == verdict.exit_code
    assert (then.cycles, then.unseen) == (verdict.cycles, verdict.unseen)
    return verdict.exit_code


def whole(found: Session, records: Sequence[Record], cause: int) -> None:
    """Everything from PRE before the cause to POST behind it, as far as it was recorded, and from a snapshot on."""
    numbers = [inputs.cycle for inputs, _ in found.cycles()]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert list(found.cycles()) == expected(records[numbers[0] : numbers[-1] + 1])
    assert numbers[-1] == min(cause + POST, len(records) - 1)
    begins = [0, *(after + 1 for after in SNAPSHOTS if after <= cause - PRE)]
    assert numbers[0] == begins[-1]


@pytest.mark.parametrize("cause", MARKED)
def test_wherever_the_cause_falls_the_file_verifies_on_its_own(tmp_path: Path, cause: int) -> None:
    made, records = world(cause)
    config = short(made.config, tmp_path)
    (path,) = bundles(made, config, with_snapshots(config, records, SNAPSHOTS))
    session = open_session(path)
    assert session.problems == ()
    assert agrees(session) == 0
    whole(session, records, cause)
    (why,) = told(session).causes
    assert (why.cycle, why.code, why.text) == (cause, "mark", f"in {cause}")
    assert session.header.cut_from == SESSION
    assert session.config_text == made.text
    assert path.parent == tmp_path / "incidents"
    assert re.fullmatch(r"moby-20260921T\d{6}Z-mark-1\.rrd", path.name)


@pytest.mark.parametrize("name", BUNDLED)
def test_of_every_robot(tmp_path: Path, name: str) -> None:
    made = MarkedWorld(name, [250])
    made.drive(500)
    made.request(RequestKind.ESTOP)
    made.run(1.0, None)
    config = short(made.config, tmp_path)
    found = bundles(made, config, with_snapshots(config, made.packets, range(60, 600, 60)))
    assert [path.name.split("-")[-2] for path in found] == ["mark", "estop"]
    for path in found:
        assert agrees(open_session(path)) == 0
    assert {outputs.mode for _, outputs in open_session(found[1]).cycles()} >= {Mode.ESTOP}


def test_without_a_snapshot_there_is_nothing_to_compare_but_all_is_there(tmp_path: Path) -> None:
    """As of a recorder that was started anew, before the next state came."""
    made, records = world(300)
    config = short(made.config, tmp_path)
    (path,) = bundles(made, config, records[150:])
    session = open_session(path)
    assert agrees(session) == 2
    assert list(session.cycles()) == expected(records[150 : 300 + POST + 1])
    (gap,) = session.gaps
    assert (gap.first_cycle, gap.last_cycle, gap.reason) == (0, 149, UNKNOWN)


@pytest.mark.parametrize("gap", [(130, 140), (195, 205), (299, 301), (310, 320), (121, 121), (230, 245)])
def test_a_gap_is_in_it_and_told(tmp_path: Path, gap: tuple[int, int]) -> None:
    """Also one that hides the cause itself, whose mark is then never heard of."""
    first, last = gap
    made, records = world(300)
    config = short(made.config, tmp_path)
    packets: list[Packet] = without(with_snapshots(config, records, (*SNAPSHOTS, 330)), first, last)
    found = bundles(made, config, packets)
    if first <= 300 <= last:
        assert found == []
        return
    session = open_session(found[0])
    assert agrees(session) in {2, 3}
    assert [(one.first_cycle, one.last_cycle, one.reason) for one in session.gaps] == [
        (first, last, "the recorder could not keep up")
    ]


def test_two_causes_are_one_incident_and_what_goes_on_is_the_next(tmp_path: Path) -> None:
    causes = [130, 160, 190, 230, 270, 310, 345]
    made, records = world(*causes)
    config = short(made.config, tmp_path)
    found = [open_session(path) for path in bundles(made, config, with_snapshots(config, records, SNAPSHOTS))]
    # A window may grow to PRE + POST behind its first cause: to 280, which has no room for what follows 270.
    assert [[why.cycle for why in told(session).causes] for session in found] == [[130, 160, 190, 230], [270, 310, 345]]
    for session in found:
        assert agrees(session) == 0
    ends = [[inputs.cycle for inputs, _ in session.cycles()][-1] for session in found]
    assert ends == [230 + POST, 345 + POST]


def test_what_differs_is_told_as_different(tmp_path: Path) -> None:
    made, records = world(300)
    config = short(made.config, tmp_path)
    packets = with_snapshots(config, records, SNAPSHOTS)
    place = next(
        place for place, packet in enumerate(packets) if isinstance(packet, Record) and packet.inputs.cycle == 270
    )
    spoilt = packets[place]
    assert isinstance(spoilt, Record)
    packets[place] = Record(spoilt.inputs, spoilt.outputs._replace(frames=spoilt.outputs.frames[1:]), spoilt.timing)
    (path,) = bundles(made, config, packets)
    verdict, then = verify(open_session(path)), told(open_session(path)).judgement
    assert verdict.exit_code == 1
    assert then is not None
    assert (then.verdict, then.difference) == ("different", "cycle 270: frames")


def test_the_judge_looks_at_what_verify_looks_at() -> None:
    assert RecordedOutputs._fields == COMPARED


def test_a_value_that_no_column_holds_costs_its_cycle(tmp_path: Path) -> None:
    made, records = world(300)
    config = short(made.config, tmp_path)
    wild = records[305]
    spoilt = Record(wild.inputs._replace(overruns=2**63), wild.outputs, wild.timing)
    records = [*records[:305], spoilt, *records[306:]]
    (path,) = bundles(made, config, with_snapshots(config, records, (0, 120, 240)))
    (gap,) = open_session(path).gaps
    assert (gap.first_cycle, gap.last_cycle) == (305, 305)
    assert gap.reason.startswith("not recordable: ")


def test_a_piece_of_an_incident_is_no_incident(tmp_path: Path) -> None:
    made, records = world(300)
    config = short(made.config, tmp_path)
    (path,) = bundles(made, config, with_snapshots(config, records, SNAPSHOTS))
    piece = open_session(cut(open_session(path), tmp_path / "pieces", begin=0.5).session)
    assert piece.header.incident is None
    assert piece.header.cut_from == SESSION
    assert verify(piece).exit_code == 0


def test_they_are_found_and_listed(tmp_path: Path) -> None:
    made, records = world(130, 300, 320)
    config = short(made.config, tmp_path)
    found = bundles(made, config, with_snapshots(config, records, SNAPSHOTS))
    assert sessions([tmp_path]) == sessions([tmp_path / "incidents"]) == sorted(found)
    assert [judged(path).verdict.exit_code for path in found] == [0, 0]
    (tmp_path / "incidents" / "other.rrd").write_bytes(b"no session")
    lines = list(listed([tmp_path]))
    assert [(one.code, one.text, one.causes, one.verdict) for one in lines[1:]] == [
        ("mark", "in 130", 1, "identical"),
        ("mark", "in 300", 2, "identical"),
    ]
    assert "other.rrd" in str(lines[0].problem)
    (tmp_path / "incidents" / "other.rrd").unlink()
    command = build("replay")
    done = CliRunner().invoke(command, ["replay", "incidents", str(tmp_path), "--json"])
    assert done.exit_code == 0
    told_of = json.loads(done.stdout)["incidents"]
    assert [one["file"] for one in told_of] == list(map(str, found))
    plain = CliRunner().invoke(command, ["replay", "incidents", str(tmp_path)]).stdout
    assert "mark: in 300 (and 1 more)" in plain
    assert all(str(path) in plain for path in found)
    shown = json.loads(CliRunner().invoke(command, ["replay", "info", str(found[1]), "--json"]).stdout)
    assert [one["text"] for one in shown["incident"]["causes"]] == ["in 300", "in 320"]
    assert shown["incident"]["verdict"] == "identical"
    assert shown["incident"]["buses"][0]["name"] == "can0"
    assert "kept for" in CliRunner().invoke(command, ["replay", "info", str(found[1])]).stdout
    nothing = CliRunner().invoke(command, ["replay", "incidents", str(tmp_path / "incidents" / "none")])
    assert nothing.exit_code == 2


def test_the_order_is_all_that_the_writing_process_needs(tmp_path: Path) -> None:
    """Packed and unpacked it gives the same file, as it does in a process of its own."""
    made, records = world(300)
    config = short(made.config, tmp_path)
    (order,) = orders(made, config, with_snapshots(config, records, SNAPSHOTS))
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(order), type=type(order))
    first, second = kept(order), kept(again)
    assert list(open_session(Path(str(first.file))).cycles()) == list(open_session(Path(str(second.file))).cycles())
    assert (first.verdict, second.verdict) == ("identical", "identical")
