"""Writing the results: names, files, and the page that shows them."""

import numpy as np
import pytest
from matplotlib.image import imread

from jaxwhisker.thesis.reproduce import parse_names, reproduce

THESIS_DIGIT = 5.001e-5  # half a unit of the last printed digit
PRINTED = 1e-6  # differences are printed with six decimals
READ = 1e-4  # relative: maxima are read from the steps


def test_names_have_an_optional_leading_zero():
    assert parse_names("6.02, a.1,CLAIMS,7.4") == ["6.2", "A.1", "claims", "7.4"]
    with pytest.raises(ValueError, match=r"--only must name some of .*, got '6\.99'"):
        parse_names("6.99")


def test_a_table_and_a_figure_are_written(tmp_path, capsys):
    out = tmp_path / "results" / "here"
    reproduce(out, ["6.2", "A.1"])
    stems = {"figure_6.02", "table_A.1"}
    files = {f"{stem}{ending}" for stem in stems for ending in (".png", ".csv")}
    assert {path.name for path in out.iterdir()} == files | {"README.md", "index.html"}
    html, text = ((out / name).read_text() for name in ("index.html", "README.md"))
    assert all(f'="{name}"' in html for name in files) and "<td style=" in html and "0.8795" in html
    assert all(f"({name})" in text for name in files)
    assert text.index("## Tables A.1 to A.4") < text.index("## Chapter 6") and "## Claims" not in text
    assert np.std(imread(out / "figure_6.02.png")[..., :3]) > 0.05

    rows = [line.split(",") for line in (out / "table_A.1.csv").read_text().splitlines()]
    assert rows[0] == ["load", "reaction", "jaxwhisker", "thesis", "difference", "multi-body"]
    assert len(rows) == 1 + 5 * 3
    for _, _, ours, printed, difference, _ in rows[1:]:
        assert abs(float(ours) - float(printed)) < THESIS_DIGIT
        assert abs(float(ours) - float(printed) - float(difference)) < PRINTED

    lines = (out / "figure_6.02.csv").read_text().splitlines()
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines[2:]])
    columns = dict(zip(lines[1].split(","), values.T, strict=True))
    rigid = columns["mz_1 (c=inf)"]
    for c in ("30", "50", "70", "100", "200"):
        soft = columns[f"mz_1 (c={c})"]
        assert abs(soft.max() / rigid.max() - 1) < READ
        assert columns["control"][np.argmax(soft)] < columns["control"][np.argmax(rigid)]
    assert "2 results" in capsys.readouterr().out
