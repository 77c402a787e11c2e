"""The experiments of the paper: each runs, holds what it is held to, draws, and leaves sessions that verify."""

import json
import math
import re
import struct
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.config import ConfigError
from replay.compare.verify import verify
from replay.reproduce import drawing, experiments, tables
from replay.reproduce.experiments import EXPERIMENTS, Experiment
from replay.reproduce.picture import Line, Panel, Picture
from replay.reproduce.result import Found, ReproduceError, Result, Row, Stage, at_least, within
from replay.sessions.reader import open_session

NAMES = ["moby-fig5", "moby-fig7", "moby-fig8", "moby-fig9", "moby-fig11", "moby-fig13", "moby-fig14", "moby-fig15"]
NAMES += ["rojas-fig4", "rojas-fig9", "rojas-fig10", "rojas-launch", "rojas-slip", "rojas-dead"]
NAMES += ["kane-fig7", "kane-fig8", "kane-fig9", "kane-fig13", "kane-fig19", "kane-fig24", "kane-tracking"]
NAMES += ["odd-fig8", "odd-fig9", "odd-fig10", "odd-fig11"]
QUICK = ["moby-fig7", "rojas-fig4", "rojas-fig9", "rojas-fig10", "rojas-launch", "rojas-slip", "kane-fig7", "kane-fig8"]
WALL_NS = 1_700_000_000_000_000_000
NUMBERED = re.compile(r"\b[RKOM]\d+\b|\bE-\d{3}|\bscience\b")  # of a list that no reader of the table has
RUNNER = CliRunner()


def test_every_figure_of_the_paper_that_is_to_be_there() -> None:
    assert sorted(EXPERIMENTS) == sorted(NAMES)


@pytest.mark.parametrize("name", QUICK)
def test_contract_of_an_experiment(name: str, tmp_path: Path) -> None:
    """Of those that take a second or two; all of them, with every session: `python -m tests.experiments`."""
    result = held_to_the_contract(name, tmp_path)
    if name == "kane-fig8":  # it takes as long as the drive
        verdict = verify(open_session(next(iter(result.sessions.values()))))
        assert (verdict.identical, verdict.exit_code) == (True, 0)


def held_to_the_contract(name: str, folder: Path) -> Result:
    """Everything that `--json` and the page promise, and every row within what it is allowed."""
    told: list[str] = []
    result = experiments.reproduce(name, folder, started_wall_ns=WALL_NS, tell=told.append)
    assert len(told) == EXPERIMENTS[name].parts
    assert result.rows
    assert not result.missed
    quantities = [row.quantity for row in result.rows]
    assert len(set(quantities)) == len(quantities)
    assert any(row.quantity.endswith("service") for row in result.rows)
    assert all(math.isfinite(row.ours) for row in result.rows)
    assert all("not printed" not in row.note for row in result.rows if row.paper is not None)
    assert result.notes
    texts = (*result.notes, *(row.note for row in result.rows))
    assert not [text for text in texts if NUMBERED.search(text)]
    assert size_of_png(result.picture) > (800, 350)
    assert result.table.read_text().count("\n| ") == len(result.rows) + 1
    for session in result.sessions.values():
        assert session.parent == folder / name
        opened = open_session(session)
        assert opened.complete
        assert opened.cycle_count > 350
    return result


def size_of_png(path: Path) -> tuple[int, int]:
    """Width and height from the header."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:24])
    return width, height


@pytest.mark.parametrize(
    ("row", "missed"),
    [
        (Row("a", "m", 1.0), False),
        (Row("a", "m", 1.0, paper=9.0), False),  # the paper binds nobody
        (Row("a", "m", 1.0, allowed=(0.9, 1.0)), False),
        (Row("a", "m", 1.01, allowed=(0.9, 1.0)), True),
        (Row("a", "m", 0.89, allowed=within(1.0, 0.1)), True),
        (Row("a", "m", 1.99, allowed=at_least(2.0)), True),
        (Row("a", "m", math.nan, allowed=at_least(2.0)), True),
        (Row("a", "m", math.inf, allowed=(0.0, 5.0)), True),
    ],
)
def test_when_a_row_misses(row: Row, missed: bool) -> None:
    assert row.missed is missed


def test_what_never_comes_is_null_and_said_so() -> None:
    row = Row("time of the flip", "s", math.inf)
    assert row.as_json()["ours"] is None
    assert "never" in tables.cells(row)


# The command, with an experiment that costs nothing.


def small(ours: float) -> Experiment:
    def run(stage: Stage) -> Found:
        stage.tell("nothing")
        row = Row("peak <torque>", "N m", ours, 12.38, "R | d2 & x_B", within(12.0, 1.0))
        panel = Panel("A", "t [s]", "y [m]", lines=(Line("line", [0.0, 1.0], [0.0, 1.0]),))
        return Found((row, Row("other", "m", 1.0)), Picture("Title", ((panel,),)), ("note",), {"drive": stage.folder})

    return Experiment("Something <small>", run, 1)


@pytest.fixture
def replaced(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Experiment]]:
    """Two experiments instead of those that there are: `good` and `bad`."""
    given = {"good": small(12.5), "bad": small(99.0)}
    monkeypatch.setattr(import_module("replay.reproduce.experiments"), "EXPERIMENTS", given)
    yield given


def called(*arguments: str) -> tuple[int, str]:
    result = RUNNER.invoke(build("reproduce"), ["reproduce", *arguments])
    if isinstance(result.exception, ConfigError):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.mark.usefixtures("replaced")
def test_json_of_one(tmp_path: Path) -> None:
    code, out = called("good", "--out", str(tmp_path), "--json")
    told = json.loads(out.splitlines()[-1])
    assert code == 0
    assert told["name"] == "good"
    assert told["rows"][0] == {
        "quantity": "peak <torque>",
        "paper": 12.38,
        "ours": 12.5,
        "unit": "N m",
        "note": "R | d2 & x_B",
    }
    assert told["rows"][1]["paper"] is None
    assert told["session"] == str(tmp_path / "good")
    assert Path(told["picture"]).is_file()
    assert Path(told["table"]).is_file()
    assert told["missed"] == []
    assert not (tmp_path / "reproduction.html").exists()


@pytest.mark.usefixtures("replaced")
@pytest.mark.parametrize("arguments", [("bad",), ("--all",), ("bad", "--json")])
def test_exit_1_where_a_row_misses(arguments: tuple[str, ...], tmp_path: Path) -> None:
    code, out = called(*arguments, "--out", str(tmp_path))
    assert code == 1
    if "--json" in arguments:
        assert json.loads(out.splitlines()[-1])["missed"] == ["peak <torque>"]


@pytest.mark.usefixtures("replaced")
def test_all_on_one_page_with_its_pictures(tmp_path: Path) -> None:
    code, out = called("--all", "--out", str(tmp_path), "--json")
    told = json.loads(out.splitlines()[-1])
    page = Path(told["page"]).read_text()
    assert code == 1
    assert [one["name"] for one in told["experiments"]] == ["good", "bad"]
    assert told["missed"] == ["bad: peak <torque>"]
    assert page.count('src="data:image/png;base64,') == 2
    assert page.count("<tr") == 2 * 3
    assert page.count('class="missed"') == 1
    assert "peak &lt;torque&gt;" in page
    assert "<torque>" not in page
    assert "http" not in page.replace("http-equiv", "")  # it needs nothing from anywhere


@pytest.mark.usefixtures("replaced")
def test_a_list_without_a_name() -> None:
    code, out = called()
    assert code == 0
    assert "good" in out
    assert "bad" in out
    assert json.loads(called("--json")[1]) == {"experiments": {"good": "Something <small>", "bad": "Something <small>"}}


@pytest.mark.usefixtures("replaced")
def test_an_unknown_name_is_told_those_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'moby-fig6': there is good, bad"):
        called("moby-fig6", "--out", str(tmp_path))
    with pytest.raises(ConfigError, match="give either a name or --all"):
        called("good", "--all", "--out", str(tmp_path))


def test_a_robot_that_does_not_start(replaced: dict[str, Experiment], tmp_path: Path) -> None:
    def run(_: Stage) -> Found:
        raise ReproduceError("the robot does not start: idle")

    replaced["good"] = Experiment("Something", run, 0)
    assert called("good", "--out", str(tmp_path))[0] == 1


@pytest.mark.usefixtures("replaced")
def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written: "):
        called("good", "--out", str(tmp_path / "file"))


def test_a_picture_is_the_same_twice(tmp_path: Path) -> None:
    panel = Panel("A", "t [s]", "y [m]", lines=(Line("line", [0.0, 1.0], [0.0, 1.0]),))
    for name in ("one", "two"):
        drawing.draw(Picture("Title", ((panel, panel), (panel,))), tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
