"""The commit at which a recorded drive would first have gone differently: in histories made here."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay.history.bisect import Answer, Asked, BisectError, bisect
from replay.history.revisions import Repository, Revisions, _requirements
from tests.corpus import FOLDER

ROOT = Path(__file__).parents[2]
SESSION = FOLDER / "omni4"
WHO = {
    **{f"GIT_{role}_NAME": "Ada" for role in ("AUTHOR", "COMMITTER")},
    **{f"GIT_{role}_EMAIL": "ada@example.org" for role in ("AUTHOR", "COMMITTER")},
    "GIT_CONFIG_GLOBAL": os.devnull,
    "GIT_CONFIG_NOSYSTEM": "1",
}


def git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, env=os.environ | WHO, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """Copies of this source, with one thing changed in each commit."""
    folder = tmp_path_factory.mktemp("history")
    git(folder, "init", "--quiet")
    for name in ("gateway", "drivers", "replay", "deploy"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so", "images"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    limits = folder / "gateway" / "control" / "limits.py"
    changes: dict[str, tuple[Path, str, str]] = {
        "say more": (limits, '"""', '"""In other words: '),
        "break": (folder / "gateway" / "cli" / "__init__.py", '"""', "no Python at all\n'''"),
        "mend": (folder / "gateway" / "cli" / "__init__.py", "no Python at all\n'''", '"""'),
        "dream of a package": (folder / "pyproject.toml", '  "numpy', '  "no-such-package-of-ours>=7",\n  "numpy'),
        "wake up": (folder / "pyproject.toml", '  "no-such-package-of-ours>=7",\n', ""),
        "limit otherwise": (limits, "before = self.rates", "before, dt = self.rates, 0.9 * dt"),
        "say yet more": (limits, "In other words", "In still other words"),
    }
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "begin")
    named = {"begin": git(folder, "rev-parse", "HEAD")}
    for subject, (path, old, new) in changes.items():
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        git(folder, "commit", "--quiet", "--all", "--message", subject)
        named[subject] = git(folder, "rev-parse", "HEAD")
    return folder, named


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    line = [sys.executable, "-m", "gateway", "replay", "bisect", str(SESSION), "--repository", str(folder), *arguments]
    return subprocess.run(line, env=environment, capture_output=True, text=True, check=False)


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.pure_python
def test_the_commit_that_drives_otherwise_is_found_and_nothing_is_touched(
    history: tuple[Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder, named = history
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    before = everything(folder)
    done = command(folder, "--good", named["begin"][:10], "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    (first,) = told["first"]
    assert (first["name"], first["subject"]) == (named["limit otherwise"], "limit otherwise")
    assert first["author"] == "Ada"
    assert first["why"].startswith("cycle ")
    assert "recorded" in first["why"]
    answers = {one["commit"]: one["answer"] for one in told["asked"]}
    assert len(answers) == len(told["asked"])
    assert answers[named["begin"]] == "the same"
    assert answers[named["limit otherwise"]] == answers[named["say yet more"]] == "differently"
    assert everything(folder) == before
    assert not list(tmp_path.glob("drivegate-*"))


@pytest.mark.pure_python
@pytest.mark.parametrize(
    ("good", "bad", "words"),
    [
        ("limit otherwise", "say yet more", "--good must be a commit whose software would drive the same, and {good}"),
        ("begin", "wake up", "--bad must be a commit whose software would drive differently, and {bad}"),
        ("break", "say yet more", "{good} gives no verdict on the session"),
        ("begin", "dream of a package", "no-such-package-of-ours>=7 cannot be installed"),
        ("say yet more", "begin", "--good {good} must be a commit that led to --bad {bad}, and it is not"),
        ("begin", "begin", "--good {good} must be a commit that led to --bad {bad}, and it is not"),
    ],
)
def test_ends_that_are_not_what_they_are_said_to_be(
    history: tuple[Path, dict[str, str]], good: str, bad: str, words: str
) -> None:
    folder, named = history
    done = command(folder, "--good", named[good], "--bad", named[bad])
    assert done.returncode == 2
    assert words.format(good=named[good][:12], bad=named[bad][:12]) in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--good", "no-such-tag"), "there is no 'no-such-tag'"),
        (("--good", "--output=x"), "there is no '--output=x'"),
        (("--good", "HEAD", "--repository", "{empty}"), "not a git repository"),
    ],
)
def test_what_cannot_be_looked_for_is_told(
    history: tuple[Path, dict[str, str]], tmp_path: Path, arguments: Sequence[str], words: str
) -> None:
    done = command(history[0], *[one.format(empty=tmp_path) for one in arguments])
    assert done.returncode == 2
    assert words in done.stderr


@pytest.mark.pure_python
def test_a_package_in_the_version_a_commit_needs_is_installed_beside_all_others(
    history: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    """A wheel made here, so that no index is asked."""
    folder = tmp_path / "copy"
    git(tmp_path, "clone", "--quiet", str(history[0]), str(folder))
    git(folder, "checkout", "--quiet", history[1]["begin"])
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "extra_of_ours.py").write_text("ANSWER = 7\n")
    (tmp_path / "ours" / "pyproject.toml").write_text(
        '[build-system]\nrequires = []\nbuild-backend = "made"\nbackend-path = ["."]\n'
        '[project]\nname = "extra-of-ours"\nversion = "7.1"\n'
    )
    (tmp_path / "ours" / "made.py").write_text(BACKEND)
    project = folder / "pyproject.toml"
    needed = f'  "extra-of-ours @ file://{tmp_path}/ours",\n  "numpy'
    project.write_text(project.read_text().replace('  "numpy', needed, 1))
    main = folder / "gateway" / "cli" / "__init__.py"
    main.write_text(main.read_text().replace('"""', '"""Needs more.\n\n', 1) + "\nimport extra_of_ours  # noqa\n")
    git(folder, "commit", "--quiet", "--all", "--message", "need more")
    work = tmp_path / "work"
    work.mkdir()
    revisions = Revisions(Repository(folder), SESSION, work)
    assert revisions.ask(git(folder, "rev-parse", "HEAD")).answer is Answer.GOOD


BACKEND = """
import zipfile, pathlib
def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    name = "extra_of_ours-7.1-py3-none-any.whl"
    info = "extra_of_ours-7.1.dist-info"
    with zipfile.ZipFile(pathlib.Path(wheel_directory, name), "w") as file:
        file.write("extra_of_ours.py")
        file.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\\nName: extra-of-ours\\nVersion: 7.1\\n")
        file.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any")
        file.writestr(f"{info}/RECORD", "")
    return name
"""


def test_a_commit_needs_what_its_robots_need_and_nothing_of_the_desk(tmp_path: Path) -> None:
    project = tmp_path / "pyproject.toml"
    project.write_text('[project]\ndependencies = ["a"]\n', encoding="utf-8")
    assert _requirements(tmp_path) == ["a"]
    project.write_text(
        '[project]\ndependencies = ["a"]\n[project.optional-dependencies]\nrobot = ["b>=2"]\ndesk = ["c"]\n',
        encoding="utf-8",
    )
    assert _requirements(tmp_path) == ["a", "b>=2"]


@settings(max_examples=12, deadline=None)
@given(st.data())
def test_in_any_history_with_merges_the_culprit_is_found(data: st.DataObject) -> None:
    """Bad is what came from the culprit; the order of asking is git's, so its own graph is the oracle."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        git(folder, "init", "--quiet")
        tree = git(folder, "hash-object", "-t", "tree", "-w", os.devnull)
        commits, parents = list[str](), list[set[int]]()
        for place in range(data.draw(st.integers(2, 14))):
            before = set(data.draw(st.lists(st.integers(0, place - 1), min_size=1, max_size=2))) if place else set()
            options = [word for one in sorted(before) for word in ("-p", commits[one])]
            commits.append(git(folder, "commit-tree", tree, "-m", str(place), *options))
            parents.append(before)
        above = _ancestors(parents)
        bad = len(commits) - 1
        culprit = data.draw(st.sampled_from(sorted(above[bad] - {0}) or [bad]))
        skipped = data.draw(st.sets(st.sampled_from(range(bad + 1))), label="skipped") - {0, bad}

        def ask(commit: str) -> Asked:
            place = commits.index(commit)
            if place in skipped:
                return Asked(commit, Answer.SKIPPED)
            return Asked(commit, Answer.BAD if culprit in above[place] else Answer.GOOD)

        found = bisect(commits[0], commits[bad], halve=Repository(folder).halve, ask=ask)
        first = {commits.index(one) for one in found.first}
        assert culprit in first
        assert len(found.asked) == len({one.commit for one in found.asked})
        if not skipped:
            assert first == {culprit}
            assert len(found.asked) <= 2 + len(commits).bit_length() + 1
        (certain,) = first - skipped
        assert culprit in above[certain]


def _ancestors(parents: Sequence[set[int]]) -> list[set[int]]:
    """Of each commit, with itself."""
    above = list[set[int]]()
    for place, before in enumerate(parents):
        above.append({place}.union(*(above[one] for one in before)))
    return above


def test_a_broken_commit_next_to_the_culprit_leaves_two() -> None:
    answers = {"a": Answer.GOOD, "b": Answer.SKIPPED, "c": Answer.BAD, "d": Answer.BAD}

    def halve(bad: str, goods: Sequence[str]) -> list[str]:
        return [one for one in "abcd" if max(goods) < one <= bad]

    found = bisect("a", "d", halve=halve, ask=lambda commit: Asked(commit, answers[commit], f"why {commit}"))
    assert found.first == ("b", "c")
    assert found.why("c") == "why c"
    with pytest.raises(BisectError, match=r"--bad .* would drive the same: why a"):
        bisect("a", "a", halve=halve, ask=lambda commit: Asked(commit, Answer.GOOD, f"why {commit}"))
