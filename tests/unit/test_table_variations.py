"""Names and order of settings that differ."""

import pytest

from meshfit.report.tables.grouping import differing_keys, natural_order, telling_keys, title_of, variation_names


def test_only_what_differs_is_named_and_keys_are_short_where_that_is_clear():
    settings = [
        {"fit.losses.edge": 0.1, "source.levels": 3, "seed": 0},
        {"fit.losses.edge": 0.1, "source.levels": 4, "seed": 0},
        {"fit.losses.edge": 1.0, "source.levels": 4, "seed": 0},
    ]
    assert differing_keys(settings) == ["fit.losses.edge", "source.levels"]
    assert variation_names(settings, ["", "", ""]) == ["edge=0.1, levels=3", "edge=0.1, levels=4", "edge=1.0, levels=4"]


def test_keys_that_end_alike_are_written_out():
    settings = [{"fit.levels": 1, "source.levels": 3}, {"fit.levels": 2, "source.levels": 4}]
    assert variation_names(settings, ["", ""])[0] == "fit.levels=1, source.levels=3"


def test_a_setting_that_a_variation_has_not_is_left_out_of_its_name():
    settings = [{"fit.method": "first-order", "fit.samples": 100}, {"fit.method": "gauss-newton"}]
    assert variation_names(settings, ["", ""]) == ["method=first-order", "method=gauss-newton"]


def test_a_variant_is_the_name_unless_it_does_not_tell_them_apart():
    settings = [{"a": 1}, {"a": 2}]
    assert variation_names(settings, ["weak", ""]) == ["weak", "a=2"]
    assert variation_names(settings, ["same", "same"]) == ["a=1", "a=2"]


@pytest.mark.parametrize(
    "ordered",
    [
        [0.001, 0.1, 1, 2.5, 10, 1e3],
        [None, 2, 10],
        [False, True],
        ["icosphere:level=2", "icosphere:level=10"],
        ["adam", "sgd"],
        [[0.0, 1.0], [0.0, 2.0]],
    ],
)
def test_values_are_ordered_naturally(ordered):
    backwards = [{"same": 1, "a": value} for value in reversed(ordered)]
    assert [backwards[place]["a"] for place in natural_order(backwards)] == ordered


def test_the_first_setting_that_differs_counts_first():
    settings = [{"a": 2, "b": 1}, {"a": 1, "b": 2}, {"a": 1, "b": 1}]
    assert natural_order(settings) == [2, 1, 0]


def test_the_keys_of_one_engine_alone_are_not_named_unless_nothing_else_tells_settings_apart():
    settings = [{"fit.method": "first-order", "fit.steps": 5, "fit.laplacian": None}, {"fit.method": "gauss-newton"}]
    assert telling_keys(settings) == ["fit.method"]
    assert [title_of("a", each, telling_keys(settings)) for each in settings] == [
        "a · fit.method=first-order",
        "a · fit.method=gauss-newton",
    ]
    more = [*settings, {"fit.method": "gauss-newton", "fit.noise": 0.1}]
    assert [title_of("a", each, telling_keys(more)) for each in more][1:] == [
        "a · fit.method=gauss-newton",
        "a · fit.method=gauss-newton, fit.noise=0.1",
    ]
