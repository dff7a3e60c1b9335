"""An executor in this process and thread: what tests change here is changed for the trials too."""

from concurrent.futures import Executor, Future


class Inline(Executor):
    """Calls at once: the least that an executor can be."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  it belongs to the call
            future.set_exception(error)
        return future
