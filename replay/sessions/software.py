"""What has changed since a session was recorded in the software that computes its outputs."""

from gateway.recording.header import git_commit, versions
from gateway.recording.schema import Header

COMPUTING = ("drivegate", "commit", "arithmetic")
# Until sessions told it: the sine of the C library and the inverse of BLAS, whose last bits differ between processors.
LIBRARIES = "the machine's libraries"
UNKNOWN = "unknown"


def change(header: Header) -> str | None:
    """Each part that is not what it was, then and now, in words; None where all is the same."""
    then = {"arithmetic": LIBRARIES} | header.versions | {"commit": header.git_commit or UNKNOWN}
    now = versions() | {"commit": git_commit() or UNKNOWN}
    changed = [
        f"{name} {then.get(name, UNKNOWN)}, now {now[name]}" for name in COMPUTING if then.get(name) != now[name]
    ]
    return "; ".join(changed) or None
