"""Attributes through subdivision: those of the finest vertices, faces and corners, from the coarse ones.

Vertex data are refined by the scheme's own operator, as the positions are. Faces inherit from their parents.

Corner data, such as texture coordinates, are face-varying: they are refined on the connectivity that is cut along
their seams, so that nothing crosses a seam. Inside a chart and at the boundary of the mesh, the scheme's own rules
hold; along a seam, values are interpolated linearly, so that both of its sides stay on their lines in the image.
(DeRose, Kass and Truong, Subdivision surfaces in character animation, 1998, refine such data by the scheme; linear
boundaries are one of OpenSubdiv's options for them.)

Schemes that make faces across edges, such as √3, make faces across seams too. If there are seams, the coordinates are
then linear on each coarse face, and a face across a seam has those of one side, up to the seam.
"""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.sparse import csr_array, diags_array, vstack

from meshfit.errors import MeshError, MeshfitWarning, SchemeError
from meshfit.mesh.attributes import Attributes, Values
from meshfit.mesh.interpolation import Operators, interpolated_rows
from meshfit.mesh.manifold import graph_components
from meshfit.mesh.mesh import Mesh
from meshfit.mesh.polygons import PolygonMesh
from meshfit.mesh.seams import at_verts, joined_edges
from meshfit.mesh.topology import NONE, Indices, Mask, PolygonTopology, Topology
from meshfit.subdivision.creases import Creases
from meshfit.subdivision.polygons.assemble import assemble_polygons
from meshfit.subdivision.polygons.scheme import LINEAR_SCHEMES, PolygonScheme, PolygonSplit
from meshfit.subdivision.polygons.splits import PolygonDivision, divide_polygons, polygon_parents
from meshfit.subdivision.push_back import carry_alpha, push_back
from meshfit.subdivision.triangles.assemble import assemble, linear_carry
from meshfit.subdivision.triangles.scheme import LINEAR_SCHEMES as LINEAR_TRIANGLE_SCHEMES
from meshfit.subdivision.triangles.scheme import Split, TriangleScheme
from meshfit.subdivision.triangles.splits import Division, divide, triangle_parents

_SPLITS_WITHIN_FACES = {Split.QUADRISECT, PolygonSplit.QUADS, PolygonSplit.TERNARY}
"""Each fine face lies in one coarse face, and the order of fine faces and corners follows that of the coarse ones."""

SurfaceScheme = TriangleScheme | PolygonScheme
SurfaceTopology = Topology | PolygonTopology


def refined_attributes(
    mesh: Mesh | PolygonMesh, scheme: SurfaceScheme, operators: Operators, creases: Creases | None = None
) -> Attributes:
    """Return the attributes of a refined mesh.

    Args:
        mesh: the coarse mesh.
        scheme: the scheme.
        operators: one for each level, from `refine`.
        creases: of the coarse mesh, if it has any.

    Warns:
        MeshfitWarning: the scheme makes faces across seams.
    """
    attributes = mesh.attributes
    if not attributes or not operators:
        return attributes
    levels = _Levels(_topology(mesh, scheme), scheme, len(operators), creases)
    corner = {
        name: _refined_corners(mesh, name, values, levels, operators) for name, values in attributes.corner.items()
    }
    parents = levels.parents
    return replace(
        attributes,
        vertex=interpolated_rows(attributes.vertex, operators),
        face={name: values[parents] for name, values in attributes.face.items()},
        corner=corner,
    )


@dataclass(frozen=True, eq=False)
class _Levels:
    """The connectivity of a mesh and of each of its levels, and a scheme for them."""

    coarsest: SurfaceTopology
    scheme: SurfaceScheme
    count: int
    creases: Creases | None

    @cached_property
    def topologies(self) -> list[SurfaceTopology]:
        """The connectivity of each level, coarsest first."""
        found = [self.coarsest]
        for step in range(self.count):
            found.append(_finer(found[-1], _divided(found[-1], self.scheme, step)))
        return found

    @cached_property
    def parents(self) -> Indices:
        """The coarsest face that each finest one descends from."""
        parents = np.arange(self.coarsest.num_faces)
        for step, topology in enumerate(self.topologies[:-1]):
            parents = parents[_parents(topology, self.scheme, step)]
        return parents

    @property
    def flat_operators(self) -> list[csr_array]:
        """The operator of each level by which the surface stays as it is; none where the split drops old vertices."""
        if self.scheme.split is PolygonSplit.DUAL:
            return []
        return [
            _linear(topology, self.scheme, _divided(topology, self.scheme, step))
            for step, topology in enumerate(self.topologies[:-1])
        ]

    @property
    def splits_within_faces(self) -> bool:
        """Whether each fine face lies in one coarse face."""
        return self.scheme.split in _SPLITS_WITHIN_FACES


@dataclass(frozen=True, eq=False)
class Chart:
    """A connectivity cut along the seams of some corner data, so that each of its vertices has one value.

    Attributes:
        topology: the same faces, with vertices of its own.
        origin: (W,) the vertex of the mesh that each one is a copy of.
        first: (W,) a corner with each vertex.
    """

    topology: SurfaceTopology
    origin: Indices
    first: Indices

    @classmethod
    def of(cls, topology: SurfaceTopology, values: Values) -> "Chart | None":
        """Cut a connectivity; None if the data have no seams."""
        same = joined_edges(topology, values)
        if bool(same[topology.twin != NONE].all()):
            return None
        corner = np.flatnonzero(same)
        twin = topology.twin[corner]
        ends = topology.following(np.concatenate([twin, corner]))
        count, vert = graph_components(np.concatenate([corner, twin]), ends, len(topology.tail))
        first = np.empty(count, dtype=np.int64)
        first[vert[::-1]] = np.arange(len(vert))[::-1]
        return cls(_with_corners(topology, vert, count), topology.tail[first], first)

    def on_seams(self, mesh: SurfaceTopology) -> Mask:
        """(C,) which half-edges lie on a seam; the others at the boundary of the chart are at that of the mesh."""
        return np.asarray((self.topology.twin == NONE) & (mesh.twin != NONE))

    def creases(self, mesh: SurfaceTopology, creases: Creases | None) -> Creases | None:
        """Return the creases of the chart: those of the mesh."""
        if creases is None:
            return None
        sharpness = np.zeros(self.topology.num_edges)
        sharpness[self.topology.edge_of] = creases.sharpness[mesh.edge_of]
        return Creases(sharpness, creases.corners[self.origin])


def _refined_corners(
    mesh: Mesh | PolygonMesh, name: str, values: Values, levels: _Levels, operators: Operators
) -> Values:
    """Return the values at the finest corners."""
    chart = Chart.of(levels.coarsest, values)
    if chart is None:
        fine = interpolated_rows({name: at_verts(levels.coarsest, values)}, operators)[name]
        return np.asarray(fine[levels.topologies[-1].tail])
    if not levels.splits_within_faces:
        return _projected_corners(mesh, name, values, levels, operators)
    rows = interpolated_rows({name: values[chart.first]}, _on_chart(chart, levels))[name]
    return np.asarray(rows[_finest_chart(chart, levels).tail])


def _projected_corners(
    mesh: Mesh | PolygonMesh, name: str, values: Values, levels: _Levels, operators: Operators
) -> Values:
    """Return the values at corners of faces that lie across seams, which end at the seam for such a face.

    Warns:
        MeshfitWarning: there are such faces, unless two √2 splits, which are one split of quads, have been made.
    """
    from meshfit.mesh.projection import projected_attributes  # brings libigl

    flat = levels.flat_operators or operators
    places = np.asarray(mesh.verts)
    for operator in flat:
        places = operator @ places
    finest = PolygonTopology.of(fine) if isinstance(fine := levels.topologies[-1], Topology) else fine
    surface = mesh.with_attributes(Attributes(corner={name: values}))
    triangles = surface if isinstance(surface, Mesh) else surface.triangulated()
    if levels.scheme.split is not PolygonSplit.SQRT2 or levels.count % 2:
        (noun,) = surface.attributes.described()
        text = f"{noun}: this scheme makes faces across seams, where they end at the seam, with a jagged edge"
        warnings.warn(f"{text}; schemes such as loop or catmull-clark keep seams smooth", MeshfitWarning, stacklevel=2)
    fine_mesh = PolygonMesh(places, finest.corners, finest.sizes)
    return projected_attributes(fine_mesh, fine_mesh.verts, triangles).corner[name]


def _finest_chart(chart: Chart, levels: _Levels) -> SurfaceTopology:
    topology = chart.topology
    for step in range(levels.count):
        topology = _finer(topology, _divided(topology, levels.scheme, step))
    return topology


def _on_chart(chart: Chart, levels: _Levels) -> list[csr_array]:
    """Return the operator of each level on a chart: linear along seams, by the scheme elsewhere."""
    scheme, topology, operators = levels.scheme, chart.topology, list[csr_array]()
    if scheme.alpha is not None and np.ndim(scheme.alpha):
        scheme = scheme.with_alpha(np.asarray(scheme.alpha)[chart.origin])
    creases = chart.creases(levels.coarsest, levels.creases)
    if creases is None and levels.coarsest.is_watertight:
        scheme = _with_linear_boundary(scheme)  # no edge but those on seams is at the boundary
    for step, mesh in enumerate(levels.topologies[:-1]):
        division = _divided(topology, scheme, step)
        linear, seam = _linear(topology, scheme, division), _seam_verts(topology, mesh, division)
        try:
            operators.append(_linear_at_seams(topology, scheme, division, creases, linear, seam))
        except (MeshError, SchemeError):  # the scheme has no rule for this chart, as it has for the mesh
            operators.append(linear)
        scheme = carry_alpha(scheme, partial(_linear, topology, scheme, division))
        topology = _finer(topology, division)
        if creases is not None and isinstance(topology, Topology):
            creases = creases.finer(topology.num_verts, topology.edges)
    return operators


def _linear_at_seams(
    topology: SurfaceTopology,
    scheme: SurfaceScheme,
    division: Division | PolygonDivision,
    creases: Creases | None,
    linear: csr_array,
    seam: Mask,
) -> csr_array:
    """Return the operator of one level: linear at the fine vertices on seams, by the scheme elsewhere."""

    def mixed(smooth: csr_array) -> csr_array:
        return csr_array(diags_array(~seam * 1.0) @ smooth + diags_array(seam * 1.0) @ linear)

    num_verts = topology.num_verts
    if isinstance(topology, Topology):
        assert isinstance(scheme, TriangleScheme)  # noqa: S101  `_topology` has chosen it
        assert isinstance(division, Division)  # noqa: S101
        if scheme.takes_creases:  # what is pushed back depends on where old vertices go
            tagged = Creases.of(topology) if creases is None else creases
            creases = Creases(tagged.sharpness, tagged.corners | seam[:num_verts])
        return mixed(assemble(topology, scheme, division, creases))
    assert isinstance(scheme, PolygonScheme)  # noqa: S101
    assert isinstance(division, PolygonDivision)  # noqa: S101
    operator = mixed(assemble_polygons(topology, replace(scheme, alpha=None), division))
    if scheme.alpha is None:
        return operator
    even, odd = push_back(scheme.alpha, linear[num_verts:], operator[:num_verts], operator[num_verts:])
    return csr_array(vstack([even, odd], format="csr"))


def _with_linear_boundary(scheme: SurfaceScheme) -> SurfaceScheme:
    if isinstance(scheme, PolygonScheme):
        return replace(scheme, boundary=LINEAR_SCHEMES[scheme.split].boundary)
    boundary, special = LINEAR_TRIANGLE_SCHEMES[scheme.split].boundary, scheme.at_valence3
    return replace(
        scheme, boundary=boundary, at_valence3=None if special is None else replace(special, boundary=boundary)
    )


def _seam_verts(topology: SurfaceTopology, mesh: SurfaceTopology, division: Division | PolygonDivision) -> Mask:
    """Return the fine vertices of a chart that lie on seams."""
    seam = (topology.twin == NONE) & (mesh.twin != NONE)
    verts = np.zeros(topology.num_verts + division.num_new, dtype=bool)
    verts[topology.tail[seam]] = verts[topology.head[seam]] = True
    for place in division.border_place:
        verts[topology.num_verts + place[seam[division.border]]] = True
    return verts


def _topology(mesh: Mesh | PolygonMesh, scheme: SurfaceScheme) -> SurfaceTopology:
    if isinstance(mesh, PolygonMesh):
        return PolygonTopology.of(mesh)
    triangles = Topology.of(mesh)
    return PolygonTopology.of(triangles) if isinstance(scheme, PolygonScheme) else triangles


def _with_corners(topology: SurfaceTopology, corners: Indices, num_verts: int) -> SurfaceTopology:
    """Return the same faces with other vertices."""
    if isinstance(topology, Topology):
        return Topology(num_verts, corners.reshape(-1, 3))
    return PolygonTopology(num_verts, corners, topology.sizes)


def _divided(topology: SurfaceTopology, scheme: SurfaceScheme, step: int) -> Division | PolygonDivision:
    if isinstance(topology, Topology):
        assert isinstance(scheme, TriangleScheme)  # noqa: S101  `_topology` has chosen it
        return divide(topology, scheme.split, step)
    assert isinstance(scheme, PolygonScheme)  # noqa: S101
    return divide_polygons(topology, scheme.split, step)


def _finer(topology: SurfaceTopology, division: Division | PolygonDivision) -> SurfaceTopology:
    if isinstance(division, PolygonDivision):
        return division.finer
    return Topology(topology.num_verts + division.num_new, division.faces)


def _parents(topology: SurfaceTopology, scheme: SurfaceScheme, step: int) -> Indices:
    if isinstance(topology, Topology):
        assert isinstance(scheme, TriangleScheme)  # noqa: S101  `_topology` has chosen it
        return triangle_parents(topology, scheme.split)
    assert isinstance(scheme, PolygonScheme)  # noqa: S101
    return polygon_parents(topology, scheme.split, step)


def _linear(topology: SurfaceTopology, scheme: SurfaceScheme, division: Division | PolygonDivision) -> csr_array:
    """Return the operator of linear interpolation, for splits that keep old vertices."""
    if isinstance(topology, Topology):
        assert isinstance(division, Division)  # noqa: S101  of the same domain
        return linear_carry(topology, division)
    assert isinstance(scheme, PolygonScheme)  # noqa: S101
    assert isinstance(division, PolygonDivision)  # noqa: S101
    return assemble_polygons(topology, LINEAR_SCHEMES[scheme.split], division)
