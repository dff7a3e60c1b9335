"""Text that is safe to print: control characters are refused in names, and written as escapes everywhere else."""

import json
import math
import unicodedata

from meshfit.errors import ConfigError

# Control characters, surrogates, separators of lines and paragraphs.
_CATEGORIES = ("Cc", "Cs", "Zl", "Zp")
# They change the direction of the text after them.
_BIDIRECTIONAL = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
LONGEST_MESSAGE = 480
"""The most characters of an error or a warning on the terminal."""
_ELLIPSIS = " … "
_LONGEST_VALUE = 60
_ARRAY_LIBRARIES = ("numpy", "torch", "jax", "jaxlib", "cupy", "tensorflow")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def printable(text: str, keep: str = "") -> str:
    r"""Return a text with control characters as escapes, such as `\x1b`.

    Args:
        text: any text.
        keep: characters that stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(
        _escape(character) if _is_control(character) and character not in keep else character for character in text
    )


def printable_json(content: object) -> str:
    r"""Return the text of a JSON file, readable outside ASCII, with control characters as escapes such as `\u202e`.

    Raises:
        ValueError: a number is NaN or infinite, which JSON does not have.
    """
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return "".join(
        f"\\u{ord(character):04x}" if character != "\n" and _is_control(character) else character for character in text
    )


def require_printable(name: str, what: str, remedy: str = "remove them") -> None:
    """Refuse a name with control characters.

    Args:
        name: the name.
        what: it names, for the message.
        remedy: what to do, for the message.

    Raises:
        ConfigError: it has control characters.
    """
    if (shown := printable(name)) != name:
        raise ConfigError(f"{what} '{shown}' has control characters; {remedy}")


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
    if type(value) is float and math.isfinite(value):  # as json does, in a sixth of the time
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


def _is_control(character: str) -> bool:
    return unicodedata.category(character) in _CATEGORIES or character in _BIDIRECTIONAL


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode()


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
