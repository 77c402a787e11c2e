"""Pytest: tests marked for a lane of `python -m tests.vm` run only in that lane, elsewhere they are deselected."""

from pathlib import Path

import pytest

LANES = ("vcan", "systemd", "input")


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--lane` is given by the launcher, where the kernel of that lane is running."""
    parser.addoption("--lane", choices=LANES, help="run only the tests with this marker (used by tests.vm)")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """In a lane, a test file that does not say `mark.<lane>` is not even imported: imports are slow in there."""
    lane = config.getoption("--lane")
    if lane is None or not collection_path.match("test_*.py"):
        return None
    return f"mark.{lane}" not in collection_path.read_text(encoding="utf-8") or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect what this kernel cannot run."""
    lane = config.getoption("--lane")
    kept = [item for item in items if _runs_here(item, lane)]
    dropped = [item for item in items if not _runs_here(item, lane)]
    if dropped:
        config.hook.pytest_deselected(items=dropped)
        items[:] = kept


def _runs_here(item: pytest.Item, lane: str | None) -> bool:
    marked = [name for name in LANES if item.get_closest_marker(name) is not None]
    return lane in marked if lane is not None else not marked
