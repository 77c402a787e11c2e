"""Hosts whose extended registers are larger than User-Mode Linux knows: the decision, the preload, the words."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vm import launcher, packages, xstate
from tests.vm.xstate import PTRACE_ATTACH, PTRACE_GETREGSET

AMX = 11008  # bytes, measured on a CPU with AMX

# Writes the first 576 bytes (x87, SSE and the header) of a child's area and reads them back, as User-Mode Linux does
# with its 2696. Every CPU of today has more than 576, so every CPU shows here what AMX does to User-Mode Linux.
TRACER = f"""
import ctypes, os, signal
ptrace = ctypes.CDLL(None).ptrace
ptrace.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
ptrace.restype = ctypes.c_long
word = ctypes.c_uint64(0x1234567890)
child = os.fork()
if child == 0:
    signal.pause()
try:
    ptrace({PTRACE_ATTACH}, child, None, None)
    os.waitpid(child, 0)
    area = ctypes.create_string_buffer(576)
    part = (ctypes.c_size_t * 2)(ctypes.addressof(area), 576)
    def call(request):
        return ptrace(request, child, 0x202, ctypes.byref(part))
    assert call({PTRACE_GETREGSET}) == 0 and part[1] == 576
    xmm0 = bytes(range(1, 17))
    area[160:176] = xmm0
    area[512:514] = b"\\xff\\xff"  # the header claims components that are not in the part
    written = call(0x4205)
    area[160:176] = bytes(16)
    assert call({PTRACE_GETREGSET}) == 0
    assert ptrace(2, child, ctypes.addressof(word), None) == word.value  # every other request is as it was
    print(written, area[160:176] == xmm0)
finally:
    os.kill(child, signal.SIGKILL)
"""

x86 = pytest.mark.skipif(platform.machine() != "x86_64", reason="User-Mode Linux is for x86")


@pytest.mark.parametrize(
    ("area", "needed"),
    [(2432, False), (xstate.UML_AREA, False), (xstate.UML_AREA + 8, True), (AMX, True), (None, True)],
)
def test_preload_where_the_area_is_larger_or_unknown(area: int | None, needed: bool) -> None:
    assert xstate.preload_needed(area) is needed


@x86
def test_area_of_this_host_is_measured() -> None:
    area = xstate.host_area()

    assert area is not None
    assert area >= 576


def test_compiler_is_needed_only_for_the_preload(monkeypatch: pytest.MonkeyPatch) -> None:
    for needed in (False, True):
        monkeypatch.setattr(launcher, "_preload_needed", lambda needed=needed: needed)

        assert ({"gcc", "libc6-dev"} <= set(launcher.tools("systemd").values())) is needed


@x86
@pytest.mark.skipif(bool(packages.missing(packages.COMPILER_TOOLS)), reason="no C compiler, and none needed")
def test_preload_writes_a_part_of_the_area(tmp_path: Path) -> None:
    library = xstate.build_preload(tmp_path)

    assert _trace({}) == "-1 False"
    assert _trace({"LD_PRELOAD": str(library)}) == "0 True"


def test_preload_that_cannot_be_built_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "broken.c"
    source.write_text("int main( {", encoding="utf-8")
    monkeypatch.setattr(xstate, "SOURCE", source)

    with pytest.raises(OSError, match=r"broken\.c|'cc'"):
        xstate.build_preload(tmp_path)


@pytest.mark.parametrize(
    ("console", "words"),
    [("", "it says nothing"), ("a\nb", "b"), ("a\nKernel panic - b\nTrace\n [<1>] c", "Kernel panic - b")],
)
def test_last_words_of_a_kernel(console: str, words: str) -> None:
    assert launcher._last_words(console) == words


def _trace(environment: dict[str, str]) -> str:
    command = [sys.executable, "-c", TRACER]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()
