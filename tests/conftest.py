"""Fixtures shared by the rooms."""

import socket

import pytest
from hypothesis import settings

from gateway.build import COMPILED

pytest_plugins = ["tests.vm.plugin"]

# One commit, one verdict: the same random examples in every run. New ones: pytest --hypothesis-profile=explore
settings.register_profile("repeatable", derandomize=True, database=None)
settings.register_profile("explore", max_examples=1000, print_blob=True)
settings.load_profile("repeatable")


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
