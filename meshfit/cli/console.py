"""What every command shares: where it prints, and how it ends when something is wrong."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape

from meshfit.errors import MeshfitError, MeshfitWarning

EXIT_INTERRUPTED = 130

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def say_error(message: str) -> None:
    """One line on stderr: what is wrong."""
    err.print(f"[bold red]error:[/] {escape(' '.join(message.split()))}", soft_wrap=True)


def say_warning(message: str) -> None:
    """One line on stderr: what was mended, or is worth knowing."""
    err.print(f"[yellow]warning:[/] {escape(message)}", soft_wrap=True)


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Show meshfit's own warnings as single lines, each once, and nobody else's."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        text = str(message)
        if isinstance(message, MeshfitWarning) and text not in seen:
            seen.add(text)
            say_warning(text)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", MeshfitWarning)
        warnings.showwarning = show
        yield


def exit_code_of(command: Callable[[], int]) -> int:
    """Run a command; foreseen errors, and those of the file system, become one line and an exit code."""
    try:
        with shown_warnings():
            return command()
    except MeshfitError as error:
        say_error(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        err.print("interrupted; the same command goes on from here", style="yellow")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return 0
    except OSError as error:
        say_error(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        return MeshfitError.exit_code
