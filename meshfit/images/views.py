"""Views of an object: an image's mask, perhaps its depth and normals, and the camera that took it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np
from jaxtyping import Bool, Float64

from meshfit.errors import ViewError
from meshfit.images.camera import Camera
from meshfit.mesh.normalisation import Frame
from meshfit.specs import suggest
from meshfit.units import count_text

Mask = Bool[np.ndarray, "H W"]
Depth = Float64[np.ndarray, "H W"]
NormalMap = Float64[np.ndarray, "H W 3"]


@dataclass(frozen=True, eq=False)
class View:
    """One image of an object and its camera. Arrays are read-only.

    Attributes:
        name: of the image, unique among views.
        camera: that took it.
        mask: (H, W) bool, True where the object is.
        depth: (H, W) float64, distance along the axis of view, NaN where it is not known; or None.
        normals: (H, W, 3) float64, unit normals of the surface in world axes, NaN where not known; or None.

    Example:
        >>> import meshfit
        >>> (camera,) = meshfit.cameras_around("bone", 1, size=64)
        >>> view = meshfit.render_view("bone", camera, "front", normals=False)
        >>> view
        View('front', pinhole, 64 × 64, mask, depth)
        >>> int(view.mask.sum())
        565

    Raises:
        ViewError: arrays of another size than the camera's image.
    """

    name: str
    camera: Camera
    mask: Mask
    depth: Depth | None = None
    normals: NormalMap | None = None

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        for noun, array, shape in (
            ("mask", self.mask, size),
            ("depth", self.depth, size),
            ("normals", self.normals, (*size, 3)),
        ):
            if array is None:
                continue
            if array.shape != shape:
                got = " × ".join(map(str, array.shape[1::-1])) or "no"
                raise ViewError(
                    f"view '{self.name}': its {noun} has {got} pixels, and its camera {size[1]} × {size[0]}"
                )
            array.setflags(write=False)

    def moved(self, frame: Frame) -> "View":
        """Return the view in normalised coordinates."""
        depth = None if self.depth is None else self.depth / frame.scale
        return replace(self, camera=self.camera.moved(frame), depth=depth)

    def without_normals(self) -> "View":
        """Return the view without its normals."""
        return replace(self, normals=None)

    def __repr__(self) -> str:
        """Return name, size and what there is."""
        parts = [
            "mask",
            *(["depth"] if self.depth is not None else []),
            *(["normals"] if self.normals is not None else []),
        ]
        return (
            f"View('{self.name}', {self.camera.kind}, {self.camera.width} × {self.camera.height}, {', '.join(parts)})"
        )


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Views(Sequence[View]):
    """Views of one object, in order.

    Example:
        >>> import meshfit
        >>> cameras = meshfit.cameras_around("bone", 4, size=64)
        >>> views = meshfit.Views([meshfit.render_view("bone", camera, f"{k}") for k, camera in enumerate(cameras)])
        >>> views
        Views(4 views, depth, normals)
        >>> views.held_out(1)
        (Views(3 views, depth, normals), Views(1 view, depth, normals))

    Raises:
        ViewError: there are none, or two of the same name.
    """

    views: tuple[View, ...]

    def __init__(self, views: Sequence[View]) -> None:
        object.__setattr__(self, "views", tuple(views))
        if not self.views:
            raise ViewError("there are no views; expected one or more")
        names = [view.name for view in self.views]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ViewError(f"two views are called '{twice}'; rename one")

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.views)

    def __iter__(self) -> Iterator[View]:
        """Iterate over the views."""
        return iter(self.views)

    @overload
    def __getitem__(self, index: int) -> View: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[View]: ...
    def __getitem__(self, index: int | slice) -> View | Sequence[View]:
        """Return a view, or some of them."""
        return self.views[index]

    def __repr__(self) -> str:
        """Return the number of views and what they hold."""
        return f"Views({', '.join([count_text(len(self), 'view'), *self.maps])})"

    @property
    def names(self) -> list[str]:
        """The names of the views."""
        return [view.name for view in self.views]

    @property
    def maps(self) -> tuple[str, ...]:
        """The maps that every view has besides its mask, of `depth` and `normals`."""
        return tuple(name for name, have in (("depth", self.have_depth), ("normals", self.have_normals)) if have)

    @property
    def have_depth(self) -> bool:
        """Whether every view has depth."""
        return all(view.depth is not None for view in self.views)

    @property
    def have_normals(self) -> bool:
        """Whether every view has normals."""
        return all(view.normals is not None for view in self.views)

    def moved(self, frame: Frame) -> "Views":
        """Return the views in normalised coordinates."""
        return Views([view.moved(frame) for view in self.views])

    def held_out(self, which: int | Sequence[str]) -> tuple["Views", "Views | None"]:
        """Return the views to fit, and those that are kept aside; None if none are.

        Args:
            which: a number of views, chosen evenly over their order, or names.

        Raises:
            ViewError: none would be left to fit, or there is no view of a name.
        """
        if isinstance(which, int):
            if not 0 <= which < len(self):
                most = count_text(len(self) - 1, "view")
                raise ViewError(f"hold_out: {which} of {count_text(len(self), 'view')}; at most {most} can be held out")
            rows = {(2 * k + 1) * len(self) // (2 * which) for k in range(which)}
        else:
            for name in which:
                if name not in self.names:
                    raise ViewError(f"hold_out: there is no view '{name}': {suggest(name, self.names)}")
            rows = {row for row, name in enumerate(self.names) if name in which}
            if len(rows) == len(self):
                raise ViewError("hold_out: these are all views; at least one has to be fitted")
        held = [view for row, view in enumerate(self.views) if row in rows]
        return Views([view for row, view in enumerate(self.views) if row not in rows]), Views(held) if held else None
