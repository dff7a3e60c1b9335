"""What every command shares: where it prints, and how it ends when something is wrong."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook
from rich.markup import escape
from rich.segment import Segment

from meshfit.errors import MeshfitError, MeshfitWarning

EXIT_INTERRUPTED = 130


@dataclass(frozen=True)
class _Trimmed:
    """What is printed, without blanks at the ends of its lines."""

    printed: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for line in Segment.split_lines(console.render(self.printed, options)):
            while line and not line[-1].control and not line[-1].text.strip():
                line.pop()
            if line:
                yield from line[:-1]
                yield line[-1] if line[-1].control else Segment(line[-1].text.rstrip(), line[-1].style)
            yield Segment.line()


class _Trimming(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Trimmed(one) for one in renderables]


out = Console(highlight=False)
out.push_render_hook(_Trimming())
err = Console(stderr=True, highlight=False)

# Of the 16 colours, whose shades are the terminal's, red, green, magenta and cyan can be read on white and on black
# alike; yellow and blue cannot, nor can dim text. What is told by colour is told by words too.


def print_error(message: str) -> None:
    """One line on stderr: what is wrong."""
    err.print(f"[bold red]error:[/] {escape(' '.join(message.split()))}", soft_wrap=True)


def print_warning(message: str) -> None:
    """One line on stderr: what was mended, or is worth knowing."""
    err.print(f"[bold magenta]warning:[/] {escape(message)}", soft_wrap=True)


@contextmanager
def show_warnings() -> Iterator[None]:
    """Show meshfit's own warnings as single lines, each once, and nobody else's."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        text = str(message)
        if isinstance(message, MeshfitWarning) and text not in seen:
            seen.add(text)
            print_warning(text)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", MeshfitWarning)
        warnings.showwarning = show
        yield


def exit_code_of(command: Callable[[], int]) -> int:
    """Run a command; foreseen errors, and those of the file system, become one line and an exit code."""
    try:
        with show_warnings():
            return command()
    except MeshfitError as error:
        print_error(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        err.print("interrupted; the same command goes on from here", style="bold magenta")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return 0
    except OSError as error:
        print_error(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        return MeshfitError.exit_code
