"""The formats of tables, by name."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from meshfit.report.tables.formats.data import to_csv, to_json
from meshfit.report.tables.formats.latex import to_latex
from meshfit.report.tables.formats.markdown import to_markdown
from meshfit.report.tables.formats.terminal import to_text
from meshfit.report.tables.table import Table

FORMATS: Mapping[str, Callable[[Sequence[Table]], str]] = MappingProxyType(
    {"rich": to_text, "md": to_markdown, "csv": to_csv, "latex": to_latex, "json": to_json}
)
