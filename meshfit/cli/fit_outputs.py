"""Files that `meshfit fit` writes: their names, and what cannot be written, refused before the fit."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile, mkdtemp
from typing import TYPE_CHECKING

from meshfit.cli.fit_plan import FitOptions
from meshfit.config.path_parts import folder_key
from meshfit.errors import ConfigError, MeshError
from meshfit.images.specs import is_image_target, label_of_target
from meshfit.paths import (
    MESH_SUFFIXES,
    STDOUT_PATHS,
    STREAM,
    file_stem,
    format_suffix,
    is_folder,
    path_text,
    shell_path,
)

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh

FORMAT_OF_MANY = "ply"
"""Format of the results of several targets, unless another is given."""


def check_printed(output: str, *, measure: bool, as_json: bool) -> None:
    """Refuse two things that go to standard output.

    Raises:
        ConfigError: more than one of a mesh, a table and JSON.
    """
    if output in STDOUT_PATHS and (measure or as_json):
        raise ConfigError("standard output can have only one of the mesh, --measure and --json; give OUT a name")
    if measure and as_json:
        raise ConfigError("--measure prints a table; --json has all metrics without it")


def check_output(output: str, output_format: str | None) -> None:
    """Refuse an output that cannot be written, before the fit.

    Raises:
        MeshError: an unknown format, a folder that does not exist, or a place that is read-only.
    """
    from meshfit.mesh.io.files import mesh_output_suffix

    mesh_output_suffix(output, output_format)
    if output in STDOUT_PATHS:
        if sys.stdout is None:
            raise MeshError("standard output: it is closed; give the path of a file")
        return
    _check_place(output)


def _check_place(output: str) -> None:
    """Refuse the path of a file that cannot be written."""
    path = Path(output)
    folder = path.parent
    if not folder.is_dir():
        raise MeshError(f"{path_text(output)}: cannot be written: there is no folder {path_text(folder)}; create it")
    if path.exists() and not path.is_file():
        return  # such as /dev/null
    if not os.access(folder, os.W_OK | os.X_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise MeshError(f"{path_text(output)}: cannot be written: no permission; give another place")
    try:
        with TemporaryFile(dir=os.path.realpath(folder)):
            pass
    except OSError as error:
        raise MeshError(f"{path_text(output)}: cannot be written: {error.strerror}; give another place") from None


def outputs_of_many(targets: Sequence[str], output: str, output_format: str | None) -> list[str]:
    """Return one file per target in a folder, which is created; equal stems are numbered."""
    from meshfit.experiment.storage.run_directory import make_folder
    from meshfit.mesh.io.files import mesh_output_suffix

    if output in STDOUT_PATHS or (os.path.lexists(output) and not is_folder(output)):
        raise ConfigError(f"-o {path_text(output)}: several targets need a folder; give the path of one")
    if format_suffix(output) in MESH_SUFFIXES and not os.path.lexists(output) and not output.endswith(("/", os.sep)):
        raise ConfigError(
            f"-o {path_text(output)}: several targets need a folder, got a file; {_remedy(targets, output)}"
        )
    suffix = mesh_output_suffix("result", output_format or FORMAT_OF_MANY)
    folder = Path(output)
    stems = ["standard-input" if target == STREAM else label_of_target(target) for target in targets]
    taken, outputs = set[str](), []
    for stem in stems:
        name, number = stem, 1
        while folder_key(name) in taken or (number > 1 and folder_key(name) in set(map(folder_key, stems))):
            number += 1
            name = f"{stem}-{number}"
        taken.add(folder_key(name))
        outputs.append(str(folder / f"{name}{suffix}"))
    make_folder(folder)
    for path in outputs:
        check_output(path, output_format or FORMAT_OF_MANY)
    return outputs


def _remedy(targets: Sequence[str], output: str) -> str:
    """Return what to give instead of several targets and a file."""
    if len(targets) != 2:  # a template and a scan, maybe
        return "give -o fitted/"
    template, scan = (shell_path(target) for target in targets)
    command = f"meshfit fit {scan} -o {shell_path(output)} --source {template} --connectivity fixed"
    return f"give -o fitted/, or, to bring the first to the second: {command}"


def correspondence_files(
    path: Path | None, inputs: Sequence[str], outputs: Sequence[str], options: FitOptions, *, many: bool
) -> list[str | None]:
    """Return the table of the correspondence of each output, if wanted; refuse those that cannot be written."""
    if path is None:
        return [None] * len(outputs)
    option = f"--correspondence {path_text(path)}"
    if options.connectivity != "fixed":
        remedy = "give --register near-rigid, or --connectivity fixed"
        raise ConfigError(f"{option}: a remeshed result has other vertices than the source; {remedy}")
    if not many and (is_folder(str(path)) or format_suffix(path) in MESH_SUFFIXES):
        raise ConfigError(f"{option}: expected a CSV file; give a name such as pairs.csv")
    if many:
        from meshfit.experiment.storage.run_directory import make_folder

        make_folder(path)
    if any(map(is_image_target, inputs)):
        fault = "images have no faces or points to pair vertices with"
        raise ConfigError(f"{option}: {fault}; leave it out, or fit to the mesh that they show")
    tables = [str(path / f"{file_stem(output)}.csv") if many else str(path) for output in outputs]
    taken = {os.path.realpath(name) for name in (*inputs, *outputs)}
    for table in tables:
        if os.path.realpath(table) in taken:
            raise ConfigError(f"{option}: would overwrite a mesh; give another name, such as pairs.csv")
        _check_place(table)
    return [*tables]


def check_not_overwritten(targets: Sequence[str], outputs: Sequence[str], source: str) -> None:
    """Refuse an output that is also an input.

    Raises:
        ConfigError: the output that would overwrite a mesh, or standard input twice.
    """
    if targets.count(STREAM) > 1:
        raise ConfigError("standard input can be read only once")
    inputs = {os.path.realpath(name) for name in (*targets, source) if name != STREAM and os.path.isfile(name)}  # noqa: PTH113
    for output in outputs:
        if output not in STDOUT_PATHS and os.path.realpath(output) in inputs:
            raise ConfigError(f"-o {path_text(output)}: would overwrite a mesh that is read; give another name")


def save_result(mesh: "Mesh | PolygonMesh", output: str, output_format: str | None) -> None:
    """Write a mesh; if it cannot be written, keep it in a temporary file, and say where.

    Raises:
        MeshError: it cannot be written, with the path of the temporary file.
    """
    from meshfit.mesh.io.files import save_mesh

    try:
        save_mesh(mesh, output, file_format=output_format)
    except BrokenPipeError:
        raise
    except (MeshError, OSError) as error:
        kept = Path(mkdtemp(prefix="meshfit-fit-"), "result.ply")
        save_mesh(mesh, kept)
        raise MeshError(f"{error}; the result is kept in {path_text(kept)}") from error
