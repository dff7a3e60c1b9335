"""MkDocs hooks: generate the reference of commands and config keys, run notebooks, and add the README's pictures.

A page asks for generated text by a comment on a line of its own: `<!-- commands -->` or `<!-- config keys -->`.
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import typer.main
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from typer.cli import get_docs_for_click
from typer.core import TyperGroup

from meshfit.cli.main import app
from meshfit.config.experiment import ExperimentSettings
from meshfit.fitting.settings import METHODS
from meshfit.settings import Settings

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads this file alone
from notebooks import as_markdown, executed


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pictures in data/pictures, which the README shows too, as pictures/ of the site."""
    data = Path(config.config_file_path).parent / "data"
    for picture in sorted((data / "pictures").rglob("*.png")):
        name = picture.relative_to(data).as_posix()
        files.append(File(name, str(data), config.site_dir, use_directory_urls=True))
    for path in sorted(Path(config.docs_dir).glob("notebooks/*.ipynb")):
        page, pictures = as_markdown(executed(path), path.name)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=page))
        for name, content in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Put generated text in place of the comments that ask for it."""
    for comment, generate in (("<!-- commands -->", command_reference), ("<!-- config keys -->", config_reference)):
        if comment in markdown:
            markdown = markdown.replace(comment, generate())
    return markdown


def command_reference() -> str:
    """Return the reference of every command, as Typer writes it, one heading per command."""
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    context = typer.Context(group, info_name="meshfit")
    sections = [
        get_docs_for_click(obj=group.commands[name], ctx=context, name=name, call_prefix="meshfit")
        for name in group.list_commands(context)
    ]
    return "\n".join(_with_code_blocks(section) for section in sections)


def _with_code_blocks(text: str) -> str:
    """Set the examples of a help text as one block of code, and its title as a heading below the page's."""
    text = re.sub(r"^(Examples?:) *\n(?=    )", r"\1\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"^# ", "## ", text, flags=re.MULTILINE)
    return re.sub(r"^(    meshfit .*)\n\n(?=    meshfit )", r"\1\n", text, flags=re.MULTILINE)


def config_reference() -> str:
    """Return tables of every config key with its default and description, one table per section."""
    sections = [("", "Experiment", ExperimentSettings())]
    parts = []
    while sections:
        prefix, title, settings = sections.pop(0)
        rows, nested = [], []
        for key, default, description, example in _keys(settings):
            dotted = f"{prefix}{key}"
            if dotted == "fit":
                engines = METHODS.items()
                nested += [("fit.", f"`fit`, method `{name}`", model.model_construct()) for name, model in engines]
            elif isinstance(default, Settings):
                nested.append((f"{dotted}.", f"`{dotted}`", default))
            shown = "" if isinstance(default, Settings) else f"`{_as_yaml(default)}`"
            rows.append(f"| `{dotted}` | {shown} | {_cell(f'{description} {example}')} |")
        sections = nested + sections
        head = f"## {title}\n\n{_cell((type(settings).__doc__ or '').partition('Example:')[0])}\n"
        parts.append("\n".join([head, "| key | default | meaning |", "| --- | --- | --- |", *rows, ""]))
    return "\n".join(parts)


def _keys(settings: Settings) -> Iterator[tuple[str, Any, str, str]]:
    """Yield key, default, description and example of each setting, also of models that are null by default."""
    for name, field in type(settings).model_fields.items():
        description = field.description or ""
        examples = "".join(f"Example: `{_as_yaml(example)}`" for example in field.examples or ())
        yield name, getattr(settings, name), description, examples
        for option in get_args(field.annotation):
            if isinstance(option, type) and issubclass(option, Settings) and getattr(settings, name) is None:
                for key, nested in option.model_fields.items():
                    default = "required" if nested.is_required() else nested.get_default()
                    yield f"{name}.{key}", default, nested.description or "", ""


def _as_yaml(value: Any) -> str:  # noqa: ANN401  any plain value
    return json.dumps(value, default=list, ensure_ascii=False).replace('"', "")


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
