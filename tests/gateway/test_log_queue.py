"""Whoever logs never waits: full queues drop and count, a blocked reader holds up one thread, its end is bounded."""

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from gateway.edges.log_queue import LogOutput, LogQueue

LAYOUT = "%(levelname)s: %(message)s"


def lines(queue: LogQueue) -> list[str]:
    queue.close()
    told: list[str] = []
    while (line := queue.take()) is not None:
        told.append(str(line))
    return told


def test_a_full_queue_drops_counts_and_tells_where() -> None:
    queue = LogQueue(limit=4)
    for number in range(7):
        queue.put(f"line {number}")
    assert queue.take() == "line 0"
    queue.put("dropped, because not half of the room is free")
    assert queue.take() == "line 1"
    queue.put("again")
    assert lines(queue) == ["line 2", "line 3", "4 log lines were dropped", "again"]


def test_nothing_dropped_is_nothing_told() -> None:
    queue = LogQueue(limit=2)
    queue.put("one")
    queue.put("two")
    assert lines(queue) == ["one", "two"]


@contextmanager
def output(descriptor: int, limit: int = 1000) -> Iterator[tuple[LogOutput, logging.Logger]]:
    log = LogOutput(descriptor, layout=LAYOUT, limit=limit)
    logger = logging.getLogger("test of the log queue")
    logger.propagate = False
    logger.addHandler(log.handler)
    yield log, logger
    logger.removeHandler(log.handler)


def read_all(descriptor: int) -> list[str]:
    with os.fdopen(descriptor) as file:
        return file.read().splitlines()


def test_records_and_captured_descriptors_come_out_whole() -> None:
    reading, writing = os.pipe()
    captured = os.open(os.devnull, os.O_WRONLY)
    with output(writing) as (log, logger):
        log.capture(captured)
        os.write(captured, b"a line\nhalf ")
        os.write(captured, b"a line\nno end")
        try:
            int("no number")
        except ValueError:
            logger.exception("a %s", "traceback")
        assert log.close(10.0)
    os.close(writing)
    told = read_all(reading)
    assert {"a line", "half a line", "no end", "ERROR: a traceback"} <= set(told)
    assert any(line.startswith("ValueError") for line in told)


def test_a_blocked_reader_holds_up_neither_logging_nor_captured_writers_nor_the_end() -> None:
    reading, writing = os.pipe()
    captured = os.open(os.devnull, os.O_WRONLY)
    with output(writing, limit=10) as (log, logger):
        log.capture(captured)
        for number in range(200):
            logger.warning("%d%s", number, "x" * 4000)
            os.write(captured, b"y" * 4000 + b"\n")
        assert not log.close(0.01), "some of it cannot be out"
        os.set_blocking(reading, False)
        assert os.read(reading, 1 << 20)
    os.close(reading)
    logger.warning("nobody reads any more")


def test_a_reader_that_has_gone_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with output(writing) as (log, logger):
        logger.warning("nobody reads")
        assert log.close(10.0)
    os.close(writing)


def test_a_destination_that_does_not_block_is_waited_for() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with output(writing) as (log, logger):
        for _ in range(100):
            logger.warning("%s", "x" * 4000)
        told = b""
        while told.count(b"\n") < 100:
            told += os.read(reading, 1 << 20)
        assert log.close(10.0)
    os.close(reading)
    os.close(writing)


@pytest.mark.filterwarnings("ignore")
def test_a_wrong_log_call_does_not_raise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logging, "raiseExceptions", False)
    reading, writing = os.pipe()
    with output(writing) as (log, logger):
        logger.warning("%d", "no number")  # noqa: PLE1206, RUF100
        assert log.close(10.0)
    os.close(reading)
    os.close(writing)


PROGRAM = """
import logging, os, sys
from gateway.edges.log_queue import take_over
take_over(level=logging.INFO, layout="%(message)s")
for number in range(int(sys.argv[1])):
    logging.getLogger("a").info("%d %s", number, "x" * 2000)
    os.write(1, b"like a library\\n")
raise SystemExit(7)
"""


def test_a_process_says_its_last_words() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "20"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 7
    assert done.stdout == ""
    told = done.stderr.splitlines()
    assert [line.partition(" ")[0] for line in told if line != "like a library"] == [str(i) for i in range(20)]
    assert told.count("like a library") == 20


def test_a_process_ends_though_nobody_reads_its_errors() -> None:
    with subprocess.Popen([sys.executable, "-c", PROGRAM, "3000"], stderr=subprocess.PIPE) as process:
        assert process.wait(60.0) == 7
        assert process.stderr is not None
        process.stderr.close()
