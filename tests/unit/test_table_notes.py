"""Notes of tables about the source."""

import pytest

from meshfit.report.tables.notes import setting_lines
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
