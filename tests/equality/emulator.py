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

from tests.compiled import CHECKOUT, unpacked_wheel
from tests.vm import packages

CONSTRAINTS = CHECKOUT / "deploy" / "constraints.txt"
COMPILER = "aarch64-linux-gnu-gcc"
COMPILER_TOOLS = {
    COMPILER: "gcc-aarch64-linux-gnu",
    "/usr/aarch64-linux-gnu/include/stdio.h": "libc6-dev-arm64-cross",
}
TOOLS = {"qemu-aarch64-static": "qemu-user-static", "apt-get": "apt", "dpkg-deb": "dpkg"}
DEBIAN = ("python3-minimal", "libpython3-stdlib", "libstdc++6")
WHEELS = ("msgspec", "numpy", "pyarrow", "pydantic")
PLATFORMS = ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64")
LIBRARIES = "usr/lib/aarch64-linux-gnu:lib/aarch64-linux-gnu"
LIMIT_S = 600.0


class EmulatorError(Exception):
    """There is no emulated Python, and why."""


class Python(NamedTuple):
    """The unpacked files of another processor's Python, and the packages it can import."""

    root: Path
    site: Path

    def command(self, folder: Path) -> list[str]:
        """How to run it with the packages of this folder."""
        libraries = ":".join(str(self.root / part) for part in LIBRARIES.split(":"))
        return [
            *("qemu-aarch64-static", "-L", str(self.root)),
            *("-E", f"LD_LIBRARY_PATH={libraries}", "-E", f"PYTHONPATH={self.site}:{folder}"),
            str(interpreter(self.root)),
        ]

    def compiled(self, directory: Path) -> Path:
        """A folder with the packages and the tests, the core compiled for it as an installation compiles it.

        Raises EmulatorError.
        """
        _have(COMPILER_TOOLS)
        name = interpreter(self.root).name
        headers = self.root / "usr" / "include"
        compiler = {
            "CC": f"{COMPILER} -I{headers / name} -I{headers}",
            "LDSHARED": f"{COMPILER} -shared",
            "SETUPTOOLS_EXT_SUFFIX": f".cpython-{name.removeprefix('python').replace('.', '')}-aarch64-linux-gnu.so",
        }
        try:
            return unpacked_wheel(directory, compiler)
        except (OSError, subprocess.CalledProcessError) as error:
            raise EmulatorError(str(error)) from None


def interpreter(root: Path) -> Path:
    """The python3.x of these packages."""
    found = sorted((root / "usr" / "bin").glob("python3.[0-9]*"))
    if not found:
        raise EmulatorError(f"no Python among the packages unpacked in {root}")
    return found[0]


def python() -> Python:
    """From the cache, or made now. Raises EmulatorError."""
    _have(TOOLS)
    place = _cache()
    if not place.is_dir():
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, prefix="making-") as directory:
            made = Path(directory) / "made"
            _make(made)
            _keep(made, place)
    return Python(place / "root", place / "site")


def _have(tools: Mapping[str, str]) -> None:
    if lacking := packages.lacking(tools):
        raise EmulatorError(lacking)


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
    _unpack(apt / "archives", root)
    name = interpreter(root).name
    (apt / "headers").mkdir()
    _apt(apt, "download", f"lib{name}-dev", folder=apt / "headers")  # without the packages that it needs elsewhere
    _unpack(apt / "headers", root)
    shutil.rmtree(apt)
    if not (root / "lib").exists():  # packages of newer releases have everything in usr
        (root / "lib").symlink_to("usr/lib")
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    _run(
        [
            *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
            *(
                "--target",
                str(site),
                "--only-binary=:all:",
                "--implementation",
                "cp",
                "--python-version",
                name.removeprefix("python"),
            ),
            *(*platforms, "-c", str(CONSTRAINTS), *WHEELS),
        ]
    )


def _unpack(packed: Path, root: Path) -> None:
    for package in sorted(packed.glob("*.deb")):
        _run(["dpkg-deb", "-x", str(package), str(root)])


def _apt(state: Path, *arguments: str, folder: Path = CHECKOUT) -> None:
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
    _run(["apt-get", "-qq", "-y", *words, *arguments], folder=folder)


def _run(command: Sequence[str], *, folder: Path = CHECKOUT) -> None:
    try:
        done = run(command, {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}, folder)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise EmulatorError(str(error)) from None
    if done.returncode != 0:
        raise EmulatorError(f"{command[0]} failed: {(done.stderr or done.stdout).strip()[-500:]}")


def run(
    command: Sequence[str], environment: Mapping[str, str], folder: Path = CHECKOUT
) -> subprocess.CompletedProcess[str]:
    """To its end, in this folder, with what it said."""
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
