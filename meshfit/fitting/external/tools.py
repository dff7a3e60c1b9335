"""Ready entries of `fit.tool`: the options of each, and the package that it needs. No library is imported here."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import Field

from meshfit.errors import TrialError
from meshfit.settings import Settings

ToolName = Literal["poisson", "alpha-wrap", "quadric", "nricp", "pycpd", "meshmonk", "reach-for-the-spheres"]
Verts = Annotated[int, Field(ge=4)] | None
Share = Annotated[float, Field(gt=0, lt=1)]
Positive = Annotated[float, Field(gt=0)]


class PoissonOptions(Settings):
    """Options of `poisson`."""

    samples: Annotated[int, Field(ge=100)] = 100_000
    """Number of points with normals on the target, uniform by area, that the surface is made from; of a target of
    points, all are taken."""
    depth: Annotated[int, Field(ge=3, le=12)] = 8
    """Depth of the octree (3 to 12)."""
    point_weight: Annotated[float, Field(ge=0)] = 4.0
    """Weight (0 or more) of interpolating the points."""
    verts: Verts = None
    """Number of vertices that the result is decimated to, or null to keep all."""


class AlphaWrapOptions(Settings):
    """Options of `alpha-wrap`."""

    alpha: Share = 0.01
    """Size of the gaps that are closed, as a share of the target's diagonal."""
    offset: Share = 0.001
    """Distance of the wrap from the target, as a share of the target's diagonal."""
    verts: Verts = None
    """Number of vertices that the result is decimated to, or null to keep all."""


class QuadricOptions(Settings):
    """Options of `quadric`."""

    verts: Annotated[int, Field(ge=4)] = 10242
    """Number of vertices that the target is decimated to."""


class NricpOptions(Settings):
    """Options of `nricp`."""

    variant: Literal["amberg", "sumner"] = "amberg"
    """Method: `amberg` (2007) or `sumner` (2004)."""
    distance: Positive = 1.0
    """Distance, in the normalised frame, beyond which nearest points are no match."""


class CpdOptions(Settings):
    """Options of `pycpd`."""

    points: Annotated[int, Field(ge=10)] = 4000
    """Number of points on the target, uniform by area."""
    alpha: Positive = 0.1
    """Weight of smoothness."""
    beta: Positive = 0.3
    """Width of the Gaussian kernel of the deformation, in the normalised frame."""
    eigenvectors: Annotated[int, Field(ge=10)] = 300
    """Number of eigenvectors of the kernel that are kept."""
    iterations: Annotated[int, Field(ge=1)] = 100
    """Largest number of iterations."""


class MeshMonkOptions(Settings):
    """Options of `meshmonk`."""

    variant: Literal["pyramid", "nonrigid"] = "pyramid"
    """Registration: `pyramid`, coarse to fine, or `nonrigid` at full resolution."""
    iterations: Annotated[int, Field(ge=1)] = 90
    """Number of iterations."""


class SpheresOptions(Settings):
    """Options of `reach-for-the-spheres`."""

    grid: Annotated[int, Field(ge=5, le=200)] = 40
    """Number of signed distances (5 to 200) along each axis of the grid that the surface is made from."""
    edge: Positive | None = None
    """Smallest edge length, in the normalised frame, or null for the method's own."""


@dataclass(frozen=True)
class Tool:
    """A ready entry.

    Attributes:
        package: the package that it needs, whose version is recorded.
        requires: modules that must be installed.
        options: the model of its options.
        seeded: whether the result depends on the seed.
        points: whether the target may be a cloud of points.
        title: what it does, in a few words.
        from_target: whether it makes its result from the target alone, whatever the source.
    """

    package: str
    requires: tuple[str, ...]
    options: type[Settings]
    seeded: bool
    title: str
    from_target: bool = False
    points: bool = False

    @property
    def version(self) -> str:
        """The package and its installed version; without one where it is not installed."""
        try:
            return f"{self.package} {version(self.package)}"
        except PackageNotFoundError:
            return self.package


TOOLS: Mapping[ToolName, Tool] = MappingProxyType(
    {
        "poisson": Tool(
            "pymeshlab",
            (),
            PoissonOptions,
            seeded=True,
            title="screened Poisson surface through points of the target",
            from_target=True,
            points=True,
        ),
        "alpha-wrap": Tool(
            "pymeshlab",
            (),
            AlphaWrapOptions,
            seeded=False,
            title="alpha wrap around the target",
            from_target=True,
            points=True,
        ),
        "quadric": Tool(
            "pymeshlab", (), QuadricOptions, seeded=False, title="quadric decimation of the target", from_target=True
        ),
        "nricp": Tool(
            "trimesh",
            ("trimesh", "rtree"),
            NricpOptions,
            seeded=False,
            title="non-rigid iterated closest points of the source",
        ),
        "pycpd": Tool(
            "pycpd",
            ("pycpd",),
            CpdOptions,
            seeded=True,
            title="deformable coherent point drift of the source",
            points=True,
        ),
        "meshmonk": Tool(
            "meshmonk", ("meshmonk",), MeshMonkOptions, seeded=False, title="MeshMonk's registration of the source"
        ),
        "reach-for-the-spheres": Tool(
            "gpytoolbox",
            ("gpytoolbox",),
            SpheresOptions,
            seeded=False,
            title="flow of the source to signed distances of the target",
        ),
    }
)
"""The ready entries, by name."""


def works_from_target(name: object) -> bool:
    """Return whether a name is that of a ready entry that makes its result from the target alone."""
    return any(tool.from_target for entry, tool in TOOLS.items() if entry == name)


INSTALL = "pip install 'meshfit[peers]'"


def missing_module(name: ToolName) -> str | None:
    """Return the first module that a ready entry needs and that is not installed; None if there is none."""
    return next((module for module in TOOLS[name].requires if find_spec(module) is None), None)


class ToolError(TrialError):
    """An external tool that failed.

    Attributes:
        kind: `tool`, `time-limit`, `memory-limit` or `killed`.
        output: beginning and end of what it printed.

    Example:
        >>> import meshfit
        >>> settings = meshfit.ExternalSettings(command=["false", "{result}"])
        >>> try:
        ...     meshfit.fit("icosahedron", "cube", settings, allow_commands=True)
        ... except meshfit.ToolError as error:
        ...     print(error)
        false ended with exit code 1, without a message
    """

    def __init__(self, message: str, kind: str = "tool", output: str = "") -> None:
        super().__init__(message)
        self.kind, self.output = kind, output


@dataclass(frozen=True)
class ToolRun:
    """One run of an external tool.

    Attributes:
        name: the ready entry, or the program of the command.
        version: the version that it states; None if it states none.
        seconds: duration: of the whole command, or of a ready entry's own call.
        peak_memory_mb: peak memory of its process and the descendants; None where the system does not report it.
        output: beginning and end of what it printed.
        warnings: about the mesh that it wrote.
    """

    name: str
    version: str | None
    seconds: float
    peak_memory_mb: float | None
    output: str
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, str | float | None]:
        """Return what a `result.json` records of it."""
        return {"name": self.name, "version": self.version}
