"""Commits of DriveGate's own history: taken out of the repository, run on a session, and asked for its verdict.

How this works
--------------
The repository is only read: `git archive` unpacks a commit into a temporary folder, where its own `replay verify` runs
with this Python. Packages that the commit needs and this Python has not, or not in that version, go into a virtual
environment that sees all others of this Python; commits with the same needs share it.
"""

import hashlib
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from replay.history.bisect import Answer, Asked, BisectError

GIT_TIMEOUT_S = 120.0
PIP_TIMEOUT_S = 1800.0
PART = "robot"  # has what `replay verify` needs
NEEDED = ("gateway", "replay", "pyproject.toml")
_ANSWERS = {0: Answer.GOOD, 3: Answer.GOOD, 1: Answer.BAD}  # exit codes of `drivegate replay verify`
# The first Pythons 3.11 know no filters; what git packs is none of a stranger's.
_SAFELY: dict[str, Any] = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
_WORDS = 300  # characters of what a failing command says


class Commit(NamedTuple):
    """For people: what a commit is called, whose it is, and when it was made."""

    name: str
    subject: str
    author: str
    date: str  # ISO 8601


class Repository:
    """A checkout of DriveGate, or a bare repository; nothing is ever written to it. Raises BisectError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._git("rev-parse", "--git-dir")

    def commit(self, revision: str) -> str:
        """Full name of the commit that a branch, tag or shortened name leads to."""
        return self._git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}").strip()

    def is_ancestor(self, old: str, new: str) -> bool:
        """Whether one commit is among those that led to another."""
        done = self._run("merge-base", "--is-ancestor", old, new)
        return done.returncode == 0

    def halve(self, bad: str, goods: Sequence[str]) -> list[str]:
        """The commits that led to the bad one and to no good one, the one nearest to the middle first."""
        listed = self._git("rev-list", "--bisect-all", bad, *[f"^{good}" for good in goods])
        return [line.split()[0] for line in listed.splitlines()]

    def told(self, commit: str) -> Commit:
        """What a person wants to know of it."""
        return Commit(commit, *self._git("show", "-s", "--format=%s%n%an%n%cI", commit).splitlines())

    def unpack(self, commit: str, folder: Path) -> None:
        """All its files into an empty folder."""
        done = self._run("archive", "--format=tar", commit)
        if done.returncode:
            raise BisectError(f"{self._path}: {_said(done.stderr)}")
        with tarfile.open(fileobj=BytesIO(done.stdout)) as archive:
            archive.extractall(folder, **_SAFELY)

    def _git(self, *arguments: str) -> str:
        done = self._run(*arguments)
        if done.returncode:
            said = _said(done.stderr) or f"there is no {arguments[-1].removesuffix('^{commit}')!r}"
            raise BisectError(f"{self._path}: {said}")
        return done.stdout.decode(errors="replace")

    def _run(self, *arguments: str) -> subprocess.CompletedProcess[bytes]:
        command = ["git", "-C", str(self._path), *arguments]
        try:
            return subprocess.run(command, capture_output=True, timeout=GIT_TIMEOUT_S, check=False)
        except FileNotFoundError:
            raise BisectError("git is not installed") from None
        except subprocess.TimeoutExpired:
            raise BisectError(f"{self._path}: git {arguments[0]} took more than {GIT_TIMEOUT_S:g} s") from None


class Revisions:
    """Asks commits for their verdict on a session. `folder`: an empty one, which the caller removes.

    `doing`: told in words what takes time.
    """

    def __init__(
        self, repository: Repository, session: Path, folder: Path, doing: Callable[[str], None] = lambda _: None
    ) -> None:
        self._repository = repository
        self._session = session.absolute()
        self._folder = folder
        self._doing = doing
        self._environments: dict[str, str] = {}  # paths of interpreters, by what was missing

    def ask(self, commit: str) -> Asked:
        """Its own software's verdict; whatever keeps it from giving one means that it is skipped."""
        tree = self._folder / commit
        tree.mkdir()
        self._repository.unpack(commit, tree)
        for name in NEEDED:
            if not (tree / name).exists():
                return Asked(commit, Answer.SKIPPED, f"it has no {name}: not the source of DriveGate")
        try:
            python = self._python(tree)
        except _UnusableError as error:
            return Asked(commit, Answer.SKIPPED, str(error))
        self._doing(f"verifying by {commit[:12]}")
        return self._verdict(commit, python, tree)

    def _verdict(self, commit: str, python: str, tree: Path) -> Asked:
        command = [python, "-P", "-m", "gateway", "replay", "verify", str(self._session), "--json"]
        environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, check=False)
        verdict = _last_json(done.stdout)
        answer = _ANSWERS.get(done.returncode)
        if verdict is None or answer is None:  # a program that crashes ends with 1 as well, but tells no verdict
            return Asked(commit, Answer.SKIPPED, _reason(verdict) or _said(done.stderr) or f"exit {done.returncode}")
        if answer is Answer.GOOD and not verdict.get("cycles"):
            return Asked(commit, Answer.SKIPPED, _reason(verdict) or "nothing could be compared")
        return Asked(commit, answer, _difference(verdict) if answer is Answer.BAD else "")

    def _python(self, tree: Path) -> str:
        """The interpreter for a commit: this one, or that of an environment with what it misses."""
        wanted = _requirements(tree)
        missing = [one for one in wanted if not _is_met(one)]
        if not missing:
            return sys.executable
        constraints = tree / "deploy" / "constraints.txt"
        pins = constraints.read_bytes() if constraints.exists() else b""
        key = hashlib.sha256("\n".join(missing).encode() + pins).hexdigest()[:16]
        if key not in self._environments:
            self._doing(f"installing {', '.join(missing)}")
            options = ["-c", str(constraints)] if pins else []
            self._environments[key] = _environment(self._folder / f"venv-{key}", missing, options)
        return self._environments[key]


class _UnusableError(Exception):
    """A commit that cannot be run here; the text says why."""


def _requirements(tree: Path) -> list[str]:
    try:
        project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        return [str(one) for one in (*project["dependencies"], *_extra(project, PART))]
    except (ValueError, KeyError) as error:
        raise _UnusableError(f"its pyproject.toml cannot be read: {error}") from None


def _extra(project: dict[str, Any], name: str) -> list[str]:
    """What a part of DriveGate needs; nothing in a commit that has no parts."""
    found: list[str] = project.get("optional-dependencies", {}).get(name, [])
    return found


def _is_met(requirement: str) -> bool:
    """Whether this Python has it."""
    from importlib import metadata  # noqa: PLC0415

    from packaging.requirements import InvalidRequirement, Requirement  # noqa: PLC0415

    try:
        wanted = Requirement(requirement)
    except InvalidRequirement as error:
        raise _UnusableError(f"its pyproject.toml wants {requirement!r}: {error}") from None
    if wanted.marker is not None and not wanted.marker.evaluate():
        return True
    try:
        return wanted.specifier.contains(metadata.version(wanted.name), prereleases=True)
    except metadata.PackageNotFoundError:
        return False


def _environment(folder: Path, missing: Sequence[str], options: Sequence[str]) -> str:
    """A virtual environment with these packages in front of those of this Python; its interpreter."""
    venv.create(folder, with_pip=True, symlinks=True)
    python = folder / "bin" / "python"
    theirs = sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)})
    Path(theirs, "all-others.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    command = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *options, *missing]
    done = subprocess.run(command, capture_output=True, timeout=PIP_TIMEOUT_S, check=False)
    if done.returncode:
        raise _UnusableError(f"{', '.join(missing)} cannot be installed: {_said(done.stderr)}")
    return str(python)


def _last_json(told: bytes) -> dict[str, object] | None:
    lines = told.decode(errors="replace").splitlines()
    try:
        document = json.loads(lines[-1]) if lines else None
    except ValueError:
        return None
    return document if isinstance(document, dict) else None


def _reason(verdict: dict[str, object] | None) -> str:
    return "" if verdict is None else str(verdict.get("problem") or "")


def _difference(verdict: dict[str, object]) -> str:
    """In words, whatever that version of the software tells of it."""
    first = verdict.get("first_difference")
    if not isinstance(first, dict):
        return "it does not say where"
    motor = f" of motor {first['motor']}" if first.get("motor") else ""
    values = f"recorded {first.get('recorded')}, replayed {first.get('replayed')}"
    return f"cycle {first.get('cycle')}, {first.get('field')}{motor}: {values}"


def _said(told: bytes) -> str:
    """The last line of what a command complains of."""
    lines = [line for line in told.decode(errors="replace").splitlines() if line.strip()]
    return lines[-1][:_WORDS] if lines else ""
