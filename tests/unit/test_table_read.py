"""Result tables in Python: the same cells as text, as HTML and for pandas."""

import re

import pytest

import meshfit
from meshfit.errors import ConfigError, StoreError
from tests.runs import complete


def test_tables_of_runs_are_text_html_and_a_data_frame(tmp_path):
    for scheme in ("loop", "interp-loop"):
        for seed in (0, 1, 2):
            complete(tmp_path, scheme=scheme, seed=seed)
    tables = meshfit.read_tables(tmp_path / "small", metrics=["distance.mean"])
    html, text = tables._repr_html_(), repr(tables)
    cells = re.findall(r"<td>(.*?)</td>", html)
    assert len(cells) == 2
    for cell in cells:
        assert re.sub("</?b>", "", cell).split()[0] in text
    assert re.findall(r"<tr><th>(.*?)</th>", html) == ["scheme", "loop", "interp-loop"]
    pandas = pytest.importorskip("pandas")
    assert isinstance(tables.to_pandas(), pandas.DataFrame)
    assert set(tables.to_pandas()["scheme"]) == {"loop", "interp-loop"}


def test_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(StoreError):
        meshfit.read_tables(tmp_path / "nothing")
    complete(tmp_path)
    with pytest.raises(ConfigError, match="is not a metric"):
        meshfit.read_tables(tmp_path / "small", metrics=["distance.men"])
