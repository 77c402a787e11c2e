"""Collects, on a computer with a network, every package that `install.sh --wheelhouse DIR` needs on one without.

It may be for another machine and another Python than this one's. What compiles the core is among them.
"""

import argparse
import platform
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterable, Iterator
from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:
    sys.exit(f"Python 3.11 or newer is needed; this is {platform.python_version()}")

HERE = Path(__file__).resolve().parent
KINDS = ("robot", "client", "desk")
# A wheel says which C library it needs at least; these are what Debian 12's (2.36) and older ones can have.
GLIBC = range(5, 37)


def main() -> int:
    """Exit code."""
    asked = _parser().parse_args()
    asked.dir.mkdir(parents=True, exist_ok=True)
    wanted = list(packages(asked.kind))
    with tempfile.TemporaryDirectory(prefix="drivegate-wheelhouse-") as directory:
        venv.create(directory, with_pip=True, symlinks=True)
        options = ["--disable-pip-version-check", "-c", str(HERE / "constraints.txt")]
        options += ["--only-binary=:all:", "--implementation=cp", f"--python-version={asked.python}"]
        options += [f"--platform={one}" for one in platforms(asked.machine)]
        pip = [f"{directory}/bin/python", "-m", "pip", "download", *options, "--dest", str(asked.dir), *wanted]
        code = subprocess.run(pip, check=False).returncode
    if code:
        sys.stderr.write(f"{asked.dir} is not complete: see above\n")
        return 1
    files = list(asked.dir.glob("*.whl"))
    size = sum(file.stat().st_size for file in files) / 1e6
    sys.stdout.write(
        f"{len(files)} packages, {size:.0f} MB, for a {asked.kind} with Python {asked.python} on {asked.machine}.\n"
        f"There, in this checkout: sudo sh deploy/install.sh --for {asked.kind} --wheelhouse {asked.dir.name}\n"
    )
    return 0


def packages(kind: str) -> Iterator[str]:
    """What an installation needs: to run, to be built, and pip itself."""
    told = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    extras = told["project"]["optional-dependencies"]
    yield from told["project"]["dependencies"]
    if kind != "client":
        yield from _extra(extras, kind)
    yield from told["build-system"]["requires"]
    yield from told["tool"]["drivegate"]["compile"]
    yield "pip"


def _extra(extras: dict[str, list[str]], name: str) -> Iterator[str]:
    for one in extras[name]:
        if one.startswith("drivegate["):
            yield from _extra(extras, one.removeprefix("drivegate[").removesuffix("]"))
        else:
            yield one


def platforms(machine: str) -> Iterable[str]:
    """Names by which pip knows this kind of computer."""
    return [f"linux_{machine}", f"manylinux2014_{machine}", *(f"manylinux_2_{one}_{machine}" for one in GLIBC)]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=Path, metavar="DIR", help="where to put them")
    parser.add_argument("--for", dest="kind", choices=KINDS, default="robot", help="see install.sh (default: robot)")
    parser.add_argument("--machine", default=platform.machine(), help="`uname -m` of the other computer: aarch64, ...")
    ours = f"{sys.version_info.major}.{sys.version_info.minor}"
    parser.add_argument("--python", default=ours, metavar="3.N", help=f"its Python (default: {ours}, as here)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
