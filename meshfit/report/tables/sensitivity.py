"""Sensitivity of a metric to the settings of some runs: per target, and pooled over the targets."""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from meshfit.errors import ConfigError, StoreError
from meshfit.experiment.status.scan import ScannedExperiment
from meshfit.experiment.storage.failure import read_failure
from meshfit.experiment.storage.run_directory import Result
from meshfit.experiment.trial_status import TrialStatus
from meshfit.experiment.tuning.objectives import Objective, value_of
from meshfit.experiment.tuning.search_file import read_searches
from meshfit.measuring.metrics import require_metric
from meshfit.report.tables.grouping import (
    resolve_scheme,
    setting_text,
    shared_settings,
    target_key,
    without_numbers,
)
from meshfit.report.tables.search import experiment_folders
from meshfit.sensitivity import LEAST_Q2, Analysis, Effect, Estimate, Factor, analyse, codes_of
from meshfit.units import count_text

POOLED = "all targets"
_LOG_RATIO = 10.0
_MOST_CATEGORIES = 20
_MOST_IN_STEP = 5
_LEAST_POINTS = 8
_MOST_NAMED = 4  # trials that are not part of an analysis, for each reason

_Cells = dict[tuple[str, str], dict[str, list[float]]]


@dataclass(frozen=True)
class AbsentTrial:
    """A trial that is not part of an analysis.

    Attributes:
        state: `failed`, `waiting` and so on, or `no value` if it is complete and lacks the metric.
        reason: why it failed; empty if it did not.
        folder: its folder.
    """

    state: str
    reason: str
    folder: str


@dataclass(frozen=True)
class Sensitivity:
    """The sensitivity of a metric.

    Attributes:
        metric: the metric.
        compared: the scheme whose values others are divided by, or subtracted from; empty without.
        is_log: whether the response is the logarithm of the metric, so that effects are factors.
        groups: the analysis of each target, the pooled one first if there are several.
        notes: remarks on the sample.
        absent: the trials that failed, are not complete, or lack the metric.
    """

    metric: str
    compared: str
    is_log: bool
    groups: Mapping[str, Analysis]
    notes: tuple[str, ...]
    absent: tuple[AbsentTrial, ...] = ()

    def change_text(self, effect: Effect) -> str:
        """Return the change of the metric from the low to the high end of a setting."""
        change = effect.high - effect.low
        return f"×{math.exp(change):.3g}" if self.is_log else f"{change:+.3g}".replace("-", "−")


def absent_trials(experiments: Sequence[ScannedExperiment]) -> list[AbsentTrial]:
    """Return the trials of experiments that are not complete."""
    absent = []
    for experiment in experiments:
        for trial in experiment.trials:
            if trial.status is TrialStatus.COMPLETE:
                continue
            reason = ""
            if trial.status is TrialStatus.FAILED:
                failure = read_failure(trial.path)
                reason = f"{failure.kind}: {failure.message}"
            absent.append(AbsentTrial(str(trial.status), reason, str(trial.path)))
    return absent


def absent_lines(sensitivity: Sensitivity) -> list[str]:
    """Count the trials that are not part of an analysis by state and reason, and name the first of each."""
    kinds: dict[tuple[str, str], list[AbsentTrial]] = {}
    for trial in sensitivity.absent:
        kinds.setdefault((trial.state, without_numbers(trial.reason)), []).append(trial)
    if not kinds:
        return []
    lines = [f"Not in the analysis: {count_text(len(sensitivity.absent), 'trial')}."]
    for (state, reason), trials in sorted(kinds.items(), key=lambda kind: (not kind[0][1], -len(kind[1]))):
        named = ", ".join("/".join(Path(trial.folder).parts[-3:]) for trial in trials[:_MOST_NAMED])
        more = f" and {len(trials) - _MOST_NAMED:,} more" if len(trials) > _MOST_NAMED else ""
        example = ", such as" if len({trial.reason for trial in trials}) > 1 else ""
        ending = f"{example}: {trials[0].reason}" if reason else ""
        lines.append(f"{len(trials):,} {state}{ending} ({named}{more})")
    return lines


def read_sensitivity(
    results: Sequence[Result],
    metric: str,
    baseline: str | None = None,
    absent: Sequence[AbsentTrial] = (),
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Sensitivity:
    """Analyse results.

    Args:
        results: complete results, with their `folder`.
        metric: name of the metric.
        baseline: scheme that the others are compared with at each point; None analyses the metric itself.
        absent: trials without a result, from `absent_trials`.
        progress: called with what is analysed, how many analyses are done, and their number.

    Raises:
        ConfigError: an unknown metric, or one that no result has, or a baseline without results.
        StoreError: the settings of the results do not differ, or there are too few.
    """
    require_metric(metric)
    cells, settings, lacking = _cells(results, metric)
    targets = list(dict.fromkeys(target for target, _ in cells))
    schemes = list(dict.fromkeys(scheme for _, scheme in cells))
    means = {cell: {point: fmean(values) for point, values in points.items()} for cell, points in cells.items()}
    every = [value for points in means.values() for value in points.values()]
    is_log = Objective(metric, maximise=False).is_geometric and min(every) > 0
    if is_log:
        means = {cell: {point: math.log(value) for point, value in points.items()} for cell, points in means.items()}
    compared = ""
    if baseline is not None:
        compared = resolve_scheme(results, baseline)
        if compared not in schemes or len(schemes) < 2:
            raise ConfigError(f"--baseline {baseline}: expected one of several schemes; the results have {schemes}")
        schemes = [scheme for scheme in schemes if scheme != compared]
        means = {
            (target, scheme): {
                point: value - means[target, compared][point]
                for point, value in means.get((target, scheme), {}).items()
                if point in means.get((target, compared), {})
            }
            for target in targets
            for scheme in schemes
        }
    rows = {target: _rows(means, [target], schemes) for target in targets}
    if len(targets) > 1:
        rows = {POOLED: _rows(means, targets, schemes), **rows}
    notes = dict.fromkeys(_search_notes(results))
    groups: dict[str, Analysis] = {}
    for name, group in rows.items():
        progress(f"analysing {name}", len(groups), len(rows))
        factors, left_out = _factors([settings[point] for point, _ in group], [scheme for _, scheme in group])
        notes |= dict.fromkeys(left_out)
        if not factors or len(group) < _LEAST_POINTS:
            found = f"{count_text(len(group), 'point')} that differ in {count_text(len(factors), 'setting')}"
            raise StoreError(f"{name}: {found}; expected {_LEAST_POINTS} or more, as a sweep or a search makes them")
        points, _ = codes_of([point for point, _ in group])
        groups[name] = analyse(factors, np.array(list(group.values())), points)
    return Sensitivity(metric, compared, is_log, groups, tuple(notes), (*absent, *lacking))


def _cells(results: Sequence[Result], metric: str) -> tuple[_Cells, dict[str, dict[str, Any]], list[AbsentTrial]]:
    """Return the values by target and scheme, then by point, the settings of each point, and trials without a value."""
    cells: _Cells = {}
    settings: dict[str, dict[str, Any]] = {}
    lacking = []
    for result in results:
        shared = {
            key: value
            for key, value in shared_settings(result).items()
            if not key.endswith("sha256") and key != "schema_version" and not key.startswith("define.")
        }
        point = json.dumps(shared, sort_keys=True)
        settings.setdefault(point, shared)
        value = value_of(result, metric)
        if value is None:
            lacking.append(AbsentTrial("no value", f"the result has no {metric}", str(result.get("folder", ""))))
            continue
        cells.setdefault((target_key(result), result["scheme"]), {}).setdefault(point, []).append(value)
    if not cells:
        raise ConfigError(f"{metric}: none of {count_text(len(lacking), 'result')} has it; choose another --metric")
    return cells, settings, lacking


def _rows(
    means: Mapping[tuple[str, str], Mapping[str, float]], targets: Sequence[str], schemes: Sequence[str]
) -> dict[tuple[str, str], float]:
    """Return the mean over targets of each point and scheme that all of them have."""
    rows = {}
    for scheme in schemes:
        first, *others = [means.get((target, scheme), {}) for target in targets]
        for point in first:
            if all(point in other for other in others):
                rows[point, scheme] = fmean(each[point] for each in (first, *others))
    return rows


def _search_notes(results: Sequence[Result]) -> list[str]:
    return [
        f"{folder.name}: a search chose the points, so the shares are those of the region that it preferred; "
        "a sampled sweep gives those of the ranges"
        for folder in read_searches(experiment_folders(results))
    ]


def _factors(points: Sequence[Mapping[str, Any]], schemes: Sequence[str]) -> tuple[list[Factor], list[str]]:
    """Return the settings that differ, and notes on others.

    Settings that always change together are one, and those that a category determines are left out: a choice of the
    mesh may bring other numbers with it.
    """
    columns: dict[str, list[Any]] = {}
    left_out = []
    for key in dict.fromkeys(key for point in points for key in point):
        values = [point.get(key) for point in points]
        if not all(key in point for point in points):
            left_out.append(f"{key}: left out, since only some points have it")
        else:
            columns[key] = values
    columns["scheme"] = list(schemes)
    merged: list[list[str]] = []
    codes: dict[str, tuple[int, ...]] = {}
    for key, values in columns.items():
        indices, different = codes_of([json.dumps(value, sort_keys=True) for value in values])
        codes[key] = tuple(indices.tolist())
        if len(different) > 1:
            same = (keys for keys in merged if codes[keys[0]] == codes[key] and _is_same(columns[keys[0]], values))
            if (keys := next(same, None)) is not None:
                keys.append(key)
            else:
                merged.append([key])
    determined = {
        " = ".join(keys): others[0]
        for keys in merged
        for others in merged
        if others is not keys and _determines(columns[others[0]], codes[others[0]], codes[keys[0]])
    }
    left_out += [f"{name}: left out, since {other} determines it" for name, other in determined.items()]
    factors = []
    for keys in merged:
        if " = ".join(keys) in determined:
            continue
        numbers = [key for key in keys if all(map(_is_number, columns[key]))]
        key = (numbers or keys)[0]
        factor = _factor(" = ".join(keys), columns[key])
        if len(factor.categories) > _MOST_CATEGORIES:
            left_out.append(f"{factor.name}: left out, since it has {len(factor.categories)} categories")
        else:
            factors.append(factor)
    return factors, left_out


def _determines(values: Sequence[Any], codes: Sequence[int], others: Sequence[int]) -> bool:
    """Whether each category goes with one value of another setting, and some values with several categories."""
    categories = len(set(codes))
    if all(map(_is_number, values)) or categories > min(_MOST_CATEGORIES, len(codes) // 2):
        return False
    return len(set(zip(codes, others, strict=True))) == categories > len(set(others))


def _is_same(first: Sequence[Any], second: Sequence[Any]) -> bool:
    """Whether two settings, each of which determines the other at the points, always change together.

    Two that have another value at each point may do so by chance; they do not, unless one rises with the other.
    """
    if not all(map(_is_number, (*first, *second))) or len(set(first)) <= _MOST_IN_STEP:
        return len(set(map(str, first))) <= _MOST_CATEGORIES
    order = np.argsort(first, kind="stable")
    steps = np.diff(np.array(second, dtype=np.float64)[order])
    return bool(np.all(steps >= 0) or np.all(steps <= 0))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _factor(name: str, values: Sequence[Any]) -> Factor:
    from scipy.stats import skew

    if not all(map(_is_number, values)):
        codes, different = codes_of([setting_text(value) for value in values])
        return Factor(name, codes.astype(np.float64), tuple(map(str, different)))
    numbers = np.array(values, dtype=np.float64)
    if numbers.min() > 0 and numbers.max() > _LOG_RATIO * numbers.min():
        logarithms = np.log(numbers)
        if abs(float(skew(logarithms))) < abs(float(skew(numbers))):
            return Factor(name, logarithms, is_log=True)
    return Factor(name, numbers)


def effect_heads(analysis: Analysis, *, ends: bool = True) -> list[str]:
    """Return the heads of `effect_cells`."""
    shares = [] if analysis.why_not else ["first-order", "total"]
    return ["setting", "rank", *(["from", "to"] if ends else []), "change", *shares]


def effect_cells(sensitivity: Sensitivity, analysis: Analysis, effect: Effect, *, ends: bool = True) -> list[str]:
    """Return an effect as text: setting, rank statistic, change between two ends, and indices if there are any."""
    symbol = "η²" if effect.factor.categories else "ρ"
    rank = f"{symbol} {_interval_text(effect.rank)}{'*' if effect.moves else ' '}"
    cells = [effect.factor.name, rank, *(effect.ends if ends else ()), sensitivity.change_text(effect)]
    return cells if analysis.why_not else [*cells, _interval_text(effect.first), _interval_text(effect.total)]


def _interval_text(estimate: Estimate | None) -> str:
    if estimate is None:
        return ""
    return f"{estimate.value:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]".replace("-", "−")


def sensitivity_title(sensitivity: Sensitivity) -> str:
    """Return what is analysed, such as `distance.mean, each scheme against loop (logarithm)`."""
    compared = f", each scheme against {sensitivity.compared}" if sensitivity.compared else ""
    return f"{sensitivity.metric}{compared}{' (logarithm)' if sensitivity.is_log else ''}"


def group_title(name: str, analysis: Analysis) -> str:
    """Return the title of an analysis, such as `bunny: 64 points, Q² 0.85`."""
    q2 = f", Q² {analysis.q2:.2f}" if analysis.q2 is not None and not analysis.why_not else ""
    return f"{name}: {count_text(analysis.points, 'point')}{q2}"


def analysis_lines(analysis: Analysis) -> list[str]:
    """Return remarks on an analysis: missing indices, interactions, settings that vary together."""
    lines = [f"No Sobol' indices: {analysis.why_not}."] if analysis.why_not else []
    if analysis.interactions:
        pairs = (f"{' × '.join(pair.names)} {_interval_text(pair.share)}" for pair in analysis.interactions[:5])
        lines.append(f"Together: {'; '.join(pairs)}")
    for first, second, value in analysis.confounded:
        line = f"{first} and {second} vary together (ρ {value:.2f}): their effects cannot be told apart."
        lines.append(line.replace("-", "−"))
    return lines


def final_lines(sensitivity: Sensitivity) -> list[str]:
    """Return what the columns are, remarks on the sample, and the trials that are not part of it."""
    legend = (
        "rank: Spearman's ρ, or η² of ranks for categories; * significant at 5 %. first-order, total: shares of the "
        f"variance, by a Gaussian process with Q² of {LEAST_Q2} or more. [95 % intervals]"
    )
    return [legend, *sensitivity.notes, *absent_lines(sensitivity)]


def sensitivity_markdown(sensitivity: Sensitivity) -> str:
    """Return tables and remarks in Markdown."""
    blocks = [f"**{_escaped(sensitivity_title(sensitivity))}**"]
    for name, analysis in sensitivity.groups.items():
        heads = effect_heads(analysis)
        ruler = ["---", *("--:" for _ in heads[1:])]
        cells = [effect_cells(sensitivity, analysis, effect) for effect in analysis.effects]
        rows = [f"| {' | '.join(_escaped(cell.strip()) for cell in row)} |" for row in (heads, *cells)]
        rows.insert(1, f"| {' | '.join(ruler)} |")
        blocks += [_escaped(group_title(name, analysis)), "\n".join(rows), *map(_escaped, analysis_lines(analysis))]
    return "\n\n".join([*blocks, *map(_escaped, final_lines(sensitivity))]) + "\n"


def _escaped(text: str) -> str:
    return re.sub(r"([\\`*_|<>])", r"\\\1", text)


def plain_sensitivity(sensitivity: Sensitivity) -> list[dict[str, Any]]:
    """Return one record per target and setting; intervals are `…_low` and `…_high`."""
    records = []
    for name, analysis in sensitivity.groups.items():
        for effect in analysis.effects:
            record = {
                "metric": sensitivity.metric,
                "baseline": sensitivity.compared or None,
                "target": name,
                "setting": effect.factor.name,
                "kind": "category" if effect.factor.categories else "log" if effect.factor.is_log else "linear",
                "statistic": "eta_squared" if effect.factor.categories else "spearman",
                **_plain("rank", effect.rank),
                "moves": effect.moves,
                "from": effect.ends[0],
                "to": effect.ends[1],
                "change": math.exp(effect.high - effect.low) if sensitivity.is_log else effect.high - effect.low,
                "change_is_ratio": sensitivity.is_log,
                **_plain("first_order", effect.first),
                **_plain("total", effect.total),
                "q2": analysis.q2,
                "points": analysis.points,
            }
            records.append(record)
    return records


def _plain(name: str, estimate: Estimate | None) -> dict[str, float | None]:
    values = (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))


def sensitivity_csv(sensitivity: Sensitivity) -> str:
    """Return one line per target and setting."""
    text = io.StringIO()
    records = plain_sensitivity(sensitivity)
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def sensitivity_json(sensitivity: Sensitivity) -> str:
    """Return records of effects, interactions, and what is known of the sample."""
    content = {
        "metric": sensitivity.metric,
        "effects": plain_sensitivity(sensitivity),
        "interactions": [
            {"target": name, "settings": list(pair.names), **_plain("share", pair.share)}
            for name, analysis in sensitivity.groups.items()
            for pair in analysis.interactions
        ],
        "without_indices": {name: each.why_not for name, each in sensitivity.groups.items() if each.why_not},
        "confounded": {name: each.confounded for name, each in sensitivity.groups.items() if each.confounded},
        "notes": list(sensitivity.notes),
        "absent": [asdict(trial) for trial in sensitivity.absent],
    }
    return json.dumps(content, indent=2) + "\n"


def shortened(sensitivity: Sensitivity, names: Mapping[str, str]) -> Sensitivity:
    """Return the sensitivity with other names of settings."""

    def renamed(analysis: Analysis) -> Analysis:
        effects = tuple(
            replace(each, factor=replace(each.factor, name=names[each.factor.name])) for each in analysis.effects
        )
        pairs = tuple(
            replace(each, names=(names[each.names[0]], names[each.names[1]])) for each in analysis.interactions
        )
        confounded = tuple((names[first], names[second], value) for first, second, value in analysis.confounded)
        return replace(analysis, effects=effects, interactions=pairs, confounded=confounded)

    return replace(sensitivity, groups={name: renamed(each) for name, each in sensitivity.groups.items()})
