"""Build hook of the wheel: compiles the core and the drivers with mypyc where there is a C compiler.

Where there is none, or compiling fails, the wheel is pure Python and one line says so: the same files run either way
and give the same bytes. An editable installation is never compiled, so that an edit is what runs.
"""

import os
import shutil
import sys
import sysconfig
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

COMPILED = (
    "drivers",
    "gateway/core",
    "gateway/kinematics",
    "gateway/control",
    "gateway/arithmetic.py",
)
# Neither this nor gateway/types.py: compiled, a named tuple loses the annotations by which the recorder's process reads
# it (mypyc keeps `float`, but of `float | None` and `tuple[CanFrame, ...]` nothing). It costs a tenth of the cycle.
NOT_COMPILED = {"drivers/contract.py"}
GROUP = "drivegate"  # its shared part becomes drivegate__mypyc
# Compilers for ARM fuse a * b + c into one rounding unless told not to: the last bit would differ from other machines.
FLAGS = "-ffp-contract=off -g0"


def c_compiler() -> str | None:
    """The C compiler that Python would use, if it is there."""
    command = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    return shutil.which(command)


def sources(root: Path) -> list[Path]:
    """What is compiled, relative to the root."""
    found = [path for name in COMPILED for path in sorted((root / name).rglob("*.py")) or [root / name]]
    relative = [path.relative_to(root) for path in found if path.stat().st_size]
    return [path for path in relative if path.as_posix() not in NOT_COMPILED]


def compile_into(root: Path, work: Path) -> list[Path]:
    """Compile a copy of the sources in `work`; the shared libraries, relative to it. Raises whatever goes wrong."""
    from mypyc.build import mypycify  # noqa: PLC0415 - a build dependency where there is a compiler, and only there
    from setuptools import setup  # noqa: PLC0415

    for package in ("drivers", "gateway"):
        shutil.copytree(root / package, work / package, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    (work / "mypy.ini").write_text("[mypy]\nignore_missing_imports = True\nfollow_imports = silent\n", encoding="utf-8")
    os.environ["CFLAGS"] = f"{os.environ.get('CFLAGS', '')} {FLAGS}".strip()
    before = Path.cwd()
    os.chdir(work)
    try:
        modules = mypycify(
            ["--config-file", "mypy.ini", *map(str, sources(root))], opt_level="2", debug_level="0", group_name=GROUP
        )
        setup(name=GROUP, ext_modules=modules, script_args=["--quiet", "build_ext", "--inplace"])
    finally:
        os.chdir(before)
    return [path.relative_to(work) for path in work.rglob("*.so") if "build" not in path.relative_to(work).parts]


class CoreCompiler(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the compiled modules to the wheel."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Packages that the build needs for it."""
        if c_compiler() is None:
            return []
        told = tomllib.loads((Path(self.root) / "pyproject.toml").read_text(encoding="utf-8"))
        needed: list[str] = told["tool"]["drivegate"]["compile"]
        return needed

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, unless this is an editable installation or it cannot be."""
        if version == "editable":
            return
        if c_compiler() is None:
            self.app.display_warning("no C compiler: the core stays pure Python, slower and otherwise the same")
            return
        self._work = Path(tempfile.mkdtemp(prefix="drivegate-build-"))
        try:
            built = compile_into(Path(self.root), self._work)
        except (Exception, SystemExit) as error:
            self.app.display_warning(f"compiling failed, the core stays pure Python: {error}")
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"] |= {str(self._work / path): str(path) for path in built}
        self.app.display_info(f"compiled {len(built)} modules with {sys.implementation.cache_tag}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was needed for building."""
        if hasattr(self, "_work"):
            shutil.rmtree(self._work, ignore_errors=True)
