"""Verdicts on a Dask cluster instead of processes here: the same function on the same paths, so the same verdicts.

Its workers need DriveGate, and every session under the path that it has here; what a URL names they fetch themselves.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

EXTRA = "needs the package `distributed`: pip install 'drivegate[fleet]'"
CONNECT_S = 10


class ClusterError(Exception):
    """A cluster that cannot be had; the text says why."""


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of the scheduler at this address. Raises ClusterError."""
    try:
        from distributed import Client  # noqa: PLC0415  # an extra, and a second to import
    except ImportError:
        raise ClusterError(f"--scheduler {EXTRA}") from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TypeError, ValueError) as error:
        raise ClusterError(f"{address}: no scheduler can be reached there: {error}") from None
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise ClusterError(f"{address}: this cluster has no workers")
        executor: Executor = client.get_executor()  # type: ignore[no-untyped-call]
        yield executor
