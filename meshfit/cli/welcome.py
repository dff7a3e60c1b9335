"""What `meshfit` says when it is given nothing to do: what it is, and what to type next."""

from meshfit.cli.console import out
from meshfit.cli.help import print_examples
from meshfit.cli.options import DEFAULT_RUNS


def print_welcome() -> None:
    """A screen for someone who sees it for the first time."""
    out.print("[bold]meshfit[/] fits a source mesh, refined by a subdivision scheme of your choice, to")
    out.print("target shapes, measures how well that went, and prints the table.")
    first = ["meshfit run quickstart  # two animals, two schemes, in under 2 minutes"]
    first += ["meshfit compare loop interp-loop --config quickstart  # two schemes compared"]
    first += ["meshfit init  # writes a config for an experiment of your own"]
    print_examples(first, "Start here")
    then = ["meshfit --help  # all commands"]
    then += ["meshfit run --help  # one of them, with examples"]
    then += ["meshfit targets  # what can be fitted to; any mesh file, too"]
    then += ["meshfit --install-completion  # let the Tab key complete all this"]
    if DEFAULT_RUNS.is_dir():
        then.insert(0, f"meshfit status  # how the experiments in {DEFAULT_RUNS}/ stand")
    print_examples(then, "Then")
