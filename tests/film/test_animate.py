"""Films in notebooks; arguments."""

import jax
import numpy as np
import pytest

from jaxwhisker.film import Film, animate, frames, writers

FFMPEG = pytest.mark.skipif(not writers.has_ffmpeg(), reason="ffmpeg writes videos")


def test_notebooks_show_a_film_without_a_file(stiff, monkeypatch):
    monkeypatch.setattr(writers, "has_ffmpeg", lambda: False)
    film = animate(stiff, seconds=0.2, width=100, progress=False)
    assert isinstance(film, Film)
    assert film.data[:6] == b"GIF89a"
    assert film._repr_html_().startswith("<img") and "data:image/gif;base64,R0lGODlh" in film._repr_html_()
    assert "image/gif" in repr(film)


@FFMPEG
def test_notebooks_show_a_video_where_there_is_ffmpeg(stiff):
    film = animate(stiff, seconds=0.2, width=100, progress=False)
    assert isinstance(film, Film)
    assert film._repr_html_().startswith("<video controls") and "data:video/mp4;base64," in film._repr_html_()
    assert film.data[4:8] == b"ftyp"


WRONG = {
    "suffix": ({"path": "film.avi"}, ["`path`", ".mp4, .webm or .gif", "film.avi"]),
    "no suffix": ({"path": "film"}, ["`path`", ".gif"]),
    "no path": ({"path": 3}, ["`path`", "3"]),
    "folder": ({"path": "nowhere/film.gif"}, ["`path`", "folder", "nowhere"]),
    "seconds": ({"seconds": 0.0}, ["`seconds`", "positive", "0.0"]),
    "seconds unknown": ({"seconds": float("nan")}, ["`seconds`", "nan"]),
    "too long": ({"seconds": 1e9}, ["`seconds`", "at most 300", "got 1e+09"]),
    "fps": ({"fps": 0}, ["`fps`", "positive int", "0"]),
    "too fast": ({"fps": 61}, ["`fps`", "60", "61"]),
    "width": ({"width": 1.5}, ["`width`", "positive int", "1.5"]),
    "too narrow": ({"width": 10}, ["`width`", "64", "10"]),
    "units": ({"units": "inch"}, ["`units`", "SI", "'inch'"]),
    "result": ({"result": None}, ["`result`", "None"]),
}


@pytest.mark.unchecked
@pytest.mark.parametrize("name", WRONG)
def test_invalid_arguments_are_rejected_by_name_before_anything_is_computed(name, stiff, monkeypatch):
    monkeypatch.setattr(frames, "frames", lambda *_: pytest.fail("frames were computed"))
    arguments, words = WRONG[name]
    with pytest.raises(ValueError) as error:
        animate(**{"result": stiff, "path": "film.gif"} | arguments)
    for word in words:
        assert word in str(error.value)


@pytest.mark.unchecked
def test_a_batch_of_scans_is_rejected(stiff):
    with pytest.raises(ValueError, match="select one"):
        animate(jax.tree.map(lambda leaf: np.stack([leaf, leaf]), stiff), "film.gif")


def test_without_ffmpeg_videos_are_rejected_with_a_remedy(stiff, monkeypatch, tmp_path):
    monkeypatch.setattr(writers, "has_ffmpeg", lambda: False)
    with pytest.raises(ValueError, match=r"`path` must end with \.gif.*film\.mp4.*[Ii]nstall ffmpeg"):
        animate(stiff, tmp_path / "film.mp4")
