"""Consoles for stdout and stderr, one-line errors and warnings, and exit codes."""

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Timer
from typing import TextIO

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook
from rich.markup import escape
from rich.segment import Segment

from meshfit.cli.crash_report import EXIT_CRASHED, crash_report
from meshfit.errors import MeshfitError, MeshfitWarning
from meshfit.paths import is_regular_file
from meshfit.printable import printable, shortened
from meshfit.units import size_text

EXIT_FAILED = 1
"""A trial failed, or a check fell short."""
EXIT_USAGE = MeshfitError.exit_code
"""Bad usage, configuration or input."""
EXIT_INTERRUPTED = 130


_SECONDS_UNTIL_SAID = 10.0
_LARGE_FILES = 50_000_000


@dataclass(frozen=True)
class _Trimmed:
    """Output without spaces at the ends of lines."""

    output: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for line in Segment.split_lines(console.render(self.output, options)):
            while line and not line[-1].control and not line[-1].text.strip():
                line.pop()
            if line:
                yield from line[:-1]
                yield line[-1] if line[-1].control else Segment(line[-1].text.rstrip(), line[-1].style)
            yield Segment.line()


@dataclass(frozen=True)
class _Printable:
    """Output whose control characters are escapes, except those of the console itself."""

    output: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for segment in console.render(self.output, options):
            yield segment if segment.control else Segment(printable(segment.text, keep="\n\t"), segment.style)


class _Trimming(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Trimmed(_Printable(renderable)) for renderable in renderables]


class _Escaping(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Printable(renderable) for renderable in renderables]


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Be quiet from now on if nobody reads stderr, and leave a closed stdout to `exit_code_of`.

        By default, both are failures with exit code 1, and a run would stop because its progress is not shown.
        """
        if not self.stderr:
            raise BrokenPipeError
        self.quiet = True
        _discard(sys.stderr)


out = _Console(highlight=False)
out.push_render_hook(_Trimming())
err = _Console(stderr=True, highlight=False)
err.push_render_hook(_Escaping())

# Of the terminal's 16 colours, red, green, magenta and cyan are readable on both white and black; yellow, blue and dim
# text are not. Colour never carries meaning alone.


def print_error(message: str) -> None:
    """Print an error as one line on stderr."""
    err.print(f"[bold red]error:[/] {escape(shortened(printable(' '.join(message.split()))))}", soft_wrap=True)


def print_warning(message: str) -> None:
    """Print a warning as one line on stderr."""
    text = shortened(printable(message, keep="\n\t"))
    err.print(f"[bold magenta]warning:[/] {escape(text)}", soft_wrap=True)


@contextmanager
def working(text: str, *, quiet: bool = False) -> Iterator[None]:
    """Say on stderr what is done within the block: a spinner on a terminal, elsewhere one line if it takes seconds."""
    if quiet:
        yield
    elif err.is_terminal and not err.is_dumb_terminal:
        with err.status(text):
            yield
    else:
        timer = Timer(_SECONDS_UNTIL_SAID, partial(err.print, text, soft_wrap=True, markup=False))
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


@contextmanager
def reading(targets: Iterable[str], *, quiet: bool = False) -> Iterator[None]:
    """Say on stderr that targets are read within the block: at once where their files are large, else as `working`."""
    size = sum(path.stat().st_size for path in map(Path, dict.fromkeys(targets)) if is_regular_file(path))
    if size < _LARGE_FILES:
        with working("reading the targets", quiet=quiet):
            yield
        return
    text = f"reading the targets, {size_text(size)}"
    if not quiet and (not err.is_terminal or err.is_dumb_terminal):
        err.print(text, soft_wrap=True, markup=False)
        quiet = True
    with working(text, quiet=quiet):
        yield


class _Warnings:
    """The warnings of a command: each is shown once, and those of one file after another on one line."""

    def __init__(self) -> None:
        self.shown: set[str] = set()
        self._file, self._texts = "", list[str]()

    def show(self, text: str) -> None:
        """Show a warning, or hold it until one of another file comes, or something else is printed."""
        if text in self.shown:
            return
        self.shown.add(text)
        file, separator, rest = text.partition(": ")
        if not separator or (" " in file and not os.path.exists(file)):  # noqa: PTH110  any text, perhaps no path
            file, rest = "", text
        # A warning of several clauses keeps a line of its own.
        if not file or file != self._file or ";" in rest:
            self.flush()
        self._file = file
        self._texts.append(rest)

    def flush(self) -> None:
        """Print what is held."""
        texts, self._texts = self._texts, []
        if texts:
            print_warning(": ".join(filter(None, (self._file, "; ".join(texts)))))


class _Flushing(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        _warnings.flush()
        return renderables


_warnings = _Warnings()
out.push_render_hook(_Flushing())
err.push_render_hook(_Flushing())


def warn_once(text: str) -> None:
    """Show a warning unless the command has shown it before."""
    _warnings.show(text)


def flush_warnings() -> None:
    """Print warnings that are held for others of their file."""
    _warnings.flush()


@contextmanager
def show_warnings() -> Iterator[None]:
    """Show meshfit's own warnings, each once and those of a file on one line, and ignore all others."""
    global _warnings  # noqa: PLW0603  of the command that runs
    _warnings = _Warnings()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if isinstance(message, MeshfitWarning):
            _warnings.show(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", MeshfitWarning)
        warnings.showwarning = show
        try:
            yield
        finally:
            _warnings.flush()


def exit_code_of(command: Callable[[], int]) -> int:
    """Run a command, turning errors into one line and an exit code; unexpected ones leave a file with a traceback."""
    try:
        with show_warnings():
            code = command()
            if sys.stdout is not None:
                sys.stdout.flush()
            return code
    except MeshfitError as error:
        for fault in error.faults:
            print_error(fault)
        return error.exit_code
    except KeyboardInterrupt:
        resume = "; run the same command again to resume" if _resumes(sys.argv[1:]) else ""
        err.print(f"interrupted{resume}", style="bold magenta")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader, such as `head`, has had enough
        _discard(sys.stdout)
        return 0
    except OSError as error:
        print_error(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        return EXIT_USAGE
    except Exception as error:  # noqa: BLE001  the last resort
        print_error(crash_report(error))
        return EXIT_CRASHED


def _resumes(words: Sequence[str]) -> bool:
    """Whether a command line keeps what it has done when it is interrupted."""
    return words[:1] in (["run"], ["compare"], ["tune"]) or any(word.partition("=")[0] == "--keep" for word in words)


def _discard(stream: TextIO) -> None:
    """Send the rest of a stream to nowhere, so that Python does not report at its exit that it cannot be written."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
