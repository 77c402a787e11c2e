"""Takes the program of the viewer out of Rerun's SDK in this environment, and out of the list of the package's files.

It is 280 MB that nothing uses which drives, records or verifies. install.sh runs it where it sets up a robot.
"""

import csv
from importlib.metadata import distribution
from pathlib import Path

PROGRAM = "rerun_cli/rerun"


def main() -> None:
    """Idempotent."""
    sdk = distribution("rerun-sdk")
    record = next(Path(str(one.locate())) for one in sdk.files or () if one.name == "RECORD")
    Path(str(sdk.locate_file(PROGRAM))).unlink(missing_ok=True)
    with record.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if row[0] != PROGRAM]
    with record.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
