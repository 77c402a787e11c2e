"""Recordings of schema version 2: as they are today, but without a digest chain. Read, no longer written."""

from gateway.recording.schema import (
    BLOCK_COLUMNS,
    BLOCK_PATH,
    CYCLE,
    LINK_COLUMNS,
    SEAL_COLUMNS,
    SEAL_PATH,
    SNAPSHOT_COLUMNS,
    SNAPSHOT_PATH,
)
from replay.sessions.tables import Layout

MARKS: Layout = {
    path: {name: kind for name, kind in columns.items() if name not in LINK_COLUMNS}
    for path, columns in ((SEAL_PATH, SEAL_COLUMNS), (SNAPSHOT_PATH, SNAPSHOT_COLUMNS))
}
LAYOUT: Layout = {
    BLOCK_PATH: {CYCLE: None} | {name: kind for name, kind in BLOCK_COLUMNS.items() if name not in LINK_COLUMNS},
    **MARKS,
}
