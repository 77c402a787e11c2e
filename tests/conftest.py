"""Fixtures shared by the rooms."""

import socket

import pytest

pytest_plugins = ["tests.vm.plugin"]


@pytest.fixture
def free_port() -> int:
    """A TCP port on loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
