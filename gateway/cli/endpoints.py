"""Zenoh endpoints on the command line."""

import typer

from gateway.config import with_port


def checked(endpoint: str | None) -> str | None:
    """As it was given, for a `callback`: what cannot be one is a wrong option, and nothing that may come up later."""
    try:
        return None if endpoint is None else with_port(endpoint)
    except ValueError as error:
        raise typer.BadParameter(f"{endpoint!r}: {error}") from None
