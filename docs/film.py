"""Draws docs/film.gif: two coupled whiskers pass a parabola and snap off, one after the other."""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jaxwhisker as jw
from jaxwhisker.film import animate

HERE = Path(__file__).parent


def main() -> None:
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.fbfbr(70.0, 0.2), rod=jw.ClosedForm())
    path = animate(jw.scan(scene), HERE / "film.gif", seconds=7.5, fps=20, width=760)
    assert isinstance(path, Path)
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
