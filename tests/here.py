"""An executor that does each task at once, in this process."""

from concurrent.futures import Executor, Future


class Here(Executor):
    """Executor for tests.

    Args:
        work: is called with the task instead of what is submitted; None calls what is submitted.
    """

    def __init__(self, work=None):
        self.work = work

    def submit(self, fn, *arguments):
        future = Future()
        try:
            future.set_result(fn(*arguments) if self.work is None else self.work(arguments[0]))
        except Exception as error:
            future.set_exception(error)
        return future
