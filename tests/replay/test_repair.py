"""A session that was cut or damaged: no whole message is lost, the original stays as it was, and words say the rest."""

import json
import random
import shutil
import struct
from itertools import pairwise
from pathlib import Path

import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.recording.schema import BLOCK_PATH
from replay.sessions.framing import read, repair
from replay.sessions.reader import SessionError, open_session
from replay.sessions.repair import repaired
from tests.drives import drive
from tests.recordings import expected, write, writer
from tests.replay.test_session import message_ends

CYCLES, BATCH = 60, 10


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recorded"), list(drive(CYCLES)), batch=BATCH)


def messages(data: bytes) -> list[bytes]:
    """The walk as the file's own lengths say, up to the end message."""
    return [data[start:end] for start, end in pairwise([12, *message_ends(data)])]


def places_of_batches(path: Path) -> list[tuple[int, int]]:
    """From byte to byte: messages that make a file with cycles even alone."""
    data = path.read_bytes()
    alone = path.with_name("alone.rrd")
    found = []
    for start, end in pairwise([12, *message_ends(data)]):
        alone.write_bytes(data[:12] + data[start:end])
        if read(alone, [BLOCK_PATH]).batches:
            found.append((start, end))
    alone.unlink()
    return found


def spoilt(folder: Path, data: bytes) -> Path:
    folder.mkdir()
    (folder / "segment-00001.rrd").write_bytes(data)
    return folder


def test_every_whole_message_of_a_cut_segment_is_kept(recorded: Path, tmp_path: Path) -> None:
    data = (recorded / "segment-00001.rrd").read_bytes()
    generator = random.Random(1)
    for number in range(40):
        cut = generator.randrange(12, len(data))
        source, target = tmp_path / f"cut-{number}.rrd", tmp_path / f"repaired-{number}.rrd"
        source.write_bytes(data[:cut])
        if not [end for end in message_ends(data) if end <= cut]:
            continue
        kept = repair(source, target)
        whole = [message for message, end in zip(messages(data), message_ends(data), strict=True) if end <= cut]
        assert target.read_bytes() == data[:12] + b"".join(whole)
        assert kept.messages == len(whole)
        assert source.read_bytes() == data[:cut]


def test_damage_costs_the_message_that_it_hits_and_no_other(recorded: Path, tmp_path: Path) -> None:
    """Also in the length that leads to the next one, and where zeros or nothing are in place of some of it."""
    data = (recorded / "segment-00001.rrd").read_bytes()
    all_messages = messages(data)
    ends = [12, *message_ends(data)]
    generator = random.Random(2)
    source, target = tmp_path / "segment-00001.rrd", tmp_path / "repaired.rrd"
    for number, (start, end) in enumerate(pairwise(ends)):
        if number == 0 and end == 12:
            continue
        changed = bytearray(data)
        way = generator.randrange(4)
        if way == 0:
            length = generator.choice([0, 1, end - start + 77, 1 << 62, len(data) // 2])
            struct.pack_into("<Q", changed, start + 8, length)
        elif way == 1:
            changed[start:end] = bytes(end - start)
        elif way == 2:
            del changed[start + 5 : end - 1]
        else:
            changed[start] ^= 1 << generator.randrange(8)
        source.write_bytes(changed)
        kept = repair(source, target)
        others = all_messages[:number] + all_messages[number + 1 :]
        assert target.read_bytes() == data[:12] + b"".join(others), (number, way)
        assert len(kept.dropped) == 1
        assert read(source, ()).problem is not None


def test_a_length_that_takes_in_the_next_message(recorded: Path, tmp_path: Path) -> None:
    data = (recorded / "segment-00001.rrd").read_bytes()
    all_messages, ends = messages(data), [12, *message_ends(data)]
    source, target = tmp_path / "segment-00001.rrd", tmp_path / "repaired.rrd"
    for number in range(len(all_messages) - 1):
        changed = bytearray(data)
        struct.pack_into("<Q", changed, ends[number] + 8, ends[number + 2] - ends[number] - 16)
        source.write_bytes(changed)
        repair(source, target)
        assert target.read_bytes() == data[:12] + b"".join(all_messages[:number] + all_messages[number + 1 :])


def test_of_any_flipped_bit_at_most_one_message_is_dropped(recorded: Path, tmp_path: Path) -> None:
    data = (recorded / "segment-00001.rrd").read_bytes()
    generator = random.Random(3)
    source, target = tmp_path / "segment-00001.rrd", tmp_path / "repaired.rrd"
    total = len(message_ends(data))
    for _ in range(60):
        changed = bytearray(data)
        changed[generator.randrange(message_ends(data)[-1])] ^= 1 << generator.randrange(8)
        source.write_bytes(changed)
        assert repair(source, target).messages >= total - 1


def test_verify_and_every_other_reader_lose_no_more(recorded: Path, tmp_path: Path) -> None:
    """The reader itself, on the fly: a length that leads beyond the file, in a batch amid the others."""
    data = bytearray((recorded / "segment-00001.rrd").read_bytes())
    batches = places_of_batches(recorded / "segment-00001.rrd")
    assert len(batches) == CYCLES // BATCH
    struct.pack_into("<Q", data, batches[2][0] + 8, 1 << 40)
    folder = spoilt(tmp_path / "moby", bytes(data))
    session = open_session(folder)
    whole = expected(list(drive(CYCLES)))
    assert list(session.cycles()) == whole[: 2 * BATCH] + whole[3 * BATCH :]
    assert [(gap.first_cycle, gap.last_cycle) for gap in session.gaps] == [(20, 29)]
    assert not session.complete
    done = repaired(folder)
    assert done.out == tmp_path / "moby-repaired"
    assert list(open_session(done.out).cycles()) == whole[: 2 * BATCH] + whole[3 * BATCH :]
    assert not open_session(done.out).complete
    assert done.segments[0].kept is not None
    assert done.segments[0].kept.dropped == (batches[2],)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_a_repaired_file_opens_in_reruns_own_reader(recorded: Path, tmp_path: Path) -> None:
    """Which reads nothing of one that was cut within a message."""
    data = (recorded / "segment-00001.rrd").read_bytes()
    folder = spoilt(tmp_path / "moby", data[: message_ends(data)[-3] - 5])
    with pytest.raises(RuntimeError):
        list(RrdReader(folder / "segment-00001.rrd").stream())
    done = repaired(folder)
    assert done.out is not None
    assert len(list(RrdReader(done.out / "segment-00001.rrd").stream())) > 10


def test_a_session_of_several_segments(tmp_path: Path) -> None:
    """One is whole, one damaged, one is nothing at all; the original stays as it was."""
    records = list(drive(90))
    session = writer(tmp_path)
    for start in (0, 30, 60):
        session.write(records[start : start + 30])
        session._close_segment()
    session.close()
    first, second, third = sorted(session.folder.glob("*.rrd"))
    second.write_bytes(second.read_bytes()[: second.stat().st_size // 2])
    third.write_bytes(b"nothing at all, but long enough")
    before = {path: path.read_bytes() for path in session.folder.iterdir()}
    done = repaired(session.folder, tmp_path / "new" / "folder")
    assert {path: path.read_bytes() for path in session.folder.iterdir()} == before
    assert done.out is not None
    assert (done.out / first.name).read_bytes() == before[first]
    whole, cut, nothing = done.segments
    assert (whole.kept, whole.problem) == (None, None)
    assert cut.kept is not None
    assert (nothing.kept, nothing.problem) == (None, "not a Rerun file")
    assert list(open_session(done.out).cycles()) == list(open_session(session.folder).cycles())


def run(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(build("replay"), ["replay", "repair", *map(str, arguments)])
    return done.exit_code, done.stdout, done.output


def test_the_command(recorded: Path, tmp_path: Path) -> None:
    code, _, words = run(recorded)
    assert (code, words) == (0, "complete: 60 cycles; nothing is written\n")
    data = (recorded / "segment-00001.rrd").read_bytes()
    folder = spoilt(tmp_path / "moby", data[:-150_000])
    code, out, _ = run(folder, "--json")
    told = json.loads(out)
    assert code == 0
    assert told["out"] == str(tmp_path / "moby-repaired")
    assert told["cycles"] == 60
    assert told["segments"][0]["whole"] is False
    assert "not closed" in told["problem"]
    code, _, words = run(folder)
    assert code == 2
    assert "is there already" in words
    code, _, words = run(folder, "--out", folder)
    assert code == 2
    code, _, words = run(folder, "--out", tmp_path / "other")
    assert code == 0
    assert "messages kept" in words
    assert "what stays lost" in words
    code, out, _ = run(tmp_path / "nothing", "--json")
    assert code == 2
    assert "cannot be read" in json.loads(out)["problem"]


def test_one_file_and_a_header_that_is_lost(recorded: Path, tmp_path: Path) -> None:
    file = tmp_path / "some.rrd"
    shutil.copyfile(recorded / "segment-00001.rrd", file)
    data = file.read_bytes()
    file.write_bytes(data[:-40])
    done = repaired(file)
    assert done.out == tmp_path / "some-repaired"
    assert [path.name for path in done.out.iterdir()] == ["segment-00001.rrd"]
    file.write_bytes(data[:2000])
    with pytest.raises(SessionError, match="no header"):
        repaired(file, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_full_disk_leaves_nothing(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    cut = spoilt(tmp_path / "cut", (recorded / "segment-00001.rrd").read_bytes()[:-150_000])
    monkeypatch.setattr("replay.sessions.repair.sync", full)
    code, told, _ = run(cut, "--out", tmp_path / "out", "--json")
    assert (code, json.loads(told)["problem"]) == (2, "No space left on device")
    assert not (tmp_path / "out").exists()
