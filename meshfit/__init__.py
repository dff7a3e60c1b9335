"""meshfit: fit a subdivided source mesh to a target, measure it, and make the table.

The public names are loaded when they are first used, so that `import meshfit` is instant.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from meshfit.errors import MeshfitError, MeshfitWarning
    from meshfit.fitting.fit import fit, fit_batch
    from meshfit.fitting.loop import FitResult
    from meshfit.fitting.problem import Diverged, Problem
    from meshfit.measuring.measure import Measurement, measure
    from meshfit.mesh.curves import Curves
    from meshfit.mesh.io.files import load_curves, load_mesh, load_polygons, save_curves, save_mesh
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.normalisation import Frame, frame_of
    from meshfit.mesh.polygons import PolygonMesh
    from meshfit.mesh.targets import load_target
    from meshfit.subdivision.creases import Creases, creases_by_angle
    from meshfit.subdivision.limit import loop_limit, loop_limit_normals
    from meshfit.subdivision.refine import refine, subdivide
    from meshfit.subdivision.refinement import CurveRefinement, Refinement

_HOMES = {
    "MeshfitError": "meshfit.errors",
    "MeshfitWarning": "meshfit.errors",
    "Diverged": "meshfit.fitting.problem",
    "FitResult": "meshfit.fitting.loop",
    "Problem": "meshfit.fitting.problem",
    "fit": "meshfit.fitting.fit",
    "fit_batch": "meshfit.fitting.fit",
    "Measurement": "meshfit.measuring.measure",
    "measure": "meshfit.measuring.measure",
    "Curves": "meshfit.mesh.curves",
    "load_curves": "meshfit.mesh.io.files",
    "save_curves": "meshfit.mesh.io.files",
    "load_mesh": "meshfit.mesh.io.files",
    "load_polygons": "meshfit.mesh.io.files",
    "save_mesh": "meshfit.mesh.io.files",
    "Frame": "meshfit.mesh.normalisation",
    "frame_of": "meshfit.mesh.normalisation",
    "Mesh": "meshfit.mesh.mesh",
    "PolygonMesh": "meshfit.mesh.polygons",
    "load_target": "meshfit.mesh.targets",
    "Creases": "meshfit.subdivision.creases",
    "creases_by_angle": "meshfit.subdivision.creases",
    "loop_limit": "meshfit.subdivision.limit",
    "loop_limit_normals": "meshfit.subdivision.limit",
    "CurveRefinement": "meshfit.subdivision.refinement",
    "Refinement": "meshfit.subdivision.refinement",
    "refine": "meshfit.subdivision.refine",
    "subdivide": "meshfit.subdivision.refine",
}

__all__ = [
    "Creases",
    "CurveRefinement",
    "Curves",
    "Diverged",
    "FitResult",
    "Frame",
    "Measurement",
    "Mesh",
    "MeshfitError",
    "MeshfitWarning",
    "PolygonMesh",
    "Problem",
    "Refinement",
    "creases_by_angle",
    "fit",
    "fit_batch",
    "frame_of",
    "load_curves",
    "load_mesh",
    "load_polygons",
    "load_target",
    "loop_limit",
    "loop_limit_normals",
    "measure",
    "refine",
    "save_curves",
    "save_mesh",
    "subdivide",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401  whatever the name stands for
    if name == "__version__":
        return version("meshfit")
    if name not in _HOMES:
        raise AttributeError(f"module 'meshfit' has no attribute '{name}'")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
