"""Runs the tests once more with the compiled core: `python -m tests.compiled [pytest arguments]`.

The wheel is built as an installation builds it and unpacked beside a copy of the tests, so that nothing of the checkout
is imported. Fails where nothing was compiled. Then both forms drive the bundled scenarios, and every trace is compared
byte for byte.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.vm import packages

CHECKOUT = Path(__file__).parent.parent
COPIED = ("tests", "deploy", ".ci", "README.md", "LICENSE", "pyproject.toml")
TOOLS = packages.COMPILER_TOOLS | {f"{sysconfig.get_path('include')}/Python.h": "python3-dev"}
NEEDED = "from gateway.build import COMPILED, ROOT; import sys; sys.exit(not COMPILED or str(ROOT) != sys.argv[1])"


def main(arguments: Sequence[str]) -> int:
    """0 if everything passes and both forms agree."""
    if lacking := packages.lacking(TOOLS):
        sys.stdout.write(f"{lacking}\n")
        return 1
    with tempfile.TemporaryDirectory(prefix="drivegate-compiled-") as directory:
        tree = unpacked_wheel(Path(directory))
        if python(tree, "-c", NEEDED, str(tree)).returncode:
            sys.stdout.write("the wheel holds no compiled core\n")
            return 1
        if python(tree, "-m", "pytest", "-p", "no:cacheprovider", *arguments).returncode:
            return 1
        return compare(tree, Path(directory))


def unpacked_wheel(directory: Path, environment: Mapping[str, str] | None = None) -> Path:
    """A folder with the packages of a wheel built from the checkout, and the tests. `environment`: of the compiler."""
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run(
        [*pip, "--wheel-dir", str(directory), str(CHECKOUT)], env=os.environ | dict(environment or {}), check=True
    )
    (wheel,) = directory.glob("*.whl")
    tree = directory / "tree"
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(tree)
    for name in COPIED:
        source = CHECKOUT / name
        if source.is_dir():
            shutil.copytree(source, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, tree / name)
    return tree


def python(folder: Path, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Runs this interpreter with the packages of that folder."""
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, check=False)


def compare(tree: Path, directory: Path) -> int:
    """Traces of the bundled scenarios, byte by byte; 0 if all are equal."""
    different = 0
    for scenario in sorted((CHECKOUT / "deploy" / "scenarios").glob("*.toml")):
        traces = []
        for form, folder in (("pure", CHECKOUT), ("compiled", tree)):
            trace = directory / f"{scenario.stem}-{form}.csv"
            done = python(folder, "-m", "gateway", "scenario", str(scenario), "--trace", str(trace), "--json")
            assert done.returncode == 0, scenario
            traces.append(trace.read_bytes())
        equal = traces[0] == traces[1]
        different += not equal
        sys.stdout.write(f"{'equal' if equal else 'DIFFERENT'}: {scenario.stem}, {len(traces[0])} bytes of trace\n")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
