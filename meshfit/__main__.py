"""Run `meshfit`, as a console script and as `python -m meshfit`."""

import gc
import signal
import sys

from meshfit.cli.address_space import lack_of_address_space
from meshfit.cli.crash_report import EXIT_CRASHED, print_crash, print_fault
from meshfit.library_output import silence_libraries


def main() -> None:
    """Run the command line, and report any error that it does not, such as a lack of memory while it is imported."""
    silence_libraries()
    if (fault := lack_of_address_space(sys.argv[1:])) is not None:
        print_fault(fault)
        sys.exit(EXIT_CRASHED)
    try:
        _main()
    except Exception as error:  # noqa: BLE001  the last resort
        print_crash(error)
        sys.exit(EXIT_CRASHED)


def _main() -> None:
    """Run the command line; while it is imported, Ctrl-C ends the process without a traceback."""
    gc.disable()  # what is imported stays, so that to look for garbage in it only costs time
    raises = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if raises:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from meshfit.cli.main import main as run

    gc.freeze()
    gc.enable()
    if raises:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
