"""What of the documentation can be told without building it, and whether what looks at it can fail."""

import re
import tomllib
from pathlib import Path

import pytest

from gateway.cli.app import COMMANDS
from gateway.edges import keys
from gateway.words import codes
from tests.docs import generated, site, words
from tests.docs.pages import DOCS, ROOT, Block, blocks, name, sources
from tests.docs.running import BlockError, run_blocks
from tests.docs.terminal import Terminal, environment
from tests.docs.three_robots import STORIES, kept, normal

PAGES = sources()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_its_commands_and_files_are_right(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert list(words.faults(text)) == []
    for block in blocks(text):
        if block.language == "toml":
            tomllib.loads(block.text)
        if block.language == "sh":
            assert block.runs or words.covered_by_nothing(block) is None


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=name)
def test_it_can_be_filled_in(page: Path) -> None:
    filled = site.filled(page.read_text(encoding="utf-8"))
    assert "<!-- generated" not in filled
    assert filled.startswith("# ")


def test_every_page_is_in_the_contents_once() -> None:
    listed = re.findall(r": (\S+\.md)$", site.SETTINGS.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


def test_the_newest_entry_of_the_changelog_is_this_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    newest = re.search(r"^## ([\d.]+)", (DOCS / "changelog.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version


def test_the_readme_tells_developers_every_room_and_every_lane() -> None:
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## Developers\n")[2].partition("\n## ")[0]
    told = set()
    for line in section.splitlines():  # "`gateway/a/`, `b/`" is two rooms of gateway
        if found := re.match(r"\| `(gateway|replay)/\w.*?\|", line):
            told |= {f"{found[1]}/{room}" for room in re.findall(r"`(?:\w+/)?(\w+)/`", found[0])}
    rooms = {str(path.parent.relative_to(ROOT)) for top in ("gateway", "replay") for path in ROOT.glob(f"{top}/*/*.py")}
    assert told == rooms
    lanes = re.findall(r"-m (tests[.\w]*)", (ROOT / "tests/run.sh").read_text(encoding="utf-8"))
    assert lanes
    assert [lane for lane in lanes if not re.search(rf"^\| `python -m {re.escape(lane)}[ `]", section, re.M)] == []


def test_what_is_made_from_the_code_is_all_of_it() -> None:
    said = generated.command_line()
    assert all(f"### drivegate {command}" in said for command in COMMANDS)
    said = generated.codes()
    assert all(f"### {code}\n" in said for code in codes())
    said = generated.zenoh_keys()
    told = {value for key, value in vars(keys).items() if key.isupper() and isinstance(value, str) and "*" not in value}
    assert [key for key in told if f"| `{key}` " not in said] == []
    assert "`limits.motor_speed`" in generated.robot_file()


def test_numbers_of_a_chassis_are_those_of_its_kinematics() -> None:
    # Otbot-1, the platform a quarter turn to the left: forward to it is left to the chassis, see test_kinematics.
    assert "| left | -8.0000 | -10.0000 | 0.0000 |" in generated.wheel_matrix("moby", "90")
    assert "and back from these speeds: 0.4, 0.2, 0.5." in generated.wheel_speeds("moby", "0.4", "0.2", "0.5")


@pytest.mark.parametrize("robot", STORIES)
def test_a_kept_story_ends_with_a_square_that_verifies(robot: str) -> None:
    lines = kept(robot).read_text(encoding="utf-8").splitlines()
    places = [line.split() for line in lines if line.startswith("at x ")]
    square = [(round(float(words[2]), 1), round(float(words[5]), 1)) for words in places]
    assert [(x + 0.0, y + 0.0) for x, y in square] == [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)]
    assert lines[-1].startswith("identical: ")


def test_a_story_is_told_by_words_and_not_by_the_day() -> None:
    assert normal("at x 1.02 m\nkiwi-20261127T071921Z\n│ odrive 0.6 │ 1  │ 981      │ state") == normal(
        "at x 0.98 m\nkiwi-20270101T000000Z\n│ odrive 0.6 │ 1  │ 1005     │ state"
    )
    assert normal("direction = 1") != normal("direction = -1")
    assert normal("odrive id 1 turns now.") != normal("odrive id 2 turns now.")


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("```sh\ndrivegate fly\n```", "no such command: drivegate fly"),
        ("```sh\ntrue && drivegate check\n```", "Missing parameter: file"),
        ("```sh\ncd x && drivegate watch moby --nonsense >y\n```", "No such option"),
        ("```sh\ndrivegate send moby --vx much &\n```", "drivegate send moby --vx much"),
        ("<!-- covered: tests/nowhere.py -->\n```sh\ntrue\n```", "no such file"),
        ("<!-- covered: tests/docs/test_docs.py::test_nothing -->\n```sh\ntrue\n```", "no such test"),
        ("```sh\nsh deploy/install.sh\n```", "deploy/install.sh changes a computer"),
        ("```sh\nsudo drivegate check moby\n```", "sudo changes a computer"),
        ("use `drivegate check --harder`", "no option --harder"),
        ("use `drivegate replay guess SESSION`", "no such command"),
    ],
)
def test_what_is_wrong_with_a_command_is_seen(told: str, said: str) -> None:
    (fault,) = words.faults(told)
    assert said in fault


def test_what_is_right_is_left_alone() -> None:
    told = "```sh\ndrivegate send moby --vx 0.2 --for 3 >x 2>&1 &\n```\n"
    assert list(words.faults(told + "`drivegate replay SOMETHING`, `drivegate --version`")) == []


@pytest.mark.parametrize("told", ["```sh\ntrue\n", "<!-- exit: 1 -->\n\n```sh\nfalse\n```"])
def test_a_page_that_is_not_made_well_is_refused(told: str) -> None:
    with pytest.raises(ValueError, match=r"line [12]:"):
        list(blocks(told))


def test_blocks_are_run_in_order_and_end_as_their_page_says(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    right = "<!-- file: a.txt -->\n```text\nwords\n```\n```sh\ngrep words a.txt\n```\n"
    right += "<!-- exit: 3 -->\n```sh\nexit 3\n```\n"
    page.write_text(right + "```python\nprint(open('a.txt').read())\n```\n<!-- covered: x -->\n```sh\nfalse\n```\n")
    (tmp_path / "right").mkdir()
    assert run_blocks(page, tmp_path / "right") == 4
    page.write_text(right + "```sh\ntrue\nfalse\ntrue\n```\n")
    (tmp_path / "wrong").mkdir()
    with pytest.raises(BlockError, match="line 12 exits with 1, not 0"):
        run_blocks(page, tmp_path / "wrong")


def test_a_terminal_of_its_own_must_go_on_until_it_is_ended(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    begin = (
        "<!-- terminal: 1 -->\n```sh\ntrap 'touch ended; exit 0' INT\ntouch begun\nwhile :; do sleep 0.02; done\n```\n"
    )
    wait = "```sh\nuntil [ -e begun ]; do :; done\n```\n"
    page.write_text(f"{begin}{wait}<!-- ended: 1 -->\n```sh\ntest -e ended\n```\n")
    (tmp_path / "right").mkdir()
    assert run_blocks(page, tmp_path / "right") == 3
    page.write_text(
        "<!-- terminal: 1 -->\n```sh\ntouch begun\nexit 7\n```\n```sh\nuntil [ -e begun ]; do :; done\nwait\n```\n"
    )
    (tmp_path / "wrong").mkdir()
    with pytest.raises(BlockError, match="ended with"):
        run_blocks(page, tmp_path / "wrong")


def test_links_that_lead_nowhere_and_pages_that_ask_elsewhere_are_seen(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text('<h1 id="top"></h1><a href="b.html#here"></a><a href="b.html#gone"></a>')
    (tmp_path / "b.html").write_text(
        '<p id="here"></p><a href="a.html"></a><a href="c.html"></a><a href="#none"></a>'
        '<script src="https://elsewhere.invalid/x.js"></script><a href="https://elsewhere.invalid"></a>'
    )
    (tmp_path / "s.css").write_text("@font-face { src: url(https://elsewhere.invalid/f.woff) }")
    assert sorted(site.broken(tmp_path)) == [
        "a.html: no such place: b.html#gone",
        "b.html loads https://elsewhere.invalid/x.js",
        "b.html: no such place: #none",
        "b.html: nothing is at c.html",
        "s.css loads url(https://elsewhere.invalid/f.woff)",
    ]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_in_the_repository(page: Path) -> None:
    assert list(site.broken_in_repository(page)) == []


def test_anchors_are_those_of_the_headings() -> None:
    assert site.anchors("# One thing: `x`\n```\n# not\n```\n## Two") == {"one-thing-x", "two"}


def test_formulae_become_mathml_and_code_does_not() -> None:
    filled = site.filled("a $x_i$ `$HOME`\n```sh\necho $HOME $PATH\n```\n```math\n\\frac{1}{2}\n```\n")
    assert filled.count("<math") == 2
    assert site.filled("$x$ begins a line").startswith("<span><math")
    assert "`$HOME`" in filled
    assert "echo $HOME $PATH" in filled


def test_an_unknown_part_is_an_error() -> None:
    with pytest.raises(site.SiteError, match="there is robot_file"):
        site.filled("<!-- generated: weather -->")
    with pytest.raises(site.SiteError, match="no section"):
        site.filled("<!-- readme: Weather -->")


def test_a_terminal_shows_what_is_typed_and_what_comes_of_it(tmp_path: Path) -> None:
    terminal = Terminal(tmp_path, environment(tmp_path))
    assert terminal.command("echo $((20 + 3))") == "echo $((20 + 3))\n23\n$ "
    terminal.type("read answer && echo got $answer")
    terminal.until(r"\n$")
    assert terminal.command("words") == "words\ngot words\n$ "
    terminal.close()
    assert terminal.shown.startswith("$ echo")


def test_a_block_knows_whether_it_runs() -> None:
    assert Block("sh", "", 1, {}).runs
    assert not Block("sh", "", 1, {"covered": "x"}).runs
    assert not Block("toml", "", 1, {}).runs
