"""Films and sliders: time of a film, and frames per second while a slider is dragged in Chromium.

python benchmarks/showing.py

The page drags each slider back and forth at every frame of the browser. A frame counts when it shows a newly computed
scene, or, for the slider of the drive, another step of the same scan. Needs ffmpeg, chromium and chromedriver. Writes
the results "films" and "sliders".
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.chrome.service import Service

import jaxwhisker as jw
from common import summary, write
from jaxwhisker._explore.hosts import served
from jaxwhisker._explore.session import Session
from jaxwhisker._scan.scan import default_control

STEPS = 1900  # steps of the filmed scan
FILMS = 3
SECONDS = 8.0  # time of dragging
LONG = 600.0  # longest wait for the first frame, in s
MODELS = ("FB", "FBFBR", "FBFBFBR")

BUILD = """\
def build(stiffness, distance):
    support = jw.Support.named("{}", stiffness, 0.2)
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), support{})
"""
RANGES = "stiffness=(20, 500, 70.0), distance=(0.1, 0.5, 0.2)"
CLOSED, INTEGRATED = ", rod=jw.ClosedForm()", ""

# Drag back and forth for some seconds; return the number of frames, the time in s, and the waits between frames in ms.
DRAG = """
const [name, seconds, done] = arguments;
const root = document.querySelector(".jaxwhisker"), input = root.querySelector(`input[name=${name}]`);
const start = performance.now(), first = Number(root.dataset.drawn), gaps = [];
let drawn = first, last = start;
const frame = () => {
  const now = performance.now();
  if (Number(root.dataset.drawn) !== drawn) {
    gaps.push(now - last);
    [drawn, last] = [Number(root.dataset.drawn), now];
  }
  if (now - start > 1000 * seconds) return done([drawn - first, (now - start) / 1000, gaps]);
  const share = (now - start) / 3000;
  input.value = input.max * Math.abs((share % 2) - 1);
  input.dispatchEvent(new Event("input"));
  requestAnimationFrame(frame);
};
requestAnimationFrame(frame);
"""


def browser(folder: Path) -> webdriver.Chrome:
    """Start headless Chromium."""
    options: Any = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    flags = "headless=new no-sandbox disable-gpu disable-quic no-first-run disable-background-networking"
    for flag in (*flags.split(), f"user-data-dir={folder / 'chromium'}", "window-size=1200,1000"):
        options.add_argument(f"--{flag}")
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    driver.set_script_timeout(60)
    return driver


def settle(driver: webdriver.Chrome) -> None:
    """Wait until the page has drawn the current scene."""
    end = time.monotonic() + LONG
    while time.monotonic() < end:
        roots = driver.find_elements("css selector", ".jaxwhisker")
        if roots and roots[0].get_attribute("aria-busy") == "false":
            return
        time.sleep(0.1)
    raise TimeoutError("The page did not draw the scene.")


def dragged(driver: webdriver.Chrome, where: str, model: str, rod: str) -> dict[str, Any]:
    """Frames per second and waits of each slider."""
    rods = "closed form" if rod else "integrated"
    row: dict[str, Any] = {"where": where, "model": model, "rods": rods}
    for name in ("stiffness", "distance", "drive"):
        driver.execute_async_script(DRAG, name, 1.0)
        settle(driver)
        count, seconds, gaps = driver.execute_async_script(DRAG, name, SECONDS)
        settle(driver)
        row[f"{name}, frames/s"] = count / seconds
        row[f"{name}, 95th percentile of wait, ms"] = float(np.percentile(gaps, 95))
    return row


def on_page(driver: webdriver.Chrome, model: str, rod: str) -> dict[str, Any]:
    """Drag the sliders of the local page."""
    names: dict[str, Any] = {"jw": jw}
    exec(BUILD.format(model, rod), names)
    session = Session(names["build"], eval(f"dict({RANGES})"))
    with served(session) as url:
        driver.get(url)
        settle(driver)
        row = dragged(driver, "local page", model, rod)
        driver.get("about:blank")
    return row


def in_jupyter(driver: webdriver.Chrome, folder: Path, model: str, rod: str) -> dict[str, Any]:
    """Drag the sliders of a notebook in JupyterLab."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    head = 'import jax\njax.config.update("jax_enable_x64", True)\nimport jaxwhisker as jw\n'
    source = f"{head}{BUILD.format(model, rod)}jw.explore(build, {RANGES})"
    cell = {"cell_type": "code", "id": "one", "metadata": {}, "outputs": [], "execution_count": None, "source": source}
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = {"cells": [cell], "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    root = folder / "notebooks"
    root.mkdir(exist_ok=True)
    (root / "explore.ipynb").write_text(json.dumps(notebook))
    here, own = f"http://127.0.0.1:{port}", {"IPYTHONDIR": str(folder / "ipython")}
    own |= {f"JUPYTER_{name}_DIR": str(folder / name.lower()) for name in ("CONFIG", "DATA", "RUNTIME")}
    line = [sys.executable, "-m", "jupyterlab", "--allow-root", "--no-browser", f"--port={port}", "--ip=127.0.0.1"]
    line += ["--IdentityProvider.token=local", f"--ServerApp.root_dir={root}", "--LabApp.news_url=None"]
    quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(line, env=os.environ | own, **quiet) as process:
        try:
            _retry(lambda: urllib.request.urlopen(f"{here}/api?token=local", timeout=5).close())
            driver.get(f"{here}/lab/tree/explore.ipynb?token=local&reset")
            first = ".jp-Notebook .jp-Cell .cm-content"
            _retry(lambda: driver.find_element("css selector", first).click())
            time.sleep(3)  # panels that open late take the focus
            driver.find_element("css selector", first).click()
            ActionChains(driver).key_down(Keys.SHIFT).send_keys(Keys.ENTER).key_up(Keys.SHIFT).perform()
            settle(driver)
            driver.execute_script("document.querySelector('.jaxwhisker').scrollIntoView()")
            return dragged(driver, "JupyterLab", model, rod)
        finally:
            process.terminate()
            process.wait(60)


def _retry(attempt) -> None:
    """Repeat an attempt until it succeeds or the time is up."""
    end = time.monotonic() + LONG
    while True:
        try:
            return attempt()
        except (OSError, WebDriverException):
            if time.monotonic() > end:
                raise
            time.sleep(0.5)


def films(model: str, folder: Path) -> list[dict[str, Any]]:
    """Time and size of a film of a finished scan; the first film compiles."""
    scene = jw.Scene(jw.Whisker(), jw.Parabola(0.2), jw.Support.named(model, 70.0, 0.2), rod=jw.ClosedForm())
    first, *_, last = default_control(scene)
    result = jax.block_until_ready(jw.scan(scene, np.linspace(first, last, STEPS)))
    rows = []
    for suffix in ("mp4", "gif"):
        times = []
        for _ in range(1 + FILMS):
            start = time.perf_counter()
            path = jw.animate(result, folder / f"film.{suffix}", progress=False)
            times.append(time.perf_counter() - start)
        row: dict[str, Any] = {"format": suffix, "model": model, "rods": "closed form", "steps": STEPS}
        size = Path(str(path)).stat().st_size / 1e6
        rows.append(row | {"first film, s": times[0], "later films, s": summary(times[1:])["median"], "MB": size})
    return rows


def main() -> None:
    """Measure and store."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        driver = browser(folder)
        try:
            rows = [in_jupyter(driver, folder, model, CLOSED) for model in MODELS[:2]]
            rows += [on_page(driver, model, CLOSED) for model in MODELS]
            rows += [on_page(driver, model, INTEGRATED) for model in MODELS[:2]]
        finally:
            driver.quit()
        write("sliders", rows)
        write("films", [row for model in MODELS[:2] for row in films(model, folder)])


if __name__ == "__main__":
    main()
