"""`meshfit schema`: print the JSON Schema of configs."""

import json

import typer


def schema() -> int:
    """Print the JSON Schema of a config, for editors.

    An editor that knows the schema completes and checks configs as you write them.

    Example:
        meshfit schema > meshfit.schema.json
    """
    from meshfit.config.experiment import ExperimentSettings

    typer.echo(json.dumps(ExperimentSettings.model_json_schema(), indent=2))
    return 0
