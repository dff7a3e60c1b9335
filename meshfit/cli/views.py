"""`meshfit views`: images of a mesh from cameras around it."""

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from meshfit.cli import completions
from meshfit.cli.console import out
from meshfit.cli.options import OUTPUT, MeshFormat, RepairMode, Weld, suggest_option
from meshfit.errors import ConfigError
from meshfit.paths import STREAM, is_pipe, path_text, shell_path
from meshfit.units import count_text


def views(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh file, name of a target, or - for standard input.",
            metavar="MESH",
            autocompletion=completions.targets,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Folder to write, which is created.",
            metavar="FOLDER",
            autocompletion=completions.folders,
        ),
    ],
    count: Annotated[
        int, typer.Option("--count", "-n", min=1, max=1000, help="Number of views, spread over a sphere.", metavar="N")
    ] = 12,
    size: Annotated[
        int, typer.Option("--size", min=8, max=4096, help="Width and height in pixels.", metavar="PIXELS")
    ] = 256,
    kind: Annotated[
        Literal["pinhole", "orthographic"],
        typer.Option("--kind", help="Projection of the cameras.", metavar="pinhole|orthographic"),
    ] = "pinhole",
    depth: Annotated[
        Literal["png", "exr", "npy"] | None,
        typer.Option(
            "--depth",
            help="Write depth maps: png in 16 bits with its unit, exr in 32-bit, or npy in 64-bit numbers.",
            show_default="none",
            metavar="png|exr|npy",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    normals: Annotated[
        bool,
        typer.Option(
            "--normals",
            help="Write normal maps in world axes, in the format of --depth, or as npy.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Replace the images that are in FOLDER; those that its transforms.json lists are removed.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    input_format: MeshFormat = None,
    weld: Weld = 0.0,
    repair: RepairMode = "split",
) -> int:
    """Render views of a mesh, as a folder of images to fit to.

    Cameras are spread evenly over a sphere around the mesh, as near as all see it whole, with y up. FOLDER gets
    images/*.png, shaded, whose alpha is the mask, and transforms.json with the cameras as NeRF, Blender and Nerfstudio
    read them. Depth is along the axis of view, in the unit of the mesh.
    Requires the extra: pip install 'meshfit[images]'.

    Examples:
        meshfit views bunny -o photos --count 12
        meshfit views scan.stl -o scanned --size 512 --kind orthographic
        meshfit views bunny -o photos --depth exr --normals --force  # replaces the images in photos
        meshfit fit photos -o animal.obj
    """
    from meshfit.images.files import listed_files, renamed, save_views
    from meshfit.images.folders import is_image_folder
    from meshfit.images.formats import require_writer
    from meshfit.images.rasteriser import render_view, shading
    from meshfit.images.sphere_cameras import cameras_around
    from meshfit.images.views import Views
    from meshfit.mesh.any_target import require_mesh
    from meshfit.mesh.cleaning import outward
    from meshfit.mesh.cleaning_options import CleaningOptions
    from meshfit.mesh.targets import NAMED_TARGETS, load_target, open_target

    if os.path.lexists(output) and not output.is_dir():
        raise ConfigError(f"-o {path_text(output)}: expected a folder, got a file; give another name")
    if is_image_folder(output) and not force:
        raise ConfigError(
            f"-o {path_text(output)}: has images already; give another name, or replace them with --force"
        )
    previous = listed_files(output)
    file_format = depth or "npy"
    require_writer(file_format)
    cleaning = CleaningOptions(weld, repair)
    with suggest_option("--format"):
        is_stream = mesh == STREAM or is_pipe(mesh)
        named = mesh in NAMED_TARGETS or not (is_stream or input_format)
        file = None if named else open_target(mesh, file_format=input_format)
        surface = outward(require_mesh(load_target(mesh, cleaning, file=file), mesh))
    cameras = cameras_around(surface, count, size, kind=kind)
    rendered = Views(renamed((render_view(surface, camera, depth=depth is not None) for camera in cameras), "view-"))
    shades = [shading(view) for view in rendered]
    if not normals:
        rendered = Views([view.without_normals() for view in rendered])
    written = save_views(output, rendered, shades, file_format)
    for path in set(previous) - set(written):
        path.unlink(missing_ok=True)
    parts = ["masks", *(["depth"] if depth else []), *(["normals"] if normals else [])]
    holding = f"{', '.join(parts)}, {size} × {size} pixels"
    out.print(f"wrote {path_text(output)}: {count_text(count, 'view')}, {holding}", soft_wrap=True, markup=False)
    command = f"meshfit fit {shell_path(output)} -o fitted.obj"
    out.print(f"to fit a mesh to them: {command}", soft_wrap=True, markup=False)
    return 0
