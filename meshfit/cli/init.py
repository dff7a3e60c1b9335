"""`meshfit init`: write a starter config."""

from pathlib import Path
from typing import Annotated

import typer

from meshfit.cli.console import out
from meshfit.errors import ConfigError
from meshfit.paths import CONFIG_SUFFIXES, path_text, shell_path, write_error_message


def init(
    path: Annotated[Path, typer.Argument(help="File to write: .yaml or .yml.", metavar="FILE")] = Path(
        "experiment.yaml"
    ),
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> int:
    """Write a starter config that explains every setting.

    All settings have their default values; delete those that you do not change.

    Example:
        meshfit init mine.yaml && meshfit run mine.yaml
    """
    from meshfit.config.starter import starter_config

    if path.suffix.lower() not in CONFIG_SUFFIXES:
        other = path.with_suffix(".yaml") if path.name.strip(".") else path / "experiment.yaml"
        found = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise ConfigError(
            f"{path_text(path)}: {found} is not that of a config; allowed: {', '.join(CONFIG_SUFFIXES)}; "
            f"did you mean {path_text(other)}?"
        )
    if path.exists() and not force:
        raise ConfigError(f"{path}: already exists; choose another name, or overwrite it with --force")
    try:
        path.write_text(starter_config(), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {write_error_message(path, error)}") from error
    out.print(f"wrote {path}; now: meshfit run {shell_path(path)}", soft_wrap=True, markup=False)
    return 0
