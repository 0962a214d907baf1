"""Names of the API: complete lists for completions, and suggestions for misspelt names."""

import pytest

import jaxwhisker as jw


def test_completions_show_the_api_and_nothing_else():
    for module in (jw, jw.plot):
        names = {name for name in dir(module) if not name.startswith("__")}
        assert names == set(module.__all__) | ({"plot"} if module is jw else set())
    assert {"simulate", "modes", "plot", "Whisking"} <= set(dir(jw)) and "__version__" in dir(jw)


@pytest.mark.parametrize(
    ("owner", "name", "hint"),
    [
        (jw, "scann", "scan"),
        (jw, "whisking", "Whisking"),
        (jw, "simulat", "simulate"),
        (jw.plot, "overveiw", "overview"),
        (jw.Support, "FB", "fb"),
        (jw.Support, "folicle", "follicle"),
        (jw.Whisker, "from_materials", "from_material"),
    ],
)
def test_misspelt_names_get_a_suggestion(owner, name, hint):
    with pytest.raises(AttributeError, match=rf"has no attribute '{name}'\. Did you mean '{hint}'\?$") as error:
        getattr(owner, name)
    assert error.value.name == name and error.value.obj is None


@pytest.mark.parametrize("owner", [jw, jw.plot, jw.Support, jw.Whisker])
@pytest.mark.parametrize("name", ["nothing_like_it", "__wrapped__", "_private"])
def test_other_names_get_none(owner, name):
    with pytest.raises(AttributeError, match=rf"has no attribute '{name}'$"):
        getattr(owner, name)
    assert not hasattr(owner, name)
