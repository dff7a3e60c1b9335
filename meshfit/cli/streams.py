"""Standard streams that cannot take every character: those that they lack are replaced by ones that all have."""

import codecs
import sys
import unicodedata

_HANDLER = "meshfit-plain"
_PLAIN = {
    **dict.fromkeys("─–—−━", "-"),
    **dict.fromkeys("│┃", "|"),
    **dict.fromkeys("╭╮╰╯┌┐└┘├┤┬┴┼·•", "+"),
    **dict.fromkeys("█▇▆▅▄▃▂▁▉▊▋▌▍▎▏░▒▓", "#"),
    **dict.fromkeys("†★", "+"),
    **dict.fromkeys("‘’′", "'"),
    **dict.fromkeys("“”", '"'),
    "·": "-",
    "‡": "#",
    "≈": "~",
    "±": "+/-",
    "×": "x",
    "°": " deg",
    "…": "...",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "√": "sqrt",
    "α": "alpha",
    "τ": "tau",
    "λ": "lambda",
    "μ": "mu",
    "ν": "nu",
}


def plain(text: str) -> str:
    """Return a text in ASCII; what has no likeness in it becomes a question mark."""

    def replaced(character: str) -> str:
        known = _PLAIN.get(character)
        if known is not None:
            return known
        return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"

    return "".join(map(replaced, text))


def _replace(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return plain(error.object[error.start : error.end]), error.end


def make_streams_safe() -> None:
    """Let stdout and stderr replace characters that their encoding lacks, instead of raising an error."""
    codecs.register_error(_HANDLER, _replace)
    for stream in (sys.stdout, sys.stderr):
        encoding, reconfigure = getattr(stream, "encoding", None), getattr(stream, "reconfigure", None)
        if encoding and reconfigure is not None and codecs.lookup(encoding).name != "utf-8":
            reconfigure(errors=_HANDLER)
