"""Second tries, runs that fail for good, and processes that die."""

from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from here import Here
from simbench.inputs import InputChoice
from simbench.suites import pool
from simbench.suites.jobs import Run, Task
from simbench.suites.pool import Workers, perform_all
from simbench.suites.spec import SequenceSpec
from simbench.suites.work import HowToWork, RunResult, TaskResult, failed

SEQUENCE = SequenceSpec("SwingingBoxes-v0", frames=2, size=(32, 24))


def a_run(seed=0, system="sdpl"):
    return Run("boxes", (), seed, system, SEQUENCE, InputChoice(), ())


def results_by(work, *tasks):
    """(key, status) of all that is handed on."""
    found = []

    @contextmanager
    def opened():
        yield Workers(Here(work), 2)

    perform_all(tasks, HowToWork(), opened,
                lambda task, result: found.extend((r.key, r.status, r.reason)
                                                  for r in result.runs))
    return found


def good(run):
    return RunResult(run.key, "done", "", False, {}, {}, {})


def test_a_failed_run_is_tried_once_more_alone():
    first, second = a_run(0), a_run(1)
    tasks_seen = []

    def work(task):
        tasks_seen.append([run.seed for run in task.runs])
        return TaskResult(tuple(
            failed(run, "out of luck", again=True) if run.seed == 1 and len(tasks_seen) == 1
            else good(run) for run in task.runs), {})

    found = results_by(work, Task(SEQUENCE, (first, second)))
    assert found == [(first.key, "done", ""), (second.key, "done", "")]
    assert tasks_seen == [[0, 1], [1]]


def test_what_fails_twice_is_handed_on_with_its_reason():
    def work(task):
        raise RuntimeError("no memory\nleft")

    run = a_run()
    assert results_by(work, Task(SEQUENCE, (run,))) \
        == [(run.key, "failed", "RuntimeError: no memory left")]


def test_a_mistake_of_the_users_is_not_tried_again():
    tries = []

    def work(task):
        tries.append(task)
        return TaskResult((failed(task.runs[0], "no such mask", again=False),), {})

    assert len(results_by(work, Task(SEQUENCE, (a_run(),)))) == len(tries) == 1


def test_a_process_that_dies_costs_its_own_run_only(monkeypatch):
    killer, *fine = (a_run(seed) for seed in range(4))
    alone = []

    def work(task):
        if killer in task.runs:
            raise BrokenProcessPool
        return TaskResult(tuple(good(run) for run in task.runs), {})

    @contextmanager
    def one_process(count):
        alone.append(count)
        yield Workers(Here(work), count)

    monkeypatch.setattr(pool, "local_workers", one_process)
    found = {key: (status, reason) for key, status, reason in results_by(
        work, Task(SEQUENCE, (fine[0], killer)), *(Task(SEQUENCE, (run,)) for run in fine[1:]))}
    assert found.pop(killer.key) == ("failed", pool._DIED)
    assert set(found) == {run.key for run in fine}
    assert set(found.values()) == {("done", "")}
    assert 2 <= len(alone) <= 3       # the killer's task, one run at a time; and what ran beside it
