"""An executor in this process and thread, so that a test's patches hold in its trials too."""

from concurrent.futures import Executor, Future


class Inline(Executor):
    """Runs each call as soon as it is submitted."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  it belongs to the call
            future.set_exception(error)
        return future
