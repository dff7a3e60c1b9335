"""Control meshes that take their topology from a target: the target with few faces, or a wrap around it.

A control mesh keeps the pieces, handles, cavities and openings of its target, which no fit from a sphere can make.
"""

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from meshfit.errors import MeshError
from meshfit.mesh.cleaning_options import Surface
from meshfit.mesh.enclosure import enclosed_volume
from meshfit.mesh.geometry import bounding_box_diagonal, face_areas, signed_volume
from meshfit.mesh.manifold import describe_topology, euler_number
from meshfit.mesh.mesh import Mesh, SameContent, Verts
from meshfit.mesh.meshlab import alpha_wrap, decimate, fill_holes, refine_long_edges
from meshfit.mesh.noise import is_very_noisy, noise_of_points
from meshfit.mesh.outliers import stray_points
from meshfit.mesh.pieces import crossing_faces, manifold_pieces, piece_of_face
from meshfit.mesh.point_cloud import PointCloud, evenly_spread, is_at_rim
from meshfit.mesh.sampling import sample_surface
from meshfit.mesh.thinning import thinned
from meshfit.mesh.topology import NONE, Indices, Mask, Topology
from meshfit.units import count_text

Origin = Literal["target", "closed", "open", "wrap", "auto"]
ORIGINS: tuple[Origin, ...] = ("target", "closed", "open", "wrap", "auto")
"""Names of sources that are made from the target."""
USUAL_VERTS = 2562
"""Vertices of a control mesh where no number is set: a quarter of the usual result, less its rounding."""

# A target may be a soup, to be wrapped, if more than these shares of its faces cross others of their piece, or others
# at all; or if more than this share of its area is in open pieces of fewer faces.
_CROSSING_WITHIN, _CROSSING = 0.05, 0.25
_CRUMBS, _FEWEST_FACES = 0.25, 12
# It is one whatever the wrap is like if more than these shares of its faces cross within pieces, or of its area are in
# such small pieces. Otherwise a wrap is not taken if its distance from the target is more than so many times that of
# the target with few faces, and so many offsets: around gaps that it closes and crossings that it rounds.
_HOPELESS_WITHIN, _HOPELESS_CRUMBS = 0.25, 0.5
_MANY_TIMES, _MANY_OFFSETS = 5.0, 1.5
# Crossings are counted on at most so many faces: those of the decimated target, if it has more.
_COUNTED = 60_000
# More than this many times as many faces as are counted, or wanted, are thinned before they are decimated.
_SPARE = 3
# Edges longer than this many of the wanted ones are halved before decimation, so that flat parts get vertices too.
_LONG_EDGE = 0.75
# Attempts to get no more than the wanted number of vertices, and the fewest faces of a closed piece.
_ATTEMPTS, _LEAST_CLOSED = 4, 4
# A closed surface of many handles has at least so many faces per unit of its Euler number where no vertex has more than
# 9 edges; with fewer, it crosses itself all over.
_FACES_PER_EULER = 6
# Wraps are tried with these multiples of the shortest alpha, which is this share of the diagonal; for a cloud, at least
# so many times the median distance of a point from such a neighbour. The offset is this share of alpha. A wrap of more
# vertices is not followed by a finer one, which would have several times as many: half a minute for crumbs.
_MULTIPLES, _MANY_VERTS = (4.0, 2.0, 1.0), 10_000
_LEAST_ALPHA, _REACHES, _NEIGHBOURS, _OFFSET = 0.01, 2.0, 6, 1 / 30
# A wrap of a cloud that is thinner than this share of alpha and so many standard deviations of the noise may have
# entered through a gap, and lie on both sides of the points. Alpha then rises by this factor, up to this share of the
# diagonal, until the gap is closed: the wrap is no longer thin, and so many times as thick as the last.
_ENTERED, _DEVIATIONS, _RISE, _MOST_ALPHA, _CLOSED = 0.5, 4.0, 1.5, 0.25, 2.0
# Whether that is so is seen from the wrap after so many rises, which takes a tenth of the time of the first one.
_PROBED = 3
# Wraps whose distance is at most so many times the least are equally near; a wrap that is thinner than so many offsets
# has entered through a gap, and lies on both sides. So has one of faces of which this share of the thickness is left.
_EQUALLY_NEAR, _THIN, _DROPPED = 1.5, 4.0, 0.6
_SAMPLES = 5000
# A cloud is open if it does not show more than this share of a closed surface around it.
_MOST_UNSEEN = 0.25
# Points of a cloud that are looked at, and the least share of them at a rim where it may be open.
_RIM_SAMPLES, _LEAST_RIM = 1000, 0.01
# Points of a cloud that are wrapped; more take longer, and show no more at the shortest alpha.
_MOST_WRAPPED = 100_000


@dataclass(frozen=True)
class Wrap:
    """Lengths of an alpha wrap, in the target's normalised frame; None chooses one.

    Attributes:
        alpha: gaps below it are closed.
        offset: distance of the wrap from the target.
    """

    alpha: float | None = None
    offset: float | None = None


@dataclass(frozen=True, eq=False)
class ControlMesh:
    """A control mesh made from a target.

    Attributes:
        mesh: oriented manifold pieces.
        made_from: `target`, `wrap`, `points` for an open surface through a cloud, or `hull` for the visual hull of
            images.
        reason: why, in words.
        wrap: alpha and offset of the wrap.
    """

    mesh: Mesh
    made_from: Literal["target", "points", "wrap", "hull"]
    reason: str
    wrap: Wrap | None = None

    @property
    def record(self) -> dict[str, Any]:
        """Plain data for the result of a trial."""
        record: dict[str, Any] = {"made_from": self.made_from, "reason": self.reason}
        if self.wrap is not None:
            record["wrap"] = {"alpha": self.wrap.alpha, "offset": self.wrap.offset}
        return record | {"control_verts": self.mesh.num_verts, "control_faces": self.mesh.num_faces}

    @property
    def line(self) -> str:
        """One line for the log."""
        size = f"{count_text(self.mesh.num_verts, 'vertex')}, {count_text(self.mesh.num_faces, 'face')}"
        wrap = "" if self.wrap is None else f", alpha {self.wrap.alpha:.3g}, offset {self.wrap.offset:.3g}"
        topology = describe_topology(Topology.of(self.mesh))
        return f"source: from the {self.made_from} ({self.reason}){wrap}: {size}; {topology}"


def control_mesh_of(
    target: Mesh | PointCloud,
    origin: Origin = "auto",
    *,
    verts: int | None = None,
    faces: int | None = None,
    wrap: Wrap | None = None,
    surface: Surface = "all",
) -> ControlMesh:
    """Make a control mesh from a target; the same target and arguments give the same bytes in any process.

    Args:
        target: faces of any kind, or a cloud of points.
        origin: `target` decimates the target itself; `closed` fills its holes before; `wrap` makes one closed surface
            around it, which is decimated; `open` lays an open surface through the points of a cloud; `auto` takes the
            target unless it is a cloud, or a soup of crumbs or of faces that cross each other, around which a wrap lies
            close; and an open surface where a cloud shows too little of its wrap.
        verts: about the largest number of vertices; more where topology needs them.
        faces: number of faces instead; a target with fewer keeps its own.
        wrap: lengths of the wrap.
        surface: the part of a target that this is: where an outer surface is in open pieces, `auto` makes one skin.

    Raises:
        MeshError: nothing to make it from.
    """
    if not isinstance(target, PointCloud):
        if origin == "open":
            raise MeshError("the target has faces, which tell where it is open; use source.mesh: target")
        return _made(SameContent(target), origin, verts, faces, wrap or Wrap(), surface)
    unseen = _unseen(*_contents(target)) if origin == "auto" else 0.0
    if origin == "open" or unseen > _MOST_UNSEEN:
        reason = f"an open cloud: it shows {1 - unseen:.0%} of a closed surface around it"
        sheet = _reduced(open_sheet(target), verts, faces)
        return ControlMesh(sheet, "points", "as set" if origin == "open" else reason)
    return _made(SameContent(Mesh(target.verts, [])), origin, verts, faces, wrap or Wrap(), surface)


@lru_cache(maxsize=8)  # the schemes and seeds of a target start from one control mesh
def _made(
    content: SameContent, origin: Origin, verts: int | None, faces: int | None, wrap: Wrap, surface: Surface
) -> ControlMesh:
    target = content.mesh
    if not target.num_verts:
        raise MeshError("the target has no vertices")
    if not target.num_faces and origin in ("target", "closed"):
        raise MeshError("the target is a cloud of points, without faces to start from; use source.mesh: wrap or auto")
    reason, few = "as set", None
    pieces = manifold_pieces(target) if target.num_faces else target
    if origin == "auto":
        count, is_closed = piece_of_face(pieces)[0], Topology.of(pieces).is_watertight
        if surface == "outer" and count > 1 and not is_closed:
            origin, reason = "wrap", f"one skin around an outer surface in {count} open pieces"
        else:
            few = _with_few_faces(pieces)
            origin, reason, is_certain = _choice(pieces, few)
            if not is_certain:
                own = _reduced(pieces, verts, faces, few)
                skin, lengths = _wrapped(SameContent(target), wrap)
                skin = _reduced(skin, verts, faces)
                is_near, distances = _is_near(skin, lengths, own, pieces)
                reason = f"{reason}; {distances}"
                return ControlMesh(skin, "wrap", reason, lengths) if is_near else ControlMesh(own, "target", reason)
    if origin == "closed":
        filled = manifold_pieces(fill_holes(pieces))
        return ControlMesh(_reduced(filled, verts, faces), "target", "as set, with its holes filled")
    if origin == "target":
        few = few or _with_few_faces(pieces)
        return ControlMesh(_reduced(pieces, verts, faces, few), "target", reason)
    if not target.num_faces:
        target = _to_wrap(target.verts)
    skin, lengths = _wrapped(SameContent(target), wrap)
    return ControlMesh(_reduced(skin, verts, faces), "wrap", reason, lengths)


def unseen_of_open_cloud(cloud: PointCloud) -> float:
    """Return the share of a closed surface around a cloud that it does not show, where `auto` makes an open source.

    It is 0 for other clouds. Those with hardly a rim are not wrapped to find out.
    """
    rows = np.sort(np.random.default_rng(0).permutation(cloud.num_verts)[:_RIM_SAMPLES])
    if is_at_rim(cloud.verts, rows).mean() < _LEAST_RIM:
        return 0.0
    unseen = _unseen(*_contents(cloud))
    return unseen if unseen > _MOST_UNSEEN else 0.0


def open_sheet(cloud: PointCloud) -> Mesh:
    """Return an open surface through all points of a cloud but stray ones, with all of its vertices."""
    return _sheet(*_contents(cloud))


@lru_cache(maxsize=2)  # a control mesh is made of it, and a fit is drawn to its boundary
def _sheet(content: SameContent, normals: SameContent | None) -> Mesh:
    from meshfit.mesh.open_cloud import open_surface  # which wraps the points for their normals

    return open_surface(_without_stray(content, normals))


@lru_cache(maxsize=2)
def _unseen(content: SameContent, normals: SameContent | None) -> float:
    """Return the share of a closed surface around a cloud that it does not show."""
    from meshfit.mesh.open_cloud import unseen_share  # which wraps the points for their normals

    wrap, lengths = _wrapped(SameContent(_to_wrap(content.mesh.verts)), Wrap())
    assert lengths.alpha is not None  # noqa: S101  chosen
    return unseen_share(_without_stray(content, normals), wrap, lengths.alpha)


def _contents(cloud: PointCloud) -> tuple[SameContent, SameContent | None]:
    normals = None if cloud.normals is None else SameContent(Mesh(cloud.normals, []))
    return SameContent(Mesh(cloud.verts, [])), normals


def _without_stray(content: SameContent, normals: SameContent | None) -> PointCloud:
    cloud = PointCloud(content.mesh.verts, None if normals is None else normals.mesh.verts).thinned()
    return cloud.subset(np.flatnonzero(~stray_points(cloud.verts)))


def _to_wrap(points: Verts) -> Mesh:
    """Return the points of a cloud that are wrapped: those of a fit, and of many, as many as show the shape."""
    points = PointCloud(points).thinned().verts
    points = points[~stray_points(points)]
    noise = noise_of_points(points)
    if is_very_noisy(points, noise):
        from meshfit.mesh.denoised_cloud import denoised_cloud  # which wraps the points for their normals

        points = denoised_cloud(PointCloud(points), noise).verts
    return Mesh(points[evenly_spread(points, _MOST_WRAPPED)], [])


def _with_few_faces(pieces: Mesh) -> Mesh:
    """Return pieces that a count of crossings takes no long time on: decimated if they have many faces."""
    return pieces if pieces.num_faces <= _COUNTED else manifold_pieces(_decimated(pieces, _COUNTED))


def _choice(pieces: Mesh, few: Mesh) -> tuple[Literal["target", "wrap"], str, bool]:
    """Choose between the target and a wrap; crossings are counted on the target with few faces.

    Returns:
        The choice, the reason, and whether it is certain, or depends on how near the wrap is.
    """
    if not pieces.num_faces:
        return "wrap", "a cloud of points", True
    count, piece = piece_of_face(pieces)
    small = (np.bincount(piece, minlength=count) < _FEWEST_FACES)[piece] & _is_open(pieces, count, piece)[piece]
    areas = face_areas(pieces)
    crumbs = float(areas[small].sum() / areas.sum())
    # A box or a card has few faces, and is no crumb.
    if crumbs > _CRUMBS and count > _FEWEST_FACES:
        reason = f"{crumbs:.0%} of the area is in open pieces of fewer than {_FEWEST_FACES} faces"
        return ("wrap", f"a soup: {reason}", True) if crumbs > _HOPELESS_CRUMBS else ("wrap", reason, False)
    crossing, within = (float(mask.mean()) for mask in crossing_faces(few))
    if within > _CROSSING_WITHIN:
        reason = f"{within:.1%} of the faces cross others of their own piece"
        return ("wrap", f"a soup: {reason}", True) if within > _HOPELESS_WITHIN else ("wrap", reason, False)
    if crossing > _CROSSING and not Topology.of(pieces).is_watertight:  # closed ones may cross in a fit as well
        return "wrap", f"{crossing:.0%} of the faces cross others", False
    if not crossing:
        return "target", "sound: oriented manifold pieces without crossings", True
    where = "within pieces" if within else "between pieces only"
    return "target", f"sound: oriented manifold pieces; {crossing:.1%} of the faces cross, {where}", True


def _is_near(wrap: Mesh, lengths: Wrap, own: Mesh, pieces: Mesh) -> tuple[bool, str]:
    """Return whether a wrap lies about as close to a target as the target with few faces does, and the distances."""
    from meshfit.mesh.proximity import point_distances  # brings libigl

    def distance_of(mesh: Mesh) -> float:
        points = sample_surface(mesh, _SAMPLES, np.random.default_rng(0)).points
        return float(np.sqrt((point_distances(pieces, points) ** 2).mean()))

    around, decimated = distance_of(wrap), distance_of(own)
    assert lengths.offset is not None  # noqa: S101  chosen
    is_near = around <= max(_MANY_TIMES * decimated, _MANY_OFFSETS * lengths.offset)
    percent = 100 / bounding_box_diagonal(pieces.verts)
    return is_near, (
        f"a wrap is {around * percent:.3f} % of the diagonal off the target, which with few faces is "
        f"{decimated * percent:.3f} % off"
    )


def _is_open(mesh: Mesh, count: int, piece: Indices) -> Mask:
    """Return (count,) which pieces have a boundary."""
    topology = Topology.of(mesh)
    is_open = np.zeros(count, dtype=bool)
    is_open[piece[topology.face_of(np.flatnonzero(topology.twin == NONE))]] = True
    return is_open


def _reduced(mesh: Mesh, verts: int | None, faces: int | None, few: Mesh | None = None) -> Mesh:
    """Decimate oriented manifold pieces, and separate them again; with `verts`, coarse faces are refined first.

    Args:
        mesh: the pieces.
        verts: about the largest number of vertices.
        faces: number of faces instead.
        few: the same pieces with fewer faces, to continue from where that is enough: it takes half the time.
    """
    if faces is not None:
        return manifold_pieces(_decimated(_enough(mesh, few, faces), faces)) if faces < mesh.num_faces else mesh
    wanted = USUAL_VERTS if verts is None else verts
    # By Euler's formula; a piece with a border has fewer faces for its vertices.
    number, piece = piece_of_face(mesh)
    euler, is_open = euler_number(Topology.of(mesh)), _is_open(mesh, number, piece)
    least = max(_LEAST_CLOSED, number + (_LEAST_CLOSED - 1) * int((~is_open).sum()))
    if not is_open.any():
        least = max(least, -_FACES_PER_EULER * euler)
    count = max(least, 2 * (wanted - euler))
    edge = math.sqrt(4 * float(face_areas(mesh).sum()) / (math.sqrt(3) * count))
    fine = (
        manifold_pieces(refine_long_edges(mesh, _LONG_EDGE * edge))
        if mesh.num_verts < 4 * wanted
        else _enough(mesh, few, count)
    )
    result = _with_at_most(fine, wanted, count, least, keep_rim=True)
    if result.num_verts > wanted and is_open.any():  # a long rim alone may have more vertices
        result = _with_at_most(fine, wanted, count, least, keep_rim=False)
    return result


def _with_at_most(fine: Mesh, wanted: int, faces: int, least: int, *, keep_rim: bool) -> Mesh:
    """Decimate to a number of faces; to fewer, down to the least, while there are more vertices than wanted."""
    result = fine
    for _ in range(_ATTEMPTS):
        if faces >= result.num_faces or result.num_verts <= wanted:
            break
        before, result = result.num_verts, manifold_pieces(_decimated(fine, faces, keep_rim=keep_rim))
        if faces == least or result.num_verts == before:
            break
        faces = max(least, faces - 2 * max(result.num_verts - wanted, 0))
    return result


def _decimated(mesh: Mesh, faces: int, *, keep_rim: bool = True) -> Mesh:
    """Decimate oriented manifold pieces, those of very many faces after thinning, which takes a fifth of the time."""
    most = _SPARE * max(faces, _COUNTED)
    return decimate(mesh if mesh.num_faces <= most else thinned(mesh, most), faces, keep_rim=keep_rim)


def _enough(mesh: Mesh, few: Mesh | None, faces: int) -> Mesh:
    """Return the mesh with few faces if it has more than a wanted number, else the whole one."""
    return few if few is not None and few.num_faces > faces else mesh


def wrap_around(target: Mesh) -> Mesh:
    """Return the closed surface around faces or points of which a control mesh is made, with all of its vertices."""
    return _wrapped(SameContent(target), Wrap())[0]


@lru_cache(maxsize=4)  # the normals of a cloud are those of the wrap that its control mesh is made of
def _wrapped(content: SameContent, wrap: Wrap) -> tuple[Mesh, Wrap]:
    """Wrap a target; of several alphas, take the wrap of least genus among the nearest, then the finest.

    Where a finer wrap enters through an opening, the openings are capped for it and for those after it.
    """
    target = content.mesh
    if wrap.alpha is not None:
        lengths = _lengths(wrap.alpha, wrap)
        return manifold_pieces(alpha_wrap(target, *lengths)), Wrap(*lengths)
    least = _closing_alpha(target, _least_alpha(target), wrap)
    points = sample_surface(target, _SAMPLES, np.random.default_rng(0)).points if target.num_faces else target.verts
    tried, wrapped = list[_Tried](), target
    for multiple in _MULTIPLES:
        entry = None
        for attempt in (wrapped, None):
            wrapped = fill_holes(manifold_pieces(target)) if attempt is None else wrapped
            entry = _solid_wrap(wrapped, points, _lengths(multiple * least, wrap), tried[0] if tried else None)
            if entry is not None or wrapped is not target:
                break
        if entry is None:
            break
        tried.insert(0, entry)
        if entry.surface.num_verts > _MANY_VERTS:
            break
    solid = [entry for entry in tried if not entry.is_thin] or tried[-1:]
    nearest = min(entry.distance for entry in solid)
    best = min((entry for entry in solid if entry.distance <= _EQUALLY_NEAR * nearest), key=lambda entry: -entry.euler)
    return best.surface, best.lengths


def _solid_wrap(target: Mesh, points: Verts, lengths: tuple[float, float], coarser: "_Tried | None") -> "_Tried | None":
    """Wrap a target; None if the wrap goes through an opening that a coarser one spans."""
    if coarser is not None and target.num_faces:
        # Wraps that enter have twice the area, and many times the vertices, and take seconds.
        volume = enclosed_volume(target, lengths[0])
        if volume < _DROPPED * signed_volume(coarser.surface):
            return None
    entry = _Tried.of(_skin(SameContent(target), *lengths), Wrap(*lengths), points)
    entered = coarser is not None and bool(target.num_faces) and entry.thickness < _DROPPED * coarser.thickness
    return None if entered else entry


@dataclass(frozen=True, eq=False)
class _Tried:
    """A wrap to choose from.

    Attributes:
        surface: the wrap.
        lengths: its alpha and offset.
        distance: from all but the farthest tenth of the target to it.
        thickness: of a plate of the same volume and area.
        euler: its Euler number.
    """

    surface: Mesh
    lengths: Wrap
    distance: float
    thickness: float
    euler: int

    @classmethod
    def of(cls, surface: Mesh, lengths: Wrap, points: Verts) -> "_Tried":
        """Measure a wrap at some points of its target."""
        from meshfit.mesh.proximity import point_distances  # brings libigl

        distance = float(np.quantile(point_distances(surface, points), 0.9))
        return cls(surface, lengths, distance, _thickness(surface), euler_number(Topology.of(surface)))

    @property
    def is_thin(self) -> bool:
        """Whether it has entered everywhere, and lies on both sides of its target."""
        assert self.lengths.offset is not None  # noqa: S101  chosen
        return self.thickness < _THIN * self.lengths.offset


def _lengths(alpha: float, wrap: Wrap) -> tuple[float, float]:
    return alpha, _OFFSET * alpha if wrap.offset is None else wrap.offset


def _least_alpha(target: Mesh) -> float:
    """Return the shortest alpha to try: for a cloud, no ball of this radius falls between neighbouring points."""
    least = _LEAST_ALPHA * bounding_box_diagonal(target.verts)
    if target.num_faces:
        return least
    points = np.unique(target.verts, axis=0)
    some = points[:: max(1, len(points) // _SAMPLES)]
    distances = np.asarray(cKDTree(points).query(some, k=min(_NEIGHBOURS + 1, len(points)))[0])
    return max(least, _REACHES * float(np.median(distances[:, -1])))


def _closing_alpha(target: Mesh, least: float, wrap: Wrap) -> float:
    """Return the shortest alpha whose wrap of a cloud stays outside; the least one if all or none of its wraps do.

    A wrap takes time by the inverse square of alpha, and more where it enters: long alphas are tried first, and those
    shorter than one that enters are not tried.
    """
    if target.num_faces:
        return least
    content, noise = SameContent(target), _DEVIATIONS * noise_of_points(target.verts)
    most = _MOST_ALPHA * bounding_box_diagonal(target.verts)
    alphas = [least]
    while _RISE * alphas[-1] < most:
        alphas.append(_RISE * alphas[-1])

    @cache
    def thickness(place: int) -> float:
        return _thickness(_skin(content, *_lengths(alphas[place], wrap)))

    def stays_outside(place: int) -> bool:
        return thickness(place) > _ENTERED * alphas[place] + noise

    probe = min(_PROBED, len(alphas) - 1)
    if stays_outside(probe) and stays_outside(0):
        return least
    tried = list[int]()
    for place in range(len(alphas) - 1, -1, -1):
        if place == probe - 1 and not any(map(stays_outside, tried)) and stays_outside(0):
            return least  # a thin body, whose longer wraps are thin for their alpha
        tried.insert(0, place)
        if len(tried) > 1 and stays_outside(tried[1]) and not stays_outside(place):
            break
    closing = (
        place for place in tried[1:] if stays_outside(place) and thickness(place) > _CLOSED * thickness(place - 1)
    )
    return alphas[next(closing, 0)]


def _thickness(surface: Mesh) -> float:
    """Return that of a plate of the same volume and area."""
    return 2 * signed_volume(surface) / float(face_areas(surface).sum())


@lru_cache(maxsize=4)  # the wrap that shows whether alpha is long enough is one of those to choose from
def _skin(content: SameContent, alpha: float, offset: float) -> Mesh:
    return manifold_pieces(alpha_wrap(content.mesh, alpha, offset))
