"""Fixtures shared by the rooms."""

import socket

import pytest

from gateway.build import COMPILED

pytest_plugins = ["tests.vm.plugin"]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A test that takes a rule out of the core can do so only where the core is not compiled."""
    dropped = [item for item in items if COMPILED and item.get_closest_marker("pure_python") is not None]
    if dropped:
        config.hook.pytest_deselected(items=dropped)
        items[:] = [item for item in items if item not in dropped]


@pytest.fixture
def free_port() -> int:
    """A TCP port on loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
