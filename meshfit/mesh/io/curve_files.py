"""Curve files in and out: OBJ with `l` elements, PLY with `edge` elements."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshfit.errors import DomainError, MeshfitWarning
from meshfit.mesh.cleaning import require_finite_verts
from meshfit.mesh.curves import Chains, Curves, join_segments
from meshfit.mesh.io.files import known_suffix, read_content, reading, write_content
from meshfit.mesh.io.ply import read_ply_segments
from meshfit.mesh.io.text import read_obj_segments

_READERS = {".obj": read_obj_segments, ".ply": read_ply_segments}
SUFFIXES = tuple(_READERS)


def load_curves(path: str | Path) -> Curves:
    """Read curves from an OBJ or PLY file: segments that share verts are joined to chains, as long as can be.

    A chain that ends where it starts is closed. Faces are passed over, and verts of no segment dropped.

    Example:
        >>> curves = load_curves("profile.obj")  # doctest: +SKIP

    Raises:
        MeshError: no such file, a suffix that is not known, a file that cannot be read or holds no curves, a coordinate
            that is not finite or beyond 1e60, a segment that indexes outside, or curves that branch.

    Warns:
        MeshfitWarning: with the count of verts that were dropped.
    """
    path = Path(path)
    suffix = known_suffix(path, SUFFIXES, "curve")
    content = read_content(path, SUFFIXES)
    with reading(path):
        verts, segments = _READERS[suffix](content)
    if not len(segments):
        what = "'l' lines" if suffix == ".obj" else "'edge' elements"
        raise DomainError(f"{path}: no curves in it, which {suffix[1:].upper()} has as {what}")
    require_finite_verts(verts, str(path))
    chains = join_segments(len(verts), segments, str(path))
    return _without_unused(verts, chains, str(path))


def save_curves(curves: Curves, path: str | Path) -> None:
    """Write curves in the format that its suffix names, in double precision; they are read back as they were.

    Raises:
        MeshError: a suffix that is not known, or a path that cannot be written.
    """
    path = Path(path)
    write_content(path, encode_curves(curves, known_suffix(path, SUFFIXES, "curve")))


def encode_curves(curves: Curves, suffix: str) -> bytes:
    """The bytes of a curve file of that suffix; the same curves give the same bytes."""
    return _obj(curves) if suffix == ".obj" else _ply(curves)


def _obj(curves: Curves) -> bytes:
    """A line for each chain; that of a closed one comes back to its first vertex."""
    verts = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in curves.verts.tolist())
    starts = np.cumsum(curves.sizes)[:-1]
    chains = [chain.tolist() for chain in np.split(curves.corners + 1, starts)] if len(curves.sizes) else []
    lines = [
        " ".join(map(str, [*chain, *chain[: int(closed)]])) for chain, closed in zip(chains, curves.closed, strict=True)
    ]
    return f"{verts}{''.join(f'l {line}' + chr(10) for line in lines)}".encode()


def _ply(curves: Curves) -> bytes:
    chains = Chains.of(curves)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {curves.num_verts}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element edge {curves.num_segments}\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    segments = np.stack([chains.tail, chains.head], axis=1)
    return header.encode() + curves.verts.astype("<f8").tobytes() + segments.astype("<i4").tobytes()


def _without_unused(verts: NDArray[np.float64], chains: Chains, origin: str) -> Curves:
    used = np.zeros(len(verts), dtype=bool)
    used[chains.corners] = True
    if not used.all():
        count = int((~used).sum())
        warnings.warn(f"{origin}: dropped {count} verts that no curve uses", MeshfitWarning, stacklevel=3)
    return Curves(verts[used], (np.cumsum(used) - 1)[chains.corners], chains.sizes, chains.closed)
