"""`meshfit schema`: the JSON Schema of a config."""

import json

import typer


def schema() -> int:
    """Print the JSON Schema of a config, for editors.

    An editor that knows it completes and checks configs as they are written.

    Example:
        meshfit schema > meshfit.schema.json
    """
    from meshfit.config.experiment import ExperimentSettings

    typer.echo(json.dumps(ExperimentSettings.model_json_schema(), indent=2))
    return 0
