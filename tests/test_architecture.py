"""The directions of import, read from the syntax tree: replay -> gateway -> drivers -> standard library."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("drivers", "gateway", "replay")
EDGES = {
    "gateway/edges/can_adapter.py",
    "gateway/edges/can_bus.py",
    "gateway/can_thread.py",
    "gateway/client.py",
    "gateway/edges/estop_latch.py",
    "gateway/edges/claims.py",
    "gateway/edges/log_queue.py",
    "gateway/recording/recorder.py",
    "gateway/recording/process.py",
    "gateway/service.py",
    "gateway/edges/realtime.py",
    "gateway/edges/signals.py",
    "gateway/edges/systemd.py",
    "gateway/edges/zenoh_link.py",
    "gateway/edges/zenoh_questions.py",
    "gateway/edges/zenoh_session.py",
    "replay/drive/player.py",
    "replay/drive/redrive.py",
    "replay/sim/network_device.py",
    "replay/sim/server.py",
    "replay/compare/verify.py",
}
EDGE_FOLDERS = ("gateway/cli/",)
IMPURE = {"can", "multiprocessing", "os", "rerun", "signal", "socket", "subprocess", "threading", "time", "zenoh"}
RERUN_ROOMS = (
    "gateway/recorder_",
    "gateway/recording/blueprint.py",
    "replay/sessions/reader.py",
    "replay/sessions/framing.py",
)


def sources() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def is_edge(path: Path) -> bool:
    return name(path) in EDGES or name(path).startswith(EDGE_FOLDERS)


@pytest.mark.parametrize("path", sources(), ids=name)
def test_directions(path: Path) -> None:
    tops = {module.split(".")[0] for module in imports(path)}
    room = name(path).split("/")[0]
    if room == "drivers":
        foreign = tops - set(sys.stdlib_module_names) - {"drivers"}
        assert not foreign, f"drivers use the standard library only, not {foreign}"
    if room == "gateway" and not name(path).startswith("gateway/cli/"):
        assert "replay" not in tops, "only the command line, the composition root, may import replay"
    assert "tests" not in tops


@pytest.mark.parametrize("path", sources(), ids=name)
def test_core_is_pure(path: Path) -> None:
    tops = {module.split(".")[0] for module in imports(path)}
    rerun_room = name(path).startswith(RERUN_ROOMS)
    if not is_edge(path) and not rerun_room:
        assert not tops & IMPURE, f"{name(path)} is no edge but imports {tops & IMPURE}"
    if not rerun_room and not name(path).startswith("gateway/cli/"):
        assert not tops & {"rerun", "pyarrow"}
    if "pydantic" in tops:
        assert name(path) in {"gateway/config.py", "gateway/edges/messages.py", "replay/drive/scenario_file.py"}


@pytest.mark.parametrize("path", sources(), ids=name)
def test_no_hidden_switches(path: Path) -> None:
    """No flag of the core may ask whether it is replayed or simulated."""
    if is_edge(path) or name(path).startswith("replay/"):
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.If):
            words = {part.id for part in ast.walk(node.test) if isinstance(part, ast.Name)}
            assert not words & {"replay", "replaying", "simulated", "simulate", "sim"}, f"{name(path)}:{node.lineno}"


def test_every_package_has_sources() -> None:
    assert {name(path).split("/")[0] for path in sources()} == set(PACKAGES)
