"""Processes that share the work, and what Ctrl-C does to them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any


@contextmanager
def spawned(count: int, initializer: Callable[..., None] | None = None,
            initargs: tuple[Any, ...] = ()) -> Iterator[ProcessPoolExecutor]:
    """So many spawned processes; an error or Ctrl-C in the block ends them at once.

    Ctrl-C in a terminal reaches every process. These do not hear it, or each would show where it
    was caught; an `initializer` may make them hear it.
    """
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=initializer,
                               initargs=initargs)
    try:
        with _deaf_to_interrupts():
            pool.submit(int)        # all of them start with the first task, and inherit this
        yield pool
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Ignore SIGINT here and in what is started here. Only the main thread may decide that."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, heard)
