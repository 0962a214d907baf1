"""Figures: labels, colours; drawing itself: test_reproduce."""

import numpy as np
from matplotlib.image import imread

from jaxwhisker import plot
from jaxwhisker.thesis.figures import _colours, draw_table, plain
from jaxwhisker.thesis.scans import Case, vary


def test_labels_of_data_have_no_latex():
    assert plain(r"$c$ = $\infty$") == "c=inf" and plain(r"$\lambda$ = 0.1") == "lambda=0.1"


def test_the_clamped_whisker_is_black_in_comparisons():
    assert _colours(vary("stiffness", values=(30.0, np.inf)))[-1] == plot.COLOURS[-1]
    assert _colours({"clamped": Case(stiffness=np.inf)}) == [plot.COLOURS[0]]


def test_tables_are_drawn(tmp_path):
    draw_table("Title", [["x", "y"], ["1", "2"]], tmp_path / "table.png")
    assert np.std(imread(tmp_path / "table.png")[..., :3]) > 0.01
