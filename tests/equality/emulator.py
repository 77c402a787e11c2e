"""An arm64 Python in user emulation: Debian's own packages, unpacked into a cache and not installed.

How this works
--------------
`qemu-aarch64-static` runs arm64 programs on this kernel. Their packages come from the package sources of this machine,
by an apt that looks at a state of its own, so the machine's list of installed packages and architectures stays as it
is. Python's libraries are wheels for arm64, in the versions of deploy/constraints.txt.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.vm import packages

CHECKOUT = Path(__file__).parents[2]
CONSTRAINTS = CHECKOUT / "deploy" / "constraints.txt"
TOOLS = {"qemu-aarch64-static": "qemu-user-static", "apt-get": "apt", "dpkg-deb": "dpkg"}
DEBIAN = ("python3-minimal", "libpython3-stdlib")
WHEELS = ("msgspec", "pydantic")
PLATFORMS = ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")
LIBRARIES = "usr/lib/aarch64-linux-gnu:lib/aarch64-linux-gnu"
LIMIT_S = 600.0


class EmulatorError(Exception):
    """There is no emulated Python, and why."""


class Python(NamedTuple):
    """The unpacked files of another processor's Python, and the packages it can import."""

    root: Path
    site: Path

    def command(self, arguments: Sequence[str]) -> list[str]:
        """How to run it, from the checkout."""
        libraries = ":".join(str(self.root / part) for part in LIBRARIES.split(":"))
        return [
            *("qemu-aarch64-static", "-L", str(self.root)),
            *("-E", f"LD_LIBRARY_PATH={libraries}", "-E", f"PYTHONPATH={self.site}:{CHECKOUT}"),
            *(str(interpreter(self.root)), *arguments),
        ]


def interpreter(root: Path) -> Path:
    """The python3.x of these packages."""
    found = sorted((root / "usr" / "bin").glob("python3.[0-9]*"))
    if not found:
        raise EmulatorError(f"no Python among the packages unpacked in {root}")
    return found[0]


def python() -> Python:
    """From the cache, or made now. Raises EmulatorError."""
    missing = packages.missing(TOOLS)
    if missing and os.geteuid() == 0:
        sys.stdout.write(f"installing {' '.join(missing)}\n")
        packages.install(missing)
    missing = packages.missing(TOOLS)
    if missing:
        raise EmulatorError(f"cannot run, as root: apt-get install {' '.join(missing)}")
    place = _cache()
    if not place.is_dir():
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, prefix="making-") as directory:
            made = Path(directory) / "made"
            _make(made)
            _keep(made, place)
    return Python(place / "root", place / "site")


def _cache() -> Path:
    """Another release of the system, other versions or another recipe make another one."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    release = Path("/etc/os-release")
    digest = hashlib.sha256()
    for part in (release, CONSTRAINTS, Path(__file__)):
        digest.update(part.read_bytes() if part.is_file() else b"")
    return base / "drivegate" / f"arm64-{digest.hexdigest()[:16]}"


def _keep(made: Path, place: Path) -> None:
    try:
        made.rename(place)
    except OSError:
        if not place.is_dir():  # else somebody else was faster
            raise


def _make(place: Path) -> None:
    root, site, apt = place / "root", place / "site", place / "apt"
    for folder in (root, site, *(apt / name / "partial" for name in ("lists", "archives"))):
        folder.mkdir(parents=True)
    (apt / "status").touch()
    _apt(apt, "update")
    _apt(apt, "--download-only", "install", *DEBIAN)
    for package in sorted((apt / "archives").glob("*.deb")):
        _run(["dpkg-deb", "-x", str(package), str(root)])
    shutil.rmtree(apt)
    if not (root / "lib").exists():  # packages of newer releases have everything in usr
        (root / "lib").symlink_to("usr/lib")
    version = interpreter(root).name.removeprefix("python")
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    _run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
            *("--target", str(site), "--only-binary=:all:", "--implementation", "cp", "--python-version", version),
            *(*platforms, "-c", str(CONSTRAINTS), *WHEELS),
        ]
    )


def _apt(state: Path, *arguments: str) -> None:
    """apt-get for arm64 on a system on which nothing is installed."""
    options = {
        "APT::Architecture": "arm64",
        "APT::Architectures::": "arm64",
        "APT::Install-Recommends": "false",
        "APT::Sandbox::User": "",  # the user it would fetch as cannot write here
        "Debug::NoLocking": "true",
        "Dir::State": str(state),
        "Dir::State::lists": str(state / "lists"),
        "Dir::State::status": str(state / "status"),
        "Dir::Cache": str(state),
        "Dir::Cache::archives": str(state / "archives"),
    }
    words = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    _run(["apt-get", "-qq", "-y", *words, *arguments], DEBIAN_FRONTEND="noninteractive")


def _run(command: Sequence[str], **environment: str) -> None:
    try:
        done = run(command, os.environ | environment)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise EmulatorError(str(error)) from None
    if done.returncode != 0:
        raise EmulatorError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-500:]}")


def run(command: Sequence[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """To its end, from the checkout, with what it said."""
    return subprocess.run(
        command,
        cwd=CHECKOUT,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
