"""evdev and uinput for User-Mode Linux, whose Debian kernel has the input subsystem but neither of the two.

Both are compiled from Debian's kernel source with the configuration of that very kernel, which lies beside its modules.
"""

import shutil
import subprocess
import zlib
from collections.abc import Sequence
from pathlib import Path

from tests.vm import packages

UML_MODULES = Path("/usr/lib/uml/modules")
NEEDED = (  # of the source: what the build system itself wants, and the two drivers
    *("Makefile", "Kbuild", "Kconfig", "arch/um", "arch/x86", "certs", "include", "init", "scripts", "security"),
    *("kernel/bounds.c", "kernel/time/timeconst.bc", "lib/vdso", "drivers/input"),
)
KBUILD = "obj-m := evdev.o misc/uinput.o\n"
BUILT = ("evdev.ko", "misc/uinput.ko")
BEFORE_CONFIG = b"IKCFG_ST"  # kernel/configs.c: a gzip stream follows
GZIP = 31  # window bits of zlib for a gzip stream


class BuildError(Exception):
    """The modules could not be built; the text says why."""


def build(target: Path) -> None:
    """Both modules into this folder; in between it needs 150 MB there. Raises BuildError."""
    work = target / "modules"
    try:
        release = next(UML_MODULES.iterdir()).name
        source = _source(work)
        (source / ".config").write_bytes(_config(UML_MODULES / release))
        # The version is that of the kernel, which refuses modules of another one; within a series they fit.
        make = ["make", "-C", str(source), "ARCH=um", f"SUBLEVEL={release.rsplit('.', 1)[1]}"]
        drivers = work / "input"
        shutil.copytree(source / "drivers" / "input", drivers)
        (drivers / "Kbuild").write_text(KBUILD, encoding="ascii")
        for goal in (["olddefconfig"], ["modules_prepare"], [f"M={drivers}", "KBUILD_MODPOST_WARN=1", "modules"]):
            _run([*make, *goal])
        for module in BUILT:
            shutil.copy(drivers / module, target)
    except (OSError, StopIteration, ValueError) as error:
        raise BuildError(f"the modules for input devices cannot be built: {error!r}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _source(work: Path) -> Path:
    top = Path(packages.KERNEL_SOURCE).name.removesuffix(".tar.xz")
    work.mkdir()
    # Kconfig files are wanted of every folder.
    wanted = [f"{top}/{path}" for path in NEEDED] + [f"{top}/*/Kconfig*"]
    _run(["tar", "-x", "-C", str(work), "-f", packages.KERNEL_SOURCE, "--wildcards", *wanted])
    return work / top


def _config(modules: Path) -> bytes:
    found = (modules / "kernel" / "kernel" / "configs.ko").read_bytes()
    return zlib.decompressobj(GZIP).decompress(found[found.index(BEFORE_CONFIG) + len(BEFORE_CONFIG) :])


def _run(command: Sequence[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode != 0:
        raise BuildError(f"{command[0]} ended with {done.returncode}: {done.stderr.strip()[-500:]}")
