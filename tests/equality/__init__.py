"""The same bytes everywhere: a lane of its own, `python -m tests.equality`."""
