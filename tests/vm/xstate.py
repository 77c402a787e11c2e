"""Whether the host's extended registers are larger than User-Mode Linux knows, and the preload that copes with it."""

import ctypes
import os
import subprocess
from pathlib import Path

UML_AREA = 2696  # bytes; User-Mode Linux 6.1 keeps so much of each process's extended registers
SOURCE = Path(__file__).with_name("xstate.c")

PTRACE_ATTACH = 16  # linux/ptrace.h
PTRACE_GETREGSET = 0x4204
NT_X86_XSTATE = 0x202  # linux/elf.h
LARGEST_AREA = 65536


class _Span(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


def preload_needed(area: int | None) -> bool:
    """For a host that keeps `area` bytes; unknown counts as too large, because the preload does no harm elsewhere."""
    return area is None or area > UML_AREA


def host_area() -> int | None:
    """Bytes of extended registers the host's kernel keeps for a process; None if it does not say.

    Measured the way User-Mode Linux reads them. CPU flags would only tell of AMX, not of the next extension, and not of
    a kernel that switches one off.
    """
    with subprocess.Popen(["sleep", "60"], stdin=subprocess.DEVNULL) as process:
        try:
            return _area_of(process.pid)
        finally:
            process.kill()


def _area_of(pid: int) -> int | None:
    ptrace = ctypes.CDLL(None).ptrace
    ptrace.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    ptrace.restype = ctypes.c_long
    if ptrace(PTRACE_ATTACH, pid, None, None) < 0:
        return None
    os.waitpid(pid, 0)  # until it has stopped for us
    buffer = ctypes.create_string_buffer(LARGEST_AREA)
    span = _Span(ctypes.addressof(buffer), LARGEST_AREA)
    refused = ptrace(PTRACE_GETREGSET, pid, NT_X86_XSTATE, ctypes.byref(span)) < 0
    return None if refused else span.length


def build_preload(directory: Path) -> Path:
    """The library to preload into linux.uml. Raises OSError with the compiler's words if it cannot be built."""
    library = directory / "xstate.so"
    command = ["cc", "-O2", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise OSError(f"cannot build {SOURCE.name}, without which User-Mode Linux does not run here: {done.stderr}")
    return library
