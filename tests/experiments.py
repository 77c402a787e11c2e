"""`python -m tests.experiments [NAME ...]`: every experiment of the papers in full, and each of its sessions replayed.

Too long for the suite (minutes). Fails where a row misses what it is allowed, where an experiment breaks its contract,
and where a session is not replayed byte for byte.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from replay.compare.verify import verify
from replay.reproduce.experiments import EXPERIMENTS
from replay.sessions.reader import open_session
from tests.replay.test_reproduce import held_to_the_contract


def run(names: Sequence[str]) -> int:
    """How many failed."""
    failed = 0
    for name in names:
        problem = checked(name)
        sys.stdout.write(f"{name}: {problem or 'good'}\n")
        sys.stdout.flush()
        failed += problem is not None
    return failed


def checked(name: str) -> str | None:
    """What is wrong with an experiment; None: nothing."""
    with TemporaryDirectory() as folder:
        try:
            result = held_to_the_contract(name, Path(folder))
        except AssertionError as error:
            return f"breaks its contract: {error}"
        for words, session in result.sessions.items():
            verdict = verify(open_session(session))
            if not verdict.identical or verdict.exit_code != 0:
                return f"session {words}: {verdict}"
    return None


if __name__ == "__main__":
    sys.exit(1 if run(sys.argv[1:] or list(EXPERIMENTS)) else 0)
