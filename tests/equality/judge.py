"""Runs the core over recorded inputs and says what came out, to the bit: `python -m tests.equality.judge FOLDER`.

Needs the core and pydantic, and nothing else of what a robot needs: it runs where that cannot be installed.
"""

import hashlib
import json
import math
import pickle
import platform
import struct
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.build import FORM
from gateway.config import parse
from gateway.core.engine import Engine
from gateway.types import Inputs, Outputs

ROBOT = ".toml"  # the robot file
DRIVE = ".pickle"  # its cycles, with the outputs that were recorded; written and read by this lane alone


class Judgement(NamedTuple):
    """What a drive gives here. `first_difference`: the cycle in which anything at all, the trace included, differs
    from the recording; `digest`: of all outputs; `mathematics`: of what this machine's C library and BLAS say.
    """

    robot: str
    machine: str
    form: str
    cycles: int
    first_difference: int | None
    digest: str
    mathematics: str


def packed(records: Iterable[tuple[Inputs, Outputs]]) -> bytes:
    """A drive for `judge`."""
    return pickle.dumps(list(records))


def judge(robot: str, text: str, drive: bytes) -> Judgement:
    """Run the recorded inputs through the core of this machine."""
    engine = Engine(parse(text, robot))
    digest = hashlib.sha256()
    first_difference = None
    records: list[tuple[Inputs, Outputs]] = pickle.loads(drive)
    for inputs, recorded in records:
        outputs = engine.step(inputs)
        digest.update(repr(outputs).encode())
        if first_difference is None and outputs != recorded:
            first_difference = inputs.cycle
    return Judgement(
        robot=robot,
        machine=platform.machine(),
        form=FORM,
        cycles=len(records),
        first_difference=first_difference,
        digest=digest.hexdigest(),
        mathematics=_mathematics(),
    )


def _mathematics() -> str:
    """Something that does differ between processors, to see that there was something to be equal in."""
    digest = hashlib.sha256()
    for step in range(1, 20_000):
        x = 0.001 * step
        digest.update(struct.pack("<4d", math.sin(x), math.cos(x), math.exp(-x), math.atan2(x, 3.0)))
    try:
        import numpy as np  # noqa: PLC0415  # not there in the emulator
    except ImportError:
        return digest.hexdigest()
    for step in range(1, 200):
        rows = [[math.sin(wheel + step), math.cos(wheel * step), 1.0] for wheel in range(4)]
        digest.update(np.linalg.pinv(np.array(rows)).tobytes())
    return digest.hexdigest()


def main(arguments: Sequence[str]) -> int:
    """Every drive of the folder, as JSON."""
    found = []
    for path in sorted(Path(arguments[0]).glob(f"*{DRIVE}")):
        text = path.with_suffix(ROBOT).read_text(encoding="utf-8")
        found.append(judge(path.stem, text, path.read_bytes())._asdict())
    sys.stdout.write(json.dumps(found) + "\n")
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
