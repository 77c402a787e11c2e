"""Which robot file a name means, and what a command says when it means none or nobody answers."""

from pathlib import Path

import pytest

from gateway import robot_files
from gateway.cli.operate import Target, locate, unanswered
from gateway.client import DEFAULT_ENDPOINT
from gateway.config import ConfigError
from gateway.guess import guess
from gateway.robot_files import Place
from tests.world import robot_text

ROBOTS = robot_files.bundled()["moby"].parent  # of a checkout or of an installation


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A computer with a moby of its own, and a robot that is called otherwise than its file."""
    monkeypatch.setattr(robot_files, "INSTALLED", tmp_path)
    monkeypatch.chdir(tmp_path.parent)
    text = robot_text("moby").replace("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7555")
    (tmp_path / "moby.toml").write_text(text)
    (tmp_path / "left.toml").write_text(text.replace('name = "moby"', 'name = "porter"'))
    (tmp_path / "broken.toml").write_text("[robot")
    return tmp_path


def test_an_installed_file_comes_before_the_bundled_one(here: Path) -> None:
    moby = robot_files.locate("moby")
    assert tuple(moby) == (here / "moby.toml", Place.INSTALLED, ROBOTS / "moby.toml")
    assert moby.words == f"{here}/moby.toml (installed, not the bundled {ROBOTS}/moby.toml)"
    assert robot_files.find("moby") == here / "moby.toml"
    assert robot_files.find_bundled("moby") == ROBOTS / "moby.toml"
    omni = robot_files.locate("omni4")
    assert omni.words == f"{ROBOTS}/omni4.toml (bundled)"


def test_a_path_is_taken_as_it_is(here: Path) -> None:
    given = robot_files.locate(str(ROBOTS / "moby.toml"))
    assert given == (ROBOTS / "moby.toml", Place.GIVEN, None)
    assert robot_files.locate("none.toml").words == "none.toml", "that it is not there is for its reader to say"
    (here.parent / "moby").mkdir()
    assert robot_files.locate("moby").place is Place.INSTALLED, "a folder of that name is no robot file"


def test_a_robot_is_found_by_its_own_name_too(here: Path) -> None:
    assert robot_files.find("porter") == here / "left.toml"
    assert robot_files.unlike(here / "moby.toml", "moby") is None
    words = robot_files.unlike(here / "left.toml", "porter")
    assert words is not None
    assert words.startswith("robot.name = 'porter' is not the name of its file, left.toml")
    assert words.endswith("its service is drivegate@left")


NOWHERE = [
    ("mob", ["no such robot file", "installed: broken, left, moby; bundled: ", "; did you mean 'moby'?"]),
    ("omni_4", ["; did you mean 'omni4'?"]),
    ("zzz", ["give a path ending in .toml or one of these"]),
    ("mine", ["there is mine.toml here: give it with its .toml"]),
]


@pytest.mark.parametrize(("name", "words"), NOWHERE)
def test_a_name_of_nothing(here: Path, name: str, words: list[str]) -> None:
    (here.parent / "mine.toml").write_text("")
    with pytest.raises(ConfigError) as caught:
        robot_files.locate(name)
    assert all(word in str(caught.value) for word in words), caught.value
    assert ("did you mean" in str(caught.value)) == any("did you mean" in word for word in words)


def test_the_endpoint_is_that_of_the_file(here: Path) -> None:
    installed = f"{here}/moby.toml (installed, not the bundled {ROBOTS}/moby.toml)"
    mine = "tcp/127.0.0.1:7555"
    assert locate("moby", None) == Target("moby", mine, f"zenoh.listen of {installed}", told=True)
    assert locate("porter", None)[:2] == ("porter", mine)
    assert locate("left", None)[:2] == ("porter", mine)
    assert locate(str(ROBOTS / "moby.toml"), None) == Target(
        "moby", DEFAULT_ENDPOINT, f"zenoh.listen of {ROBOTS}/moby.toml"
    )
    assert locate("moby", "tcp/10.0.0.7:1")[1:3] == ("tcp/10.0.0.7:1", f"as given by --connect, of {installed}")
    assert locate("stranger", None) == Target("stranger", DEFAULT_ENDPOINT, "of no robot file, so the usual one")
    assert locate("stranger", "tcp/10.0.0.7:1") == Target("stranger", "tcp/10.0.0.7:1", "as given by --connect")


def test_a_wrong_file_that_was_only_looked_up_keeps_no_stop_away(here: Path) -> None:
    found = locate("broken", None)
    assert found[:2] == ("broken", DEFAULT_ENDPOINT)
    assert found.told
    assert "broken.toml (installed) not valid TOML" in found.source
    with pytest.raises(ConfigError, match="not valid TOML"):
        locate(str(here / "broken.toml"), None)


def test_who_does_not_answer_and_what_to_pass() -> None:
    target = Target("mobi", "tcp/127.0.0.1:7447", "of no robot file, so the usual one")
    words = unanswered(target, ["moby", "omni4"])
    assert words.startswith("mobi does not answer on tcp/127.0.0.1:7447 (of no robot file, so the usual one); ")
    assert "there answers moby, omni4: give that as NAME" in words
    assert "pass --connect tcp/ADDRESS:PORT" in words
    assert "or its robot file as NAME" in words
    assert "there answers" not in unanswered(target, [])


@pytest.mark.parametrize(
    ("word", "words"),
    [("odrvie", "; did you mean 'odrive'?"), ("ODrive", "; did you mean 'odrive'?"), ("pump", ""), ("", "")],
)
def test_what_was_meant(word: str, words: str) -> None:
    assert guess(word, ["odrive", "dji", "vesc"]) == words
