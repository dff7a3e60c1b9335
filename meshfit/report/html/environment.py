"""The environment of the templates: what they print is escaped, and has no control characters."""

from typing import Any

from meshfit.optional import import_optional
from meshfit.printable import printable


def template_environment() -> Any:  # noqa: ANN401  of jinja2, which is optional
    """Return the environment of the page's templates.

    Raises:
        ConfigError: jinja2 is not installed.
    """
    jinja2 = import_optional("jinja2")
    return jinja2.Environment(
        loader=jinja2.PackageLoader("meshfit.report.html", "templates"),
        autoescape=True,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )


def _printable(value: object) -> object:
    """Return texts with control characters as escapes, and everything else, such as markup, as it is."""
    return printable(value, keep="\n\t") if type(value) is str else value
