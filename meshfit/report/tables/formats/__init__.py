"""The table of formats. Adding one is adding a file here and an entry below."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from meshfit.report.tables.formats.csv_text import to_csv
from meshfit.report.tables.formats.json_text import to_json
from meshfit.report.tables.formats.latex import to_latex
from meshfit.report.tables.formats.markdown import to_markdown
from meshfit.report.tables.formats.terminal import to_text
from meshfit.report.tables.sheet import Sheet

FORMATS: Mapping[str, Callable[[Sequence[Sheet]], str]] = MappingProxyType(
    {
        "rich": to_text,
        "md": to_markdown,
        "csv": to_csv,
        "latex": to_latex,
        "json": to_json,
    }
)
