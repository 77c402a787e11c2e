"""The digest chain: what was edited, taken out, put in or exchanged is named, with seal and footer put right too."""

import shutil
from collections.abc import Callable, Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from struct import pack

import pytest

from gateway.recording import segment
from gateway.recording.block import packed
from gateway.recording.chain import beginning, link
from gateway.recording.columns import arrays
from gateway.recording.disk import SUMS, segments
from gateway.recording.packets import Record, Snapshot
from gateway.recording.schema import BLOCK_PATH
from replay.compare.verify import verify
from replay.sessions.framing import read
from replay.sessions.reader import open_session
from replay.sessions.repair import repaired
from tests.drives import drive
from tests.recordings import expected, write, writer
from tests.replay.test_repair import places_of_batches

CYCLES, BATCH = 60, 10
Linked = Callable[[bytes, int, int, bytes], bytes]


def edited(records: Sequence[Record], cycle: int) -> list[Record]:
    """One cycle told otherwise: a byte of its first frame."""
    found = list(records)
    inputs = found[cycle].inputs
    frame, *others = inputs.frames
    other = frame._replace(data=bytes([frame.data[0] ^ 1]) + frame.data[1:])
    found[cycle] = Record(inputs._replace(frames=(other, *others)), found[cycle].outputs, found[cycle].timing)
    return found


def values(monkeypatch: pytest.MonkeyPatch, directory: Path) -> dict[int, bytes]:
    """Of the chain of the true recording, by the first cycle of the batch."""
    found: dict[int, bytes] = {}

    def keep(before: bytes, number: int, cycles: int, stored: bytes) -> bytes:
        found[number] = link(before, number, cycles, stored)
        return found[number]

    with monkeypatch.context() as patch:
        patch.setattr(segment, "link", keep)
        write(directory, list(drive(CYCLES)), batch=BATCH)
    return found


def test_the_values_can_be_computed_by_anybody() -> None:
    assert beginning("{}") == sha256(b"{}").digest()
    assert link(bytes(32), 7, 3, b"bytes") == sha256(bytes(32) + pack("<qq", 7, 3) + b"bytes").digest()


def test_a_drive_is_proven(tmp_path: Path) -> None:
    session = open_session(write(tmp_path, list(drive(CYCLES)), batch=BATCH))
    assert session.complete
    assert session.first_unproven is None
    rows = read(session.segments[0], [BLOCK_PATH]).batches[BLOCK_PATH]
    assert len(rows) == CYCLES // BATCH
    before, after = (
        [
            row.column(next(name for name in row.schema.names if name.endswith(f":{end}"))).to_pylist()[0][0]
            for row in rows
        ]
        for end in ("before", "chain")
    )
    assert before[1:] == after[:-1]
    assert len(set(after)) == CYCLES // BATCH


@pytest.mark.parametrize("cycle", [0, 34, 59])
def test_an_edited_batch_is_named_whatever_else_was_put_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cycle: int
) -> None:
    """Its checks, the seal and the footer fit what was edited; the chain is that of the truth."""
    true = values(monkeypatch, tmp_path / "true")
    monkeypatch.setattr(segment, "link", lambda _before, number, _cycles, _stored: true[number])
    records = edited(list(drive(CYCLES)), cycle)
    session = open_session(write(tmp_path / "edited", records, batch=BATCH))
    first = cycle // BATCH * BATCH
    assert list(session.cycles()) == expected(records)
    words = "are not as they were recorded: they do not fit the digest chain"
    assert session.problems == (f"segment-00001.rrd: cycles {first} to {first + 9} {words}",)
    assert session.first_unproven == first
    assert not session.complete


def test_verify_names_it_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    true = values(monkeypatch, tmp_path / "true")
    monkeypatch.setattr(segment, "link", lambda _before, number, _cycles, _stored: true[number])
    verdict = verify(open_session(write(tmp_path / "edited", edited(list(drive(CYCLES)), 34), batch=BATCH)))
    assert verdict.exit_code != 0
    assert verdict.first_unproven == 30
    assert (verdict.problem or "").startswith("segment-00001.rrd: cycles 30 to 39 are not as they were recorded")
    assert verdict.as_json()["first_unproven"] == 30


def test_an_edited_batch_whose_own_value_was_put_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then what stands behind it does not follow from it."""
    true = values(monkeypatch, tmp_path / "true")

    def forged(columns: dict[str, object], rows: Sequence[tuple[object, ...]]) -> object:
        """Of every batch but the edited one, both values as they were."""
        if "block" in columns:
            ((count, block, before, chain),) = rows
            number = next((number for number, value in true.items() if value == chain), None)
            if number is not None and number:
                before = true[number - BATCH]
            rows = [(count, block, before, chain)]
        return arrays(columns, rows)  # type: ignore[arg-type]

    def linked(before: bytes, number: int, cycles: int, stored: bytes) -> bytes:
        return link(before, number, cycles, stored) if number == 30 else true[number]

    monkeypatch.setattr(segment, "link", linked)
    monkeypatch.setattr(segment, "arrays", forged)
    session = open_session(write(tmp_path / "edited", edited(list(drive(CYCLES)), 34), batch=BATCH))
    assert len(session.problems) == 1
    assert "in front of cycle 40 something was taken out, put in or exchanged" in session.problems[0]
    assert session.first_unproven == 40


def test_a_batch_taken_out_and_two_exchanged(tmp_path: Path) -> None:
    """Without a gap they are found by the chain; here neither seal nor footer is put right, and it is named first."""
    path = write(tmp_path, list(drive(CYCLES)), batch=BATCH) / "segment-00001.rrd"
    data = path.read_bytes()
    places = places_of_batches(path)
    (a, b), (c, d) = places[2:4]
    path.write_bytes(data[:a] + data[b:])
    session = open_session(path)
    assert "in front of cycle 30 something was taken out" in session.problems[0]
    assert session.first_unproven == 20  # the gap
    path.write_bytes(data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:])
    session = open_session(path)
    assert "in front of cycle 30 something was taken out" in session.problems[0]
    assert list(session.cycles()) == expected(list(drive(CYCLES)))


def test_the_last_batch_taken_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The seal tells the value with which the segment ended."""
    true = values(monkeypatch, tmp_path / "true")

    def forged(columns: dict[str, object], rows: Sequence[tuple[object, ...]]) -> object:
        if "final" in columns:
            rows = [(*row[:-1], true[50]) for row in rows]
        return arrays(columns, rows)  # type: ignore[arg-type]

    monkeypatch.setattr(segment, "arrays", forged)
    session = open_session(write(tmp_path / "cut", list(drive(CYCLES - BATCH)), batch=BATCH))
    assert len(session.problems) == 1
    assert "behind cycle 49 something was taken out" in session.problems[0]
    assert session.first_unproven == 50


def test_a_header_told_otherwise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segment, "beginning", lambda text: beginning(text.replace("moby", "ybom")))
    session = open_session(write(tmp_path, list(drive(CYCLES)), batch=BATCH))
    assert "in front of cycle 0 something" in session.problems[0]
    assert session.first_unproven == 0


def three_segments(directory: Path, records: Sequence[Record]) -> Path:
    session = writer(directory)
    for start in range(0, CYCLES, 20):
        session.write(records[start : start + 10], (), Snapshot(start - 1, b"\x80") if start else None)
        session.write(records[start + 10 : start + 20])
        session._close_segment(final=start == 40)
    session.close()
    return session.folder


def test_the_chain_goes_on_from_segment_to_segment(tmp_path: Path) -> None:
    records = list(drive(CYCLES))
    folder = three_segments(tmp_path / "true", records)
    assert open_session(folder).problems == ()
    other = three_segments(tmp_path / "other", edited(records, 25))
    assert other.name == folder.name  # as the same session it would pass
    shutil.copyfile(segments(other)[1], segments(folder)[1])
    (folder / SUMS).unlink()  # as if nobody had noted any
    session = open_session(folder)
    assert session.problems == (
        "segment-00003.rrd: in front of cycle 40 something was taken out, put in or exchanged: "
        "it does not fit the digest chain",
    )
    shutil.copyfile(segments(three_segments(tmp_path / "third", edited(records, 5)))[0], segments(folder)[0])
    assert open_session(folder).first_unproven == 20


def test_a_segment_alone_is_proven_in_itself(tmp_path: Path) -> None:
    for path in segments(three_segments(tmp_path, list(drive(CYCLES)))):
        assert not [problem for problem in open_session(path).problems if "chain" in problem]


def test_behind_damage_the_chain_still_judges_each_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One batch is damaged, which is no fault of the others; one behind it was edited."""
    true = values(monkeypatch, tmp_path / "true")
    monkeypatch.setattr(segment, "link", lambda _before, number, _cycles, _stored: true[number])
    path = write(tmp_path / "edited", edited(list(drive(CYCLES)), 51), batch=BATCH) / "segment-00001.rrd"
    data = bytearray(path.read_bytes())
    begin, end = places_of_batches(path)[2]
    data[(begin + end) // 2 : end] = bytes(end - (begin + end) // 2)
    path.write_bytes(data)
    session = open_session(path)
    assert "cycles 50 to 59 are not as they were recorded" in session.problems[0]
    assert [gap.first_cycle for gap in session.gaps] == [20]
    assert session.first_unproven == 20


def test_what_was_repaired_is_proven_as_far_as_it_is_there(tmp_path: Path) -> None:
    path = write(tmp_path, list(drive(CYCLES)), batch=BATCH)
    file = path / "segment-00001.rrd"
    data = bytearray(file.read_bytes())
    begin, end = places_of_batches(file)[-1]
    file.write_bytes(data[: end - 5])
    done = repaired(path)
    assert done.out is not None
    session = open_session(done.out)
    assert session.first_unproven == 50
    assert not [problem for problem in session.problems if "chain" in problem]
    assert begin < end


def test_every_byte_of_a_batch_counts() -> None:
    block = packed(list(drive(3)))
    true = link(bytes(32), 0, 3, block)
    for place in range(0, len(block), 7):
        assert link(bytes(32), 0, 3, block[:place] + bytes([block[place] ^ 1]) + block[place + 1 :]) != true
    assert len({link(bytes(32), a, b, block) for a, b in pairwise(range(5))}) == 4
