"""The warnings that our modules log, gathered for a run's folder."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def captured_log() -> Iterator[list[str]]:
    """The warnings that our modules log meanwhile, each once."""
    said: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            entry = f"{record.levelname.lower()}: {record.getMessage()}"
            if entry not in said:
                said.append(entry)

    handler = Collector(logging.WARNING)
    loggers = [logging.getLogger(name) for name in ("simbench", "slam")]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield said
    finally:
        for logger in loggers:
            logger.removeHandler(handler)
