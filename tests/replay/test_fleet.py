"""Many sessions at once: a line for each, whatever it is, and the same verdicts in however many processes."""

import json
import os
import shutil
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.types import Mode, Twist
from replay.compare.fleet import Judged, Tally, all_judged, judged
from replay.compare.side_by_side import processes
from replay.sessions.folders import sessions
from tests.recordings import write_drive
from tests.world import World

KEYS = [
    *("identical", "complete", "cycles", "frames", "unseen", "realtime_ratio", "first_difference", "problem"),
    *("refused", "exit_code", "software_change", "first_unproven"),
]  # the documented ones, on which others build


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Identical ones, an incomplete, a different, a broken one, and one that is no session, in folders of folders."""
    folder = tmp_path_factory.mktemp("fleet")
    world = World("moby", rate_hz=100.0)
    world.start()
    world.run(0.3, Twist(0.3, 0.1, 0.0))
    whole = write_drive(folder / "robots" / "a", world)
    shutil.copytree(whole, folder / "robots" / "b" / "whole")
    records = list(world.records)
    inputs, outputs = records[60]
    world.records[60] = (inputs, outputs._replace(mode=Mode.FAULT))
    write_drive(folder / "robots" / "c", world)
    world.records = [*records[:60], *records[65:]]
    write_drive(folder / "robots" / "d", world)
    (folder / "robots" / "e").mkdir()
    (folder / "robots" / "e" / "segment-00001.rrd").write_bytes(b"RRF2" + bytes(range(256)))
    (folder / "empty").mkdir()
    return folder


def named(fleet: Path) -> list[Path]:
    return [fleet / "robots", fleet / "empty", fleet / "not there"]


def comparable(found: Judged) -> dict[str, object]:
    return found.as_json() | {"realtime_ratio": None}


def run(*words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "verify", *map(str, words)])


def test_sessions_are_found_in_folders_once(fleet: Path) -> None:
    found = sessions([*named(fleet), fleet / "robots" / "a"])
    assert [Path(path).relative_to(fleet).parts[:2] for path in found] == [
        *(("robots", letter) for letter in "abcde"),
        ("empty",),
        ("not there",),
    ]


def test_each_is_a_verdict_and_none_an_exception(fleet: Path) -> None:
    found = [judged(path) for path in sessions(named(fleet))]
    assert [one.verdict.exit_code for one in found] == [0, 0, 1, 3, 2, 2, 2]
    assert [one.differences is not None for one in found] == [False, False, True, False, False, False, False]
    assert found[0].verdict.seconds == pytest.approx((found[0].verdict.cycles - 1) * 0.01)
    assert all(one.reason for one in found[2:])


def test_in_processes_the_verdicts_are_the_same(fleet: Path) -> None:
    paths = sessions(named(fleet))
    with processes(2) as pool:
        assert list(map(comparable, all_judged(paths, pool))) == list(map(comparable, map(judged, paths)))


class Broken(Executor):
    """Answers a few, then a process has died."""

    def submit(self, fn, /, *args, **_):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN002, ANN003, ANN201
        future: Future[Judged] = Future()
        if args[0].parts[-2] == "a":
            future.set_result(fn(*args))
        else:
            future.set_exception(BrokenProcessPool())
        return future


def test_a_process_that_dies_takes_no_session_with_it(fleet: Path) -> None:
    paths = sessions(named(fleet))
    assert list(map(comparable, all_judged(paths, Broken()))) == list(map(comparable, map(judged, paths)))


def test_the_worst_exit_code_is_that_of_all(fleet: Path) -> None:
    verdicts = {one.verdict.exit_code: one for one in map(judged, sessions([fleet / "robots"]))}
    for codes, worst in (((0,), 0), ((0, 3), 3), ((0, 3, 2), 2), ((2, 1, 0, 3), 1), ((), 2)):
        tally = Tally()
        for code in codes:
            tally.add(verdicts[code])
        assert tally.exit_code == worst


def test_the_command_has_a_line_for_each_and_a_summary(fleet: Path) -> None:
    done = run(*named(fleet), "--jobs", 1)
    assert done.exit_code == 1
    lines = done.stdout.splitlines()
    assert [line.split("  ")[0].strip() for line in lines[:-1]] == [
        *("identical", "identical", "different", "incomplete", "not replayable", "not replayable", "not replayable")
    ]
    assert "cycle 60: mode" in lines[2]
    assert lines[-1].startswith("7 sessions, ")
    assert "2 identical, 1 incomplete, 3 not replayable, 1 different" in lines[-1]


def test_the_document_of_many(fleet: Path) -> None:
    done = run(*named(fleet), "--jobs", 2, "--json")
    told = json.loads(done.stdout)
    assert done.exit_code == told["summary"]["exit_code"] == 1
    assert [one["exit_code"] for one in told["sessions"]] == [0, 0, 1, 3, 2, 2, 2]
    assert {key: told["summary"][key] for key in ("identical", "different", "incomplete", "not_replayable")} == {
        **{"identical": 2, "different": 1, "incomplete": 1, "not_replayable": 3}
    }
    assert told["sessions"][2]["differences"]["episodes"][0]["first_cycle"] == 60


def test_the_document_of_one_is_what_it_was(fleet: Path) -> None:
    for folder in ("a", "c"):
        (session,) = sessions([fleet / "robots" / folder])
        assert list(json.loads(run(session, "--json").stdout)) == KEYS
        told = json.loads(run(session, "--json", "--all").stdout)
        assert list(told) == [*KEYS, "differences"]
        assert (told["differences"] is None) is (folder == "a")


def test_of_one_all_differences_are_shown(fleet: Path) -> None:
    (session,) = sessions([fleet / "robots" / "c"])
    shown = run(session).stdout
    assert "1 cycles differ" in shown
    assert "cause: unknown" in shown


def test_junit_has_a_case_for_each(fleet: Path, tmp_path: Path) -> None:
    file = tmp_path / "verdicts.xml"
    assert run(*named(fleet), "--jobs", 1, "--junit", file).exit_code == 1
    (suite,) = ElementTree.parse(file).getroot()
    assert {key: suite.get(key) for key in ("tests", "failures", "errors")} == {
        **{"tests": "7", "failures": "2", "errors": "3"}
    }
    tags = [[child.tag for child in case] for case in suite]
    assert tags == [[], [], ["failure"], ["failure"], ["error"], ["error"], ["error"]]
    assert "mode" in str(suite[2][0].get("message"))
    (session,) = sessions([fleet / "robots" / "c"])
    assert run(session, "--junit", file).exit_code == 1
    assert ElementTree.parse(file).getroot()[0].get("failures") == "1"


def test_junit_that_cannot_be_written_is_said(fleet: Path, tmp_path: Path) -> None:
    done = run(fleet / "robots", "--jobs", 1, "--junit", tmp_path / "nowhere" / "verdicts.xml")
    assert done.exit_code == 2
    assert "cannot be written" in done.output


def test_a_name_that_xml_cannot_hold(fleet: Path, tmp_path: Path) -> None:
    (session,) = sessions([fleet / "robots" / "c"])
    odd = Path(shutil.copytree(session, tmp_path / "a\x01<b>&"))
    file = tmp_path / "verdicts.xml"
    assert run(odd, odd, "--jobs", 1, "--junit", file).exit_code == 1
    assert os.fspath(odd).replace("\x01", "\ufffd") in [
        case.get("name") for case in ElementTree.parse(file).getroot()[0]
    ]
