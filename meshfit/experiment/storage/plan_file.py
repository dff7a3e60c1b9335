"""`plan.json`: the trials of an experiment, as its latest run planned them, and the order of its tables."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

from meshfit.config.path_parts import PLAN
from meshfit.errors import StoreError
from meshfit.experiment.results_version import RESULTS_VERSION
from meshfit.experiment.storage.file_models import OriginContent, PlanContent, PlannedContent, fault_in
from meshfit.experiment.storage.run_directory import (
    Result,
    RunDirectory,
    json_text,
    make_folder,
    now,
    read_json,
    write_atomically,
)
from meshfit.specs import spec_folder

if TYPE_CHECKING:
    from meshfit.experiment.plan import Trial

PLAN_FILE_VERSION = 1

ROLES_OF_TARGETS = ("target", "target-landmarks", "truth")
"""Roles of the input files that belong to a target, and differ from target to target."""
_AXES = ("targets", "schemes", "seeds")

UpChoice = Literal["auto", "x", "y", "z"]
"""The axis that points up in pictures; `auto` leaves it to a guess."""


@dataclass(frozen=True)
class PlannedTrial:
    """A planned trial; `folder` is relative to the folder of the experiment.

    Attributes:
        origin: settings, inputs and schema version of its result, as far as these are known before it has run; empty
            in plans of older versions.
    """

    folder: Path
    identity: str
    target: str
    target_title: str
    scheme: str
    seed: int
    variant: str
    steps: int
    origin: Mapping[str, Any] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class PlanFile:
    """The latest plan of an experiment.

    Attributes:
        written: the time at which it was written.
        workers: the number of trials that run side by side.
        trials: in the order in which they are to run.
        targets: the targets in the order of the config, those of earlier plans among them.
        schemes: the schemes, as the targets.
        variants: the variants, as the targets.
        up: the axis that points up in pictures, or `auto`.
    """

    written: str
    workers: int
    trials: tuple[PlannedTrial, ...]
    targets: tuple[str, ...]
    schemes: tuple[str, ...]
    variants: tuple[str, ...]
    up: UpChoice = "auto"

    @cached_property
    def numbers(self) -> dict[Path, int]:
        """The place of each trial in the order in which they are to run, by its folder."""
        return {trial.folder: number for number, trial in enumerate(self.trials)}

    def place(self, target: str, scheme: str, variant: str | None) -> tuple[int, int, int]:
        """Return the places of a trial's variant, target and scheme; names that are not in the plan come last.

        Args:
            target: short name of the target.
            scheme: spec of the scheme, or the name of its folder.
            variant: name of the variant; None if it is not known.
        """
        if variant is None:
            variant = self.variants[0] if len(self.variants) == 1 else ""
        schemes = self.schemes if scheme in self.schemes else [spec_folder(spec) for spec in self.schemes]
        return _index(self.variants, variant), _index(self.targets, target), _index(schemes, scheme)


def write_plan(trials: Sequence["Trial"], store: RunDirectory, workers: int) -> None:
    """Write the plan of each experiment among some trials, in place of the previous one.

    The order of the targets, schemes and variants that are not in the new plan is kept from the previous one.

    Args:
        trials: the trials, in the order in which they are to run.
        store: the run directory.
        workers: the number of trials that run side by side.

    Raises:
        StoreError: it cannot be written.
    """
    for experiment in dict.fromkeys(trial.experiment for trial in trials):
        planned = [trial for trial in trials if trial.experiment == experiment]
        origins = [_shared_origin(trial) for trial in planned]
        distinct = list(dict.fromkeys(origins))
        number = {origin: place for place, origin in enumerate(distinct)}
        make_folder(store.root / experiment)
        write_atomically(
            store.root / experiment / PLAN,
            json_text(
                {
                    "schema_version": PLAN_FILE_VERSION,
                    "written": now(),
                    "workers": workers,
                    **_order(planned, _previous(store.root / experiment)),
                    "view": _view(planned),
                    "origins": [json.loads(origin) for origin in distinct],
                    "trials": [
                        _entry(trial) | {"origin": number[origin]}
                        for trial, origin in zip(planned, origins, strict=True)
                    ],
                }
            ),
        )


def update_order(trials: Sequence["Trial"], store: RunDirectory) -> None:
    """Bring the plans of complete trials up to date where the order or a name has changed in the config.

    Plans are left as they are if they cannot be written, and if they hold further trials.
    """
    for experiment in dict.fromkeys(trial.experiment for trial in trials):
        planned = [trial for trial in trials if trial.experiment == experiment]
        previous = _previous(store.root / experiment)
        names = {(trial.folder.relative_to(experiment), trial.variant) for trial in planned}
        if previous is not None and names <= {(trial.folder, trial.variant) for trial in previous.trials}:
            order = _order(planned, previous)
            if all(list(getattr(previous, key)) == order[key] for key in order):
                if previous.up != _view(planned)["up"]:
                    _update_view(store.root / experiment / PLAN, _view(planned))
                continue
        with suppress(StoreError):  # a run directory of someone else, say
            write_plan(planned, store, previous.workers if previous else 1)


def _view(trials: Sequence["Trial"]) -> dict[str, Any]:
    return trials[0].settings.view.model_dump(mode="json")


def _update_view(path: Path, view: dict[str, Any]) -> None:
    """Replace the view alone, in a plan that may hold further trials."""
    with suppress(StoreError):  # a run directory of someone else, say
        write_atomically(path, json_text(read_json(path) | {"view": view}))


def planned_up(folder: Path) -> UpChoice:
    """Return the axis that points up in pictures of a trial, by its folder: that of its plan, or `auto` without one."""
    place = Path(os.path.abspath(folder))  # noqa: PTH100  a run directory may be a link
    plan = _previous(place.parents[2]) if len(place.parents) > 2 else None
    return "auto" if plan is None else plan.up


def _previous(experiment: Path) -> PlanFile | None:
    with suppress(StoreError):  # a damaged plan is replaced
        return read_plan(experiment)
    return None


def _order(trials: Sequence["Trial"], previous: PlanFile | None) -> dict[str, list[str]]:
    """The order of tables, by what is in order."""
    latest = {
        "targets": [trial.names["target"] for trial in trials],
        "schemes": [trial.scheme for trial in trials],
        "variants": [trial.variant for trial in trials],
    }
    return {key: _merged_order(names, getattr(previous, key) if previous else ()) for key, names in latest.items()}


def _merged_order(latest: Iterable[str], previous: Sequence[str]) -> list[str]:
    """Return the latest names in order, with each other previous name after the one that it followed."""
    merged = list(dict.fromkeys(latest))
    for before, name in zip(("", *previous), previous, strict=False):
        if name not in merged:
            merged.insert(merged.index(before) + 1 if before in merged else 0, name)
    return merged


def _index(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else len(names)


def read_plan(experiment: Path) -> PlanFile | None:
    """Read the plan in the folder of an experiment; None where there is none, as in runs of older versions.

    Raises:
        StoreError: it cannot be read, or is of another version.
    """
    path = experiment / PLAN
    if not path.is_file():
        return None
    try:
        content = read_json(path)
    except StoreError as error:
        reason = str(error).removeprefix(f"{path}: ").partition("; delete it")[0]
        raise StoreError(f"{path}: {reason}; the next `meshfit run` rewrites it") from None
    if (got := content.get("schema_version")) != PLAN_FILE_VERSION:
        expected = f"got schema_version {got}, expected {PLAN_FILE_VERSION}"
        raise StoreError(f"{path}: {expected}; the next `meshfit run` rewrites it")
    try:
        if (fault := fault_in(PlanContent, content)) is not None:
            raise ValueError(fault)  # noqa: TRY301  as what follows
        plan = PlanContent.model_validate(content)
        trials = tuple(_planned_trial(entry, plan.origins) for entry in plan.trials)
        up = _planned_up(plan.view.up)
    except ValueError as error:
        raise StoreError(f"{path}: not a plan: {error}; the next `meshfit run` rewrites it") from None
    # Plans of older versions hold no order but that of their trials.
    order = (
        tuple(dict.fromkeys(trial.target for trial in trials)) if plan.targets is None else tuple(plan.targets),
        tuple(dict.fromkeys(trial.scheme for trial in trials)) if plan.schemes is None else tuple(plan.schemes),
        tuple(dict.fromkeys(trial.variant for trial in trials)) if plan.variants is None else tuple(plan.variants),
    )
    return PlanFile(plan.written, max(1, plan.workers), trials, *order, up)


def in_planned_order(results: Iterable[Result]) -> list[Result]:
    """Return results in the order of their experiments' plans, with the names that these give to variants.

    The place of each in its plan becomes its `place`: those of the variant, the target and the scheme, and that of the
    trial. Results without a plan keep their order and get no place. The order of the experiments is kept.

    Args:
        results: results with their `folder`.
    """
    plans: dict[Path, PlanFile | None] = {}
    groups: dict[Path, list[Result]] = {}
    for result in results:
        folder = Path(result["folder"])
        experiment = folder.parents[2] if len(folder.parents) > 2 else folder
        if experiment not in plans:
            plans[experiment] = _previous(experiment)  # `meshfit status` reports a damaged plan
        groups.setdefault(experiment, []).append(_placed(result, folder.relative_to(experiment), plans[experiment]))
    return [result for group in groups.values() for result in sorted(group, key=lambda each: each.get("place", ()))]


def _placed(result: Result, folder: Path, plan: PlanFile | None) -> Result:
    if plan is None:
        return result | {"variant": result.get("variant", "")}
    number = plan.numbers.get(folder, len(plan.trials))
    variant = plan.trials[number].variant if number < len(plan.trials) else result.get("variant", "")
    place = plan.place(result["target"], result["scheme"], variant)
    return result | {"variant": variant, "place": (*place, number)}


def _entry(trial: "Trial") -> dict[str, Any]:
    return {
        "folder": trial.folder.relative_to(trial.experiment).as_posix(),
        "identity": trial.identity,
        **trial.names,
        "steps": trial.settings.fit.steps,
        "file": trial.target,
        "sha256": dict(trial.inputs).get("target"),
    }


def _shared_origin(trial: "Trial") -> str:
    """Return, as JSON, what a result records of its origin, without what differs from trial to trial of a plan."""
    settings = {key: value for key, value in trial.plain_settings.items() if key not in _AXES}
    inputs = {role: sha256 for role, sha256 in trial.inputs if role not in ROLES_OF_TARGETS}
    return json.dumps({"schema_version": RESULTS_VERSION, "settings": settings, "inputs": inputs})


def _origin(entry: PlannedContent, origins: Sequence[OriginContent]) -> dict[str, Any]:
    if entry.origin is None:
        return {}
    if entry.origin >= len(origins):
        raise ValueError(f"no origins.{entry.origin}")
    shared = origins[entry.origin].model_dump()
    axes = {"targets": [entry.file or entry.target], "schemes": [entry.scheme], "seeds": [entry.seed]}
    target = {} if entry.sha256 is None else {"target": entry.sha256}
    inputs = {**shared["inputs"], **target}
    return {**shared, "settings": {**shared["settings"], **axes}, "inputs": inputs}


def _planned_up(up: str) -> UpChoice:
    for choice in get_args(UpChoice):
        if up == choice:
            return cast("UpChoice", choice)
    raise ValueError(f"view.up is {json.dumps(up)}")


def _planned_trial(entry: PlannedContent, origins: Sequence[OriginContent]) -> PlannedTrial:
    folder = PurePath(entry.folder)
    if folder.is_absolute() or ".." in folder.parts or not folder.parts:
        raise ValueError(f"the folder {str(folder)!r} is not inside the experiment's")
    return PlannedTrial(
        folder=Path(folder),
        identity=entry.identity,
        target=entry.target,
        target_title=entry.target_title,
        scheme=entry.scheme,
        seed=entry.seed,
        variant=entry.variant,
        steps=entry.steps,
        origin=_origin(entry, origins),
    )
