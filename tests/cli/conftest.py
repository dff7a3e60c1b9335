"""One real run that several files of tests start from."""

import pytest

from tests.cli.processes import meshfit
from tests.small import config_file


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """A folder in which the small experiment was run in a process of its own, with its stdout and stderr."""
    folder = tmp_path_factory.mktemp("complete")
    return folder, meshfit("run", config_file(folder), folder=folder)
