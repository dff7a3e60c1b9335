"""The method `show` of meshes."""

from typing import TYPE_CHECKING, Any, cast

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from meshfit.mesh.mesh import Mesh
    from meshfit.mesh.polygons import PolygonMesh


class Showable:
    """Base of meshes, of triangles and of polygons, that can be shown."""

    def show(
        self,
        values: ArrayLike | None = None,
        *,
        label: str = "",
        edges: bool = False,
        up: str = "y",
        size: tuple[int, int] = (900, 600),
        image: bool | None = None,
    ) -> Any:  # noqa: ANN401  pyvista is optional
        """Show the mesh: in a window, in a notebook, or as an image where there is no display.

        Args:
            values: a number for each vertex, or for each face, that it is coloured by.
            label: of the colour bar.
            edges: draw the edges of faces.
            up: the axis that points up: `y` or `z`.
            size: width and height in pixels.
            image: return an image even where there is a display.

        Returns:
            A PIL image, the view of a notebook, or pyvista's plotter.

        Raises:
            ConfigError: pyvista is not installed, which the extra `report` brings.
            MeshError: a wrong number of values.
        """
        from meshfit.mesh.show import show_meshes

        meshes = {"mesh": cast("Mesh | PolygonMesh", self)}  # no other class has this base
        return show_meshes(meshes, values=values, label=label, edges=edges, up=up, size=size, image=image)
