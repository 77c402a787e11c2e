"""What ends a recorder process. Apart from the module that raises it, which carries Rerun."""


class WriterDeadError(RuntimeError):
    """Rerun's writing thread has ended (disk full, read-only, broken).

    Such a stream may block for ever in any further call (measured with 0.41), so whoever catches this leaves the
    process without touching it again.
    """


class RecordingOffError(RuntimeError):
    """Rerun was switched off from outside, by RERUN=off in the environment."""
