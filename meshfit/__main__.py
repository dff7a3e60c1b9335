"""Run `meshfit`, as a console script and as `python -m meshfit`."""

import signal


def main() -> None:
    """Run the command line; while it is imported, Ctrl-C ends the process without a traceback."""
    raises = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if raises:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from meshfit.cli.main import main as run

    if raises:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
