"""The catalogue of figures: every number of the thesis, one title each."""

from jaxwhisker.thesis.catalogue import FIGURES


def test_every_figure_of_the_thesis_is_in_the_catalogue():
    chapters = {5: range(10, 17), 6: range(1, 25), 7: (4,)}
    assert list(FIGURES) == [f"{chapter}.{k}" for chapter, numbers in chapters.items() for k in numbers]
    titles = [figure.title for figure in FIGURES.values()]
    assert len(set(titles)) == len(titles)


def test_files_sort_in_the_order_of_the_figures():
    files = [figure.file for figure in FIGURES.values()]
    assert files == sorted(files)
