"""What recording costs: the loop's share of a cycle, bytes on the disk, work of the recorder, speed of reading back."""

import gc
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from gateway.recording.packets import Record
from gateway.recording.process import FLUSH_NS
from gateway.recording.recorder import Recorder
from replay.sessions.reader import open_session
from tests.drives import drive
from tests.recordings import robot, robot_text, writer

CYCLES = 4000
PACE_S = 0.001  # a busy loop without pauses would only measure how fast the socket fills
MICRO = 1e6


def measure() -> dict[str, float]:
    """Figures by name: microseconds of `put` as they pass, of work as the processor spends them; bytes per cycle."""
    figures: dict[str, float] = {}
    for received, sent in ((4, 1), (8, 4)):
        records = list(drive(CYCLES, received=received, sent=sent))
        figures |= {f"{name}_rx{received}_tx{sent}": value for name, value in _put(records).items()}
    for rate in (250.0, 1000.0):
        for received, sent in ((4, 1), (8, 4)):
            records = list(drive(4 * CYCLES, rate=rate, received=received, sent=sent))
            name = f"{rate:.0f}hz_rx{received}_tx{sent}"
            figures |= {
                f"{key}_{name}": value for key, value in _disk(records, batch=round(rate * FLUSH_NS * 1e-9)).items()
            }
    return figures


def _put(records: Sequence[Record]) -> dict[str, float]:
    """Time of `put` in the loop, the recorder process taking its share of the same processors."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(robot(Path(folder)), robot_text())
        spent = []
        for record in records:
            start = time.perf_counter()
            recorder.put(record.inputs, record.outputs, record.timing)
            spent.append(time.perf_counter() - start)
            time.sleep(PACE_S)
        recorder.close()
        assert recorder.dropped == 0
    spent.sort()
    return {"put_us": statistics.median(spent) * MICRO, "put_p99_us": spent[len(spent) * 99 // 100] * MICRO}


def _disk(records: Sequence[Record], *, batch: int) -> dict[str, float]:
    """Batches as the recorder process writes them."""
    with tempfile.TemporaryDirectory() as folder:
        session = writer(Path(folder))
        started = time.process_time()
        for start in range(0, len(records), batch):
            session.write(records[start : start + batch])
        session.close()
        written = time.process_time() - started
        gc.freeze()  # the records of this measurement are no work of the reader
        size = sum(path.stat().st_size for path in session.folder.iterdir())
        started = time.process_time()
        count = sum(1 for _ in open_session(session.folder).cycles())
        read = time.process_time() - started
        gc.unfreeze()
    return {
        "disk_bytes": size / len(records),
        "write_us": written / len(records) * MICRO,
        "read_us": read / count * MICRO,
    }
