"""`meshfit targets`: list the named targets."""

import json

import typer
from rich.table import Table

from meshfit.cli.console import out
from meshfit.cli.options import AsJson


def targets(as_json: AsJson = False) -> int:
    """List the named targets.

    Any mesh file (.obj, .ply, .stl, .off, .glb, .gltf) works as a target too, and any file of points (.ply, .xyz, .pcd,
    .las and the like) for the Gauss–Newton engine; so does a folder of images with cameras, such as `meshfit views`
    writes.

    Example:
        meshfit targets
    """
    from meshfit.mesh.targets import NAMED_TARGETS, load_target

    meshes = {name: load_target(name) for name in NAMED_TARGETS}
    if as_json:
        rows = [
            {"name": name, "title": named.title, "verts": meshes[name].num_verts, "faces": meshes[name].num_faces}
            | {"origin": named.origin, "sha256": named.sha256}
            for name, named in NAMED_TARGETS.items()
        ]
        typer.echo(json.dumps(rows, indent=2))
        return 0
    table = Table(box=None, pad_edge=False)
    table.add_column("target", style="bold")
    table.add_column("vertices", justify="right")
    table.add_column("faces", justify="right")
    table.add_column("origin")
    for name, named in NAMED_TARGETS.items():
        table.add_row(name, f"{meshes[name].num_verts:,}", f"{meshes[name].num_faces:,}", named.origin)
    out.print(table)
    return 0
