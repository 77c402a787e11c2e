"""The `drivegate` command: the composition root, the only place that knows every room."""

from gateway.cli.app import main

__all__ = ["main"]
