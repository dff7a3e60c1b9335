"""Calls as users write them, for mypy: an ignored error that does not occur fails the check of types."""

import numpy as np
import trimesh

import meshfit


def calls(mesh: meshfit.Mesh, polygons: meshfit.PolygonMesh, settings: meshfit.GaussNewtonSettings) -> None:
    """Call the public functions; never run."""
    arrays = np.eye(3), np.array([[0, 1, 2]])
    result: meshfit.FitResult = meshfit.fit("sphere", "bunny", steps=5, losses={"edge": 0.5}, progress=True)
    meshfit.fit(mesh, arrays, method="gauss-newton", connectivity="fixed", levels=2)
    meshfit.fit(polygons, trimesh.Trimesh(), settings, optimizer={"name": "adam", "schedule": {"every": 5}})
    meshfit.fit(mesh, mesh, steps="5")  # type: ignore[arg-type]
    meshfit.fit(mesh, mesh, method="newton")  # type: ignore[arg-type]
    meshfit.fit(mesh, mesh, losses={"edges": 1.0})  # type: ignore[arg-type]
    meshfit.fit(mesh, None)  # type: ignore[arg-type]
    meshfit.fit_batch([meshfit.Problem(mesh, arrays, 3)], steps=5, samples=10)
    meshfit.fit_batch([], step=5)  # type: ignore[call-arg]
    measured: meshfit.Measurement = meshfit.measure(result, arrays, samples=1000)
    meshfit.measure(result, mesh, samples="many")  # type: ignore[arg-type]
    measured.to_dict()["hausdorff"]
    refined: meshfit.Mesh | meshfit.PolygonMesh = meshfit.subdivide(arrays, "loop")
    curves: meshfit.Curves = meshfit.subdivide(meshfit.Curves.through(arrays[0]), "four-point")
    triangles: meshfit.Mesh = meshfit.as_mesh(refined, triangles=True)
    meshfit.save_mesh(meshfit.frame_of(triangles, "box").restore(triangles), "result.ply")
    meshfit.save_curves(curves, "curves.obj")
    meshfit.frame_of(mesh, "unit")  # type: ignore[arg-type]
