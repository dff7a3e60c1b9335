"""`meshfit init` and `meshfit schema`: a starter config, and the JSON Schema of configs."""

import json
from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.errors import ConfigError
from meshfit.paths import write_error_message


def init(
    path: Annotated[Path, typer.Argument(help="File to write.", metavar="FILE")] = Path("experiment.yaml"),
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> int:
    """Write a starter config that explains every setting.

    All settings have their default values; delete those that you do not change.

    Example:
        meshfit init mine.yaml && meshfit run mine.yaml
    """
    from meshfit.config.starter import starter_config

    if path.exists() and not force:
        raise ConfigError(f"{path}: already exists; choose another name, or overwrite it with --force")
    try:
        path.write_text(starter_config(), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {write_error_message(path, error)}") from error
    out.print(f"wrote {path}; now: meshfit run {path}", soft_wrap=True, markup=False)
    return 0


def schema() -> int:
    """Print the JSON Schema of a config, for editors.

    An editor that knows the schema completes and checks configs as you write them.

    Example:
        meshfit schema > meshfit.schema.json
    """
    from meshfit.config.experiment import ExperimentSettings

    typer.echo(json.dumps(ExperimentSettings.model_json_schema(), indent=2))
    return 0
