"""Text that is safe to print: control and invisible characters are refused in names, and written as escapes elsewhere.

Every way out uses these functions: the terminal, pages and drawings, CSV, JSON, LaTeX and Markdown.
"""

import html
import json
import math
import unicodedata
from collections.abc import Callable

from meshfit.errors import ConfigError

# Control characters, invisible marks (of direction, of zero width, tags), surrogates, ends of lines and paragraphs.
_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")
# Joiners and non-joiners, which scripts such as Arabic and Devanagari, and emoji, have between their characters.
_JOINERS = "\u200c\u200d"
LONGEST_MESSAGE = 480
"""The most characters of an error or a warning on the terminal."""
_ELLIPSIS = " … "
_LONGEST_VALUE = 60
_ARRAY_LIBRARIES = ("numpy", "torch", "jax", "jaxlib", "cupy", "tensorflow")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def printable(text: str, keep: str = "") -> str:
    r"""Return a text with control and invisible characters as escapes, such as `\x1b` or `\u200b`.

    Joiners between characters outside ASCII stay, since words and emoji are spelt with them.

    Args:
        text: any text.
        keep: characters that stay as they are.
    """
    if text.isprintable():
        return text
    return _escaped(text, keep, lambda character: character.encode("unicode_escape").decode())


def printable_json(content: object) -> str:
    r"""Return the text of a JSON file, readable outside ASCII, with control characters as escapes such as `\u202e`.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return _escaped(text, "\n", lambda character: json.dumps(character)[1:-1])


def printable_html(text: str) -> str:
    """Return a text for an HTML page: without markup, and with control and invisible characters as escapes."""
    return html.escape(printable(text, keep="\n\t"))


def require_printable(name: str, what: str, remedy: str = "remove them") -> None:
    """Refuse a name with control or invisible characters.

    Args:
        name: the name.
        what: it names, for the message.
        remedy: what to do, for the message.

    Raises:
        ConfigError: it has some.
    """
    if (shown := printable(name)) != name:
        raise ConfigError(f"{what} '{shown}' has control or invisible characters; {remedy}")


def shortened(message: str, longest: int = LONGEST_MESSAGE) -> str:
    """Return a message of at most `longest` characters: the middle of a longer one gives way to an ellipsis."""
    if len(message) <= longest:
        return message
    kept = longest - len(_ELLIPSIS)
    return f"{message[: kept - kept // 2]}{_ELLIPSIS}{message[len(message) - kept // 2 :]}"


def csv_cell(value: object) -> str:
    """Return a value as the text of a CSV cell.

    Numbers are at full precision, booleans `true` or `false`, and None is empty. A text that a spreadsheet would take
    for a formula begins with an apostrophe.
    """
    if value is None:
        return ""
    if type(value) is float and math.isfinite(value):  # as json does integers and floats, in a sixth of the time
        return repr(value)
    if type(value) is int:
        return repr(value)
    if not isinstance(value, str):
        return json.dumps(value)
    text = printable(value, keep="\n\t")
    return f"'{text}" if value.startswith(_FORMULA) and not _is_number(value) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _escaped(text: str, keep: str, escape: Callable[[str], str]) -> str:
    return "".join(
        character
        if character in keep or unicodedata.category(character) not in _CATEGORIES or _joins(text, place)
        else escape(character)
        for place, character in enumerate(text)
    )


def _joins(text: str, place: int) -> bool:
    """Whether the character at a place is a joiner between two characters outside ASCII."""
    around = text[place - 1 : place] + text[place + 1 : place + 2]
    return text[place] in _JOINERS and len(around) == 2 and not any(map(_is_ascii_or_invisible, around))


def _is_ascii_or_invisible(character: str) -> bool:
    return character.isascii() or unicodedata.category(character) in _CATEGORIES


def described(thing: object) -> str:
    """Return what a thing is, in some words for messages."""
    if thing is None:
        return "None"
    kind = type(thing)
    library = kind.__module__.partition(".")[0]
    if hasattr(thing, "shape") and library in _ARRAY_LIBRARIES:
        return f"an array of shape {tuple(thing.shape)}"
    name = kind.__name__ if library in ("builtins", "__main__", "meshfit") else f"{library} {kind.__name__}"
    return f"{'an' if name[0] in 'aeiouAEIOU' else 'a'} {name}"


def value_text(value: object) -> str:
    """Return a value as Python writes it, in one short line; of long ones, what they are."""
    text = repr(value) if isinstance(value, str | bytes | int | float | list | tuple | set | type) else described(value)
    return text if len(text) <= _LONGEST_VALUE and text.isprintable() else described(value)


def option_text(value: object) -> str:
    """Return a value in place of one of several words: a text in double quotes, as messages on configs have it."""
    return f'"{printable(value)}"' if isinstance(value, str) else value_text(value)
