"""Tasks through any `concurrent.futures.Executor`: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

from simbench.errors import UserError
from simbench.extras import how_to_install
from simbench.processes import spawned
from simbench.suites.jobs import Run, Task
from simbench.suites.work import (
    HowToWork,
    RunResult,
    TaskResult,
    failed,
    perform,
    start_worker,
)

_DASK_WAIT_S = 10
_DIED = ("the process died: out of memory, a crash in native code, or a script without "
         "`if __name__ == '__main__'`")


@dataclass(frozen=True, slots=True)
class Workers:
    """An executor, and how many tasks it is to be given at a time."""

    executor: Executor
    at_a_time: int


Opener = Callable[[], AbstractContextManager[Workers]]


@contextmanager
def local_workers(count: int) -> Iterator[Workers]:
    """Spawned processes of this machine, each with its share of the processors."""
    threads = max(1, (os.cpu_count() or 1) // count)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")   # the arrays are small
    with spawned(count, start_worker, (threads,)) as executor:
        # No worker waits while results are written. Of a task that is cut short only its scratch
        # folder is left.
        yield Workers(executor, count + 1)


@contextmanager
def dask_workers(address: str) -> Iterator[Workers]:
    """The workers of a Dask cluster that runs already.

    Raises:
        UserError: distributed is not installed, the address is none, nothing answers, or workers
            have several threads.
    """
    try:
        from distributed import Client  # noqa: PLC0415 (an extra)
        from distributed.comm import get_address_host_port  # noqa: PLC0415
    except ModuleNotFoundError:
        raise UserError(f"--dask: needs Dask; {how_to_install('dask')}") from None
    try:
        get_address_host_port(address)   # half a client of a bad address would complain on its end
    except ValueError as error:
        raise UserError(f"--dask {address}: {error}; wanted one as in tcp://host:8786") from None
    try:
        client = Client(address, timeout=_DASK_WAIT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise UserError(f"--dask {address}: no scheduler answers there ({type(error).__name__}); "
                        "start one, or check the address") from None
    try:
        threads = _threads_of_workers(client, address)
        # Twice as many as can run: no worker waits for us to hand it the next.
        yield Workers(client.get_executor(pure=False), 2 * len(threads))
    finally:
        client.close()


def _threads_of_workers(client: Any, address: str) -> list[int]:
    try:
        client.wait_for_workers(1, timeout=_DASK_WAIT_S)
    except TimeoutError:
        raise UserError(f"--dask {address}: the scheduler has no worker; start some with "
                        f"`dask worker {address} --nthreads 1`") from None
    threads = list(client.nthreads().values())
    if max(threads) > 1:
        raise UserError(f"--dask {address}: a worker has {max(threads)} threads, and a renderer "
                        "belongs to one; start workers with --nthreads 1")
    return threads


OnResult = Callable[[Task, TaskResult], None]


def perform_all(tasks: Iterable[Task], how: HowToWork, open_workers: Opener,
                on_result: OnResult) -> None:
    """Do every task. A run that failed is tried once more, by itself, then handed on as failed.

    Where a process died, which takes all of a pool with it, the runs that may have killed it are
    done one at a time, each in a process of its own.

    Args:
        on_result: called in this thread with the results of a task, or of a second try.
    """
    waiting = deque((task, False) for task in tasks)
    while waiting:
        for task in _until_a_death(waiting, how, open_workers, on_result):
            for run in task.runs:
                alone = Task(task.sequence, (run,))
                with local_workers(1) as one:
                    on_result(alone, _result(one.executor.submit(perform, alone, how), alone))


def _until_a_death(waiting: deque[tuple[Task, bool]], how: HowToWork, open_workers: Opener,
                   on_result: OnResult) -> list[Task]:
    """Do what waits; returns what ran when a process died, and leaves the rest waiting."""
    running: dict[Future[TaskResult], tuple[Task, bool]] = {}
    with open_workers() as workers:
        while waiting or running:
            while waiting and len(running) < workers.at_a_time:
                try:
                    future = workers.executor.submit(perform, waiting[0][0], how)
                except BrokenProcessPool:
                    return [task for task, _ in running.values()]
                running[future] = waiting.popleft()
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                if isinstance(future.exception(), BrokenProcessPool):
                    continue        # all others of this pool break, too: told below
                task, again = running.pop(future)
                kept, retried = _sorted(task, _result(future, task), again)
                on_result(task, kept)
                waiting.extend((Task(task.sequence, (run,)), True) for run in retried)
            if any(f.done() and isinstance(f.exception(), BrokenProcessPool) for f in running):
                return [task for task, _ in running.values()]
    return []


def _result(future: Future[TaskResult], task: Task) -> TaskResult:
    """What a task gave; its own failure is that of all its runs."""
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, BrokenProcessPool):
        return _all_failed(task, _DIED, again=False)
    if isinstance(error, UserError):
        return _all_failed(task, str(error), again=False)
    return _all_failed(task, f"{type(error).__name__}: {error}", again=True)


def _all_failed(task: Task, reason: str, *, again: bool) -> TaskResult:
    return TaskResult(tuple(failed(run, reason, again=again) for run in task.runs), {})


def _sorted(task: Task, result: TaskResult, again: bool) -> tuple[TaskResult, list[Run]]:
    """The results to keep, and the runs to try again."""
    def once_more(each: RunResult) -> bool:
        return each.again and not again

    retried = [run for run, each in zip(task.runs, result.runs, strict=True) if once_more(each)]
    kept = tuple(each for each in result.runs if not once_more(each))
    return TaskResult(kept, result.meaning), retried
