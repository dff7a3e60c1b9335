"""Notes of tables about the source."""

from dataclasses import replace

import pytest

from meshfit.report.tables.heads import setting_lines
from meshfit.report.tables.notes import notes
from meshfit.report.tables.style import Style
from meshfit.report.tables.table import build_tables, merge_tables
from meshfit.settings import deep_merge
from tests.runs import result_of


def source_line(*sources):
    results = []
    for place, source in enumerate(sources):
        one = result_of(seed=place, steps=100 + place)
        results.append(one | {"variant": str(place), "settings": deep_merge(one["settings"], {"source": source})})
    (table,) = merge_tables(build_tables(results))
    return setting_lines(table)[-1]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ({"levels": 1}, "Source: icosahedron, 1 level"),
        ({"wanted_verts": 2562}, "Source: icosahedron, refined to about 2562 vertices"),
        ({"decimate": 500, "mesh": "bunny"}, "Source: bunny, decimated to 500 faces, 4 levels"),
        ({"project": "sphere"}, "Source: icosahedron, 4 levels, projected to the sphere"),
        (
            {"mesh": "auto", "wanted_verts": 2562},
            "Source: made from each target (auto), refined to about 2562 vertices",
        ),
    ],
)
def test_the_source_of_all_trials(source, message):
    assert source_line(source) == message


def test_what_differs_from_trial_to_trial_is_told_to_vary():
    line = source_line({"project": "sphere"}, {"project": "none"})
    assert line.startswith("Source: icosahedron, 4 levels, projection varied")


def test_outer_surfaces_are_named():
    settings = {"target": {"surface": "outer"}, "measure": {"surface": "outer"}}
    one = result_of(seed=0, steps=100)
    (table,) = build_tables([one | {"settings": deep_merge(one["settings"], settings)}])
    fit = setting_lines(table)[1]
    assert ", to the outer surface of each target; measured on" in fit
    assert fit.endswith("samples of the outer surfaces, without what they hide")


def pooled(*results, style="full"):
    (table,) = build_tables(results)
    lines = notes(replace(table, style=Style(notes=style)))
    return [line for line in lines if line.startswith(("Trials of", "Measured again"))]


@pytest.mark.parametrize("style", ["full", "short"])
def test_trials_of_several_versions_or_devices_are_not_pooled_without_a_note(style):
    def run(seed, device="cpu", **versions):
        one = result_of(seed=seed)
        return one | {"versions": one["versions"] | versions, "fit": one["fit"] | {"device": device}}

    same = [run(0, "cuda:0", torch="2.1"), run(1, "cuda:1", torch="2.1")]
    assert pooled(*same, style=style) == []
    assert pooled(*same, run(2, torch="2.2"), run(3, "cuda", meshfit="0.2.0", torch="2.2"), style=style) == [
        "Trials of several versions of meshfit, which may give other numbers: 0.1.0 (3 runs), 0.2.0 (1 run)",
        "Trials of several versions of torch, which may give other numbers: 2.1 (2 runs), 2.2 (2 runs)",
        "Trials of several devices, which may give other numbers: cpu (1 run), cuda (3 runs)",
    ]
    assert pooled(run(0), {key: value for key, value in run(1).items() if key != "versions"}) == []


def test_results_that_were_measured_again_are_counted():
    again = result_of(seed=1) | {"measured_again": {}}
    assert pooled(result_of(seed=0), again) == [
        "Measured again after the fit: 1 of 2 runs; result.json has the values of the fit"
    ]
