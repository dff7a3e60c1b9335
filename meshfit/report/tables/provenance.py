"""Versions, devices and later measurements of the results in a table, and the notes that name differences."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from meshfit.experiment.storage.measurement import AGAIN
from meshfit.experiment.storage.run_directory import Result
from meshfit.units import count_text

_PACKAGES = ("meshfit", "torch")


@dataclass(frozen=True)
class Provenance:
    """Origin of some results.

    Attributes:
        runs: number of results.
        origins: number of results by version of each package, and by kind of device; results that do not say are not
            counted.
        measured_again: number of results whose values are those of a later measurement.
    """

    runs: int = 0
    origins: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    measured_again: int = 0

    @classmethod
    def of(cls, results: Iterable[Result]) -> "Provenance":
        """Count the origins of results; records of missing trials have none."""
        complete = [result for result in results if "missing" not in result]
        origins: dict[str, Counter[str]] = {}
        for result in complete:
            for what, value in _origin(result).items():
                origins.setdefault(what, Counter())[value] += 1
        return cls(len(complete), origins, sum(AGAIN in result for result in complete))

    def __add__(self, other: "Provenance") -> "Provenance":
        """Return the provenance of both."""
        origins = {
            what: Counter(self.origins.get(what, {})) + Counter(other.origins.get(what, {}))
            for what in {**self.origins, **other.origins}
        }
        return Provenance(self.runs + other.runs, origins, self.measured_again + other.measured_again)


def _origin(result: Result) -> dict[str, str]:
    """Return the versions and the kind of device of a result, as far as it says them."""
    versions, fit = result.get("versions"), result.get("fit")
    versions = versions if isinstance(versions, Mapping) else {}
    device: Any = fit.get("device") if isinstance(fit, Mapping) else None
    found = {name: versions.get(name) for name in _PACKAGES}
    found["device"] = device.partition(":")[0] if isinstance(device, str) else None
    return {what: str(value) for what, value in found.items() if value}


def provenance_notes(provenances: Iterable[Provenance]) -> Iterator[str]:
    """Say which versions and devices the numbers of a table are pooled over, and how many were measured again."""
    total = sum(provenances, Provenance())
    for what, counts in total.origins.items():
        if len(counts) > 1:
            listed = ", ".join(f"{value} ({count_text(count, 'run')})" for value, count in sorted(counts.items()))
            kind = "several devices" if what == "device" else f"several versions of {what}"
            yield f"Trials of {kind}, which may give other numbers: {listed}"
    if total.measured_again:
        share = f"{total.measured_again} of {count_text(total.runs, 'run')}"
        yield f"Measured again after the fit: {share}; result.json has the values of the fit"
