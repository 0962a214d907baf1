"""Sliders in a browser: on the local page and, on request, in JupyterLab.

JAXWHISKER_BROWSER=required   fail, rather than skip, if Chromium is missing
JAXWHISKER_JUPYTERLAB=1       also test JupyterLab (needs jupyterlab)
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from typing import Any

import numpy as np
import pytest

import jaxwhisker as jw
import pegs
import several
from jaxwhisker._explore.hosts import _asset, served
from jaxwhisker._explore.session import Session
from jaxwhisker._explore.space_picture import VIEWS, picture_in_space
from jaxwhisker.plot.view import direction_of
from pictured import swept

SHOWN = 1e-6  # numbers are shown with six decimals
LONG = 600.0  # s, for the first picture, which is compiled, perhaps on a busy machine
PLAYED = 60.0  # s, for a motion that is played in 8 seconds
FLAGS = (
    "headless=new no-sandbox disable-gpu disable-quic no-first-run disable-background-networking "
    "disable-component-update disable-sync force-device-scale-factor=2"
)


def build(stiffness, distance):
    if distance > 0.8:
        raise ValueError("`distance` must leave room.")
    return jw.Scene(jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness), rod=jw.ClosedForm())


RANGES = {"stiffness": (10, 500, 70.0), "distance": (0.1, 0.9, 0.25)}


class Watched(Session):
    """A session that records its requests."""

    def __init__(self, build=build, ranges=RANGES):
        super().__init__(build, ranges)
        self.asked = []

    def answer(self, values):
        self.asked.append(values)
        return super().answer(values)


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    """A headless browser."""
    binary = shutil.which("chromium") or shutil.which("google-chrome")
    chromedriver = shutil.which("chromedriver")
    missing = [name for name, found in (("chromium", binary), ("chromedriver", chromedriver)) if found is None]
    try:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service
    except ImportError:
        missing.append("selenium")
    if missing:
        if os.environ.get("JAXWHISKER_BROWSER") == "required":
            pytest.fail(f"there is no {', '.join(missing)}")
        pytest.skip(f"there is no {', '.join(missing)}")
    options: Any = webdriver.ChromeOptions()
    options.binary_location = binary
    for flag in (*FLAGS.split(), f"user-data-dir={tmp_path_factory.mktemp('chromium')}", "window-size=1200,1000"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(chromedriver))
    yield found
    found.quit()


@pytest.fixture(scope="module")
def sliders():
    return Watched()


@pytest.fixture(scope="module")
def url(sliders):
    with served(sliders) as url:
        yield url


@pytest.fixture
def shown(driver, url):
    """The page with its first picture; its console must be empty in the end."""
    driver.set_window_size(1200, 1000)
    driver.get(url)
    settle(driver)
    yield driver
    assert [entry["message"] for entry in driver.get_log("browser")] == []


@pytest.fixture(scope="module")
def motions():
    """Motions of a whisker whose spring has a slider."""
    return Watched(swept, {"stiffness": (30, 500, 70.0)})


@pytest.fixture
def moving(driver, motions):
    """The page of motions with its first picture; its console must be empty in the end."""
    with served(motions) as url:
        driver.get(url)
        settle(driver)
        yield driver
    assert [entry["message"] for entry in driver.get_log("browser")] == []


def find(driver, selector):
    return driver.find_element("css selector", selector)


def settle(driver):
    """Wait for the picture of the current values."""
    end = time.monotonic() + LONG
    while time.monotonic() < end:
        roots = driver.find_elements("css selector", ".jaxwhisker")
        if roots and roots[0].get_attribute("aria-busy") == "false":
            return
        time.sleep(0.05)
    pytest.fail("no picture")


def drag(driver, name, right):
    """Drag the thumb of a slider by some pixels with the mouse."""
    from selenium.webdriver import ActionChains

    slider = find(driver, f"input[name={name}]")
    share = float(slider.get_attribute("value")) / float(slider.get_attribute("max"))
    width = slider.size["width"]
    thumb = int((share - 0.5) * (width - 16))
    chain = ActionChains(driver).move_to_element_with_offset(slider, thumb, 0).click_and_hold()
    for _ in range(5):
        chain.move_by_offset(right // 5, 0)
    chain.release().perform()
    settle(driver)


def set_slider(driver, name, share):
    """Set a slider to a share of its range."""
    driver.execute_script(
        "const input = document.querySelector(`input[name=${arguments[0]}]`);"
        "input.value = arguments[1] * input.max; input.dispatchEvent(new Event('input'));",
        name,
        share,
    )
    settle(driver)


def value(driver, name):
    return float(find(driver, f"input[name={name}]").get_attribute("aria-valuetext").removeprefix("u = "))


def pixels(driver):
    """The contents of both canvases."""
    script = "return [...document.querySelectorAll('.jaxwhisker canvas')].map((canvas) => canvas.toDataURL())"
    return driver.execute_script(script)


def numbers(driver):
    cells = driver.find_elements("css selector", ".jaxwhisker tbody td")
    return [cell.text for cell in cells]


def check_numbers(driver):
    """The table shows the scan of the sliders' values at the position of the drive."""
    scene = build(value(driver, "stiffness"), value(driver, "distance"))
    control = np.asarray(jw.scan(scene).control)
    u = value(driver, "drive")
    result = jw.scan(scene, np.array([control[0], u]))
    phase, *found = numbers(driver)
    assert phase == jw.Phase(int(result.phase[1, 0])).name
    # The displayed control is rounded as well, which changes the states by their slopes.
    near = jw.scan(scene, np.array([control[0], u + SHOWN]))
    for text, name in zip(found, ("fx", "fy", "mz", "base_x", "contact_arc"), strict=True):
        exact, next_ = (float(getattr(r, name)[1, 0]) for r in (result, near))
        assert abs(float(text) - exact) <= SHOWN + abs(next_ - exact)


def test_dragging_a_parameter_draws_another_scene(shown, tmp_path):
    before, start = pixels(shown), value(shown, "stiffness")
    check_numbers(shown)
    drag(shown, "stiffness", 60)
    assert value(shown, "stiffness") > start
    assert all(one != other for one, other in zip(before, pixels(shown), strict=True))
    check_numbers(shown)
    assert shown.save_screenshot(str(tmp_path / "dragged.png"))
    events = [item.text for item in shown.find_elements("css selector", ".jaxwhisker li")]
    assert events == list(map(str, jw.scan(build(value(shown, "stiffness"), value(shown, "distance"))).events))


def test_dragging_the_drive_sends_no_request(shown, sliders):
    before, start, asked = pixels(shown), value(shown, "drive"), len(sliders.asked)
    drag(shown, "drive", 200)
    assert value(shown, "drive") > start + 0.1
    assert all(one != other for one, other in zip(before, pixels(shown), strict=True))
    assert len(sliders.asked) == asked
    check_numbers(shown)


def test_keys_move_the_sliders(shown):
    from selenium.webdriver.common.keys import Keys

    before = value(shown, "distance"), value(shown, "drive")
    find(shown, "input[name=distance]").send_keys(Keys.ARROW_RIGHT * 5)
    find(shown, "input[name=drive]").send_keys(Keys.ARROW_LEFT * 5)
    settle(shown)
    step = 0.8 / 1000
    assert value(shown, "distance") == pytest.approx(before[0] + 5 * step, abs=step)
    assert value(shown, "drive") < before[1]
    check_numbers(shown)


def test_a_click_on_the_signals_moves_the_drive(shown):
    from selenium.webdriver import ActionChains

    signals, before = find(shown, "canvas.signals"), value(shown, "drive")
    ActionChains(shown).move_to_element_with_offset(signals, signals.size["width"] // 4, 0).click().perform()
    settle(shown)
    assert value(shown, "drive") > before
    check_numbers(shown)


def test_many_changes_are_few_requests_and_the_latest_wins(shown, sliders):
    asked = len(sliders.asked)
    shown.execute_script(
        "const input = document.querySelector('input[name=stiffness]');"
        "for (let k = 0; k <= 50; k++) { input.value = 10 * k; input.dispatchEvent(new Event('input')); }"
    )
    settle(shown)
    assert len(sliders.asked) == asked + 3  # two at once, then the latest
    assert sliders.asked[-1]["stiffness"] == value(shown, "stiffness") == pytest.approx(np.sqrt(10 * 500), rel=1e-3)
    check_numbers(shown)


def test_an_error_is_shown_and_the_page_goes_on(shown):
    set_slider(shown, "distance", 0.95)
    assert find(shown, ".message").text == "`distance` must leave room."
    assert "refused" in find(shown, ".jaxwhisker").get_attribute("class")
    set_slider(shown, "distance", 0.5)
    assert find(shown, ".message").text == ""
    assert "refused" not in find(shown, ".jaxwhisker").get_attribute("class")
    check_numbers(shown)


def test_the_code_prints_the_numbers_of_the_page(shown):
    set_slider(shown, "stiffness", 0.6)
    set_slider(shown, "drive", 0.3)
    code = find(shown, ".jaxwhisker pre")
    assert not code.is_displayed()
    find(shown, ".jaxwhisker button[aria-expanded]").click()
    settle(shown)
    assert code.is_displayed()
    printed = []
    exec(code.text, {"__name__": "fresh", "print": lambda *words: printed.append(words[0])})
    words = printed[-1].replace(",", "").split()
    numbers_of_code = {name: float(words[words.index(name) + 2]) for name in ("u", "fx", "fy", "mz")}
    assert numbers_of_code["u"] == pytest.approx(value(shown, "drive"), abs=SHOWN)
    for text, name in zip(numbers(shown)[1:4], ("fx", "fy", "mz"), strict=True):
        assert float(text) == pytest.approx(numbers_of_code[name], abs=2 * SHOWN)


def test_controls_and_canvases_have_accessible_names(shown):
    for slider in shown.find_elements("css selector", "input"):
        assert slider.accessible_name in ("drive", "stiffness (log)", "distance") and slider.aria_role == "slider"
        assert slider.get_attribute("aria-valuetext")
    for canvas in shown.find_elements("css selector", "canvas"):
        assert canvas.get_attribute("role") == "img" and canvas.get_attribute("aria-label")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pictures_are_as_fine_as_the_screen_and_fit_a_narrow_window(scheme, shown, tmp_path):
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    shown.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    for width in (1200, 500):
        shown.set_window_size(width, 1000)
        set_slider(shown, "drive", 0.4)
        sizes = shown.execute_script(
            "return [...document.querySelectorAll('canvas')].map((c) => [c.width, c.clientWidth, devicePixelRatio])"
        )
        assert all(fine == round(size * ratio) and ratio == 2 for fine, size, ratio in sizes)
        assert shown.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert shown.save_screenshot(str(tmp_path / f"{scheme}_{width}.png"))
    # Text and background must contrast.
    back, text = shown.execute_script(
        "const found = getComputedStyle(document.body); return [found.backgroundColor, found.color].map((c) =>"
        "c.match(/[0-9]+/g).slice(0, 3).reduce((sum, part) => sum + Number(part), 0) / 765)"
    )
    assert (back < 0.2 and text > 0.8) if scheme == "dark" else (back > 0.8 and text < 0.2)
    shown.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def check_first_screen(driver):
    """All sliders and both pictures are visible without scrolling, one below the other."""
    driver.set_window_size(1300, 800)
    settle(driver)
    time.sleep(0.2)  # a frame, in which the canvases are drawn in their new size
    settle(driver)
    box = (
        "const r = element.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom, innerWidth, innerHeight];"
    )
    script = f"return [...document.querySelectorAll(arguments[0])].map((element) => {{ {box} }})"
    sliders, canvases = (np.array(driver.execute_script(script, name)) for name in (".slider", "canvas"))
    for found in (sliders, canvases):
        assert (found[:, :2] >= 0).all() and (found[:, 2:4] <= found[:, 4:]).all()
    assert canvases[:, 3].max() <= sliders[:, 1].min()
    assert (canvases[:, 3] - canvases[:, 1]).min() > 240
    assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    (numbers,) = driver.execute_script(script, ".numbers")
    assert numbers[1] >= sliders[:, 3].max()  # nothing is covered


def test_sliders_are_on_the_first_screen(shown, tmp_path):
    check_first_screen(shown)
    assert shown.save_screenshot(str(tmp_path / "first_screen.png"))


def test_sliders_of_a_motion_are_on_the_first_screen(moving, tmp_path):
    check_first_screen(moving)
    assert moving.save_screenshot(str(tmp_path / "first_screen.png"))


def test_sliders_in_space_are_on_the_first_screen(solid, tmp_path):
    check_first_screen(solid)
    assert solid.save_screenshot(str(tmp_path / "first_screen.png"))


def test_labels_of_low_axes_have_two_lines(shown):
    script = (
        f"{_asset('draw.js')}; const context = document.createElement('canvas').getContext('2d'), found = [];"
        "context.font = '12px sans-serif'; context.fillText = (text) => found.push(text);"
        "for (const bottom of arguments[0]) axes({ context, width: 400, ink: 'black' },"
        "{ left: 76, right: 380, top: 0, bottom }, [0, 1], [0, 1], { y: 'mx (mN mm)' }); return found;"
    )
    assert [text for text in shown.execute_script(script, [200, 50]) if text[0] in "m("] == [
        "mx (mN mm)",
        "mx",
        "(mN mm)",
    ]


def test_a_page_whose_command_has_ended_says_so(driver, sliders):
    with served(sliders) as url:
        driver.get(url)
        settle(driver)
    offline = {"offline": True, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    driver.execute_cdp_cmd("Network.enable", {})
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)  # the open connection as well
    set_slider(driver, "stiffness", 0.9)
    assert "has ended" in find(driver, ".message").text
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline | {"offline": False})
    driver.get_log("browser")  # drop the messages about the lost connection


def place(driver):
    """Time and control at the position of the slider."""
    found = find(driver, "input[name=time]").get_attribute("aria-valuetext").split(", ")
    return [float(text.split(" = ")[1]) for text in found]


def test_the_slider_of_a_motion_is_time(moving, motions, tmp_path):
    asked = len(motions.asked)
    set_slider(moving, "time", 0.4)
    assert len(motions.asked) == asked
    set_slider(moving, "stiffness", 0.6)
    assert len(motions.asked) == asked + 1
    motion = swept(value(moving, "stiffness"))
    np.testing.assert_allclose(place(moving), [motion.time[40] / 0.5, motion.control[40]], atol=SHOWN)  # T = 0.5
    phase, *found = numbers(moving)
    assert phase == jw.Phase(int(motion.phase[40, 0])).name
    expected = [getattr(motion, name)[40, 0] for name in ("fx", "fy", "mz", "base_x", "contact_arc")]
    np.testing.assert_allclose([*map(float, found)], expected, atol=SHOWN)
    events = [item.text for item in moving.find_elements("css selector", ".jaxwhisker li")]
    assert events == [str(event._replace(time=event.time / 0.5)) for event in motion.events]
    assert moving.save_screenshot(str(tmp_path / "motion.png"))


def test_a_motion_is_played_to_its_end_or_until_it_is_paused(moving):
    def wait(condition):
        deadline = time.monotonic() + PLAYED
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.05)

    play, end = moving.find_element("xpath", "//button[text()='play']"), float(swept().time[-1]) / 0.5
    set_slider(moving, "time", 0.98)
    play.click()
    wait(lambda: play.text == "play")
    assert place(moving)[0] == pytest.approx(end)
    play.click()  # at the end: play again from the start
    wait(lambda: 0.0 < place(moving)[0] < end)
    play.click()
    stopped = place(moving)
    time.sleep(0.3)
    assert play.text == "play" and place(moving) == stopped


def test_a_scan_is_not_played(shown):
    assert not find(shown, ".jaxwhisker .top > button").is_displayed()


def past_ball(radius, offset):
    wire = jw.Whisker.from_material(length=0.05, youngs_modulus=2.1e11, diameter=2e-4)
    return jw.SpaceScene(wire, jw.Sphere(radius, (0.0, 0.06, offset)), jw.Support.follicle(x=40.0, z=20.0))


@pytest.fixture(scope="module")
def balls():
    """Scans in space."""
    return Watched(past_ball, {"radius": (0.03, 0.05, 0.04), "offset": (0.005, 0.02, 0.01)})


@pytest.fixture
def solid(driver, balls):
    """The page of scans in space with its first picture; its console must be empty in the end."""
    driver.set_window_size(1200, 1000)
    with served(balls) as url:
        driver.get(url)
        settle(driver)
        yield driver
    assert [entry["message"] for entry in driver.get_log("browser")] == []


def turn(driver, right, down):
    """Drag the scene by some pixels with the mouse."""
    from selenium.webdriver import ActionChains

    ActionChains(driver).click_and_hold(find(driver, "canvas")).move_by_offset(right, down).release().perform()
    settle(driver)


def test_the_mouse_turns_a_scene_in_space_and_the_sliders_keep_its_view(solid, balls, tmp_path):
    asked, (first, signals) = len(balls.asked), pixels(solid)
    turn(solid, 80, 30)
    turned = pixels(solid)
    assert turned[0] != first and turned[1] == signals and len(balls.asked) == asked
    set_slider(solid, "radius", 0.8)
    assert len(balls.asked) == asked + 1
    assert all(one != other for one, other in zip(pixels(solid), turned, strict=True))
    assert solid.save_screenshot(str(tmp_path / "space.png"))
    set_slider(solid, "radius", 0.5)
    assert pixels(solid) == turned
    turn(solid, -80, -30)
    assert pixels(solid)[0] == first
    turn(solid, 0, 400)
    above = pixels(solid)
    turn(solid, 0, 50)  # no camera looks from behind
    assert pixels(solid) == above


def test_buttons_choose_the_projections_of_a_scene_in_space(solid):
    seen = {}
    for name in ("camera", "xy", "xz", "yz", "camera"):
        solid.find_element("xpath", f"//button[text()='{name}']").click()
        settle(solid)
        assert seen.setdefault(name, pixels(solid)[0]) == pixels(solid)[0]
    assert len(set(seen.values())) == 4


def test_the_table_in_space_has_six_reactions(solid):
    set_slider(solid, "drive", 0.3)
    heads = [head.text for head in solid.find_elements("css selector", ".jaxwhisker thead th")][2:8]
    assert heads == ["fx (mN)", "fy (mN)", "fz (mN)", "mx (mN mm)", "my (mN mm)", "mz (mN mm)"]
    text = find(solid, "input[name=drive]").get_attribute("aria-valuetext")
    result = jw.scan(past_ball(0.04, 0.01), np.array([0.039, float(text.split()[2]) / 1e3]))
    expected = 1e3 * np.asarray(result.force[-1, 0]), 1e6 * np.asarray(result.moment[-1, 0])
    found = numbers(solid)
    assert found[0] == jw.Phase(int(result.phase[-1, 0])).name
    np.testing.assert_allclose([*map(float, found[1:7])], np.concatenate(expected), rtol=1e-4, atol=SHOWN)
    assert found[5] == "0.000000"  # a straight round wire has no torsion


def test_a_plane_scene_has_no_views(shown):
    assert not find(shown, "[role=group]").is_displayed()


def test_the_page_sees_and_hides_what_figures_do(solid):
    """Directions of cameras, and points beside, before and behind two balls, and on their backs."""
    source = "\n".join(map(_asset, ("draw.js", "space.js")))
    scene = past_ball(0.04, 0.01)
    beside = jw.Sphere(0.01, (0.03, 0.02, 0.06))
    body = picture_in_space(jw.SpaceScene(scene.whisker, (*scene.objects, beside), motion=scene.motion)).body
    assert body is not None
    arrays = {name: getattr(body, name).ravel().tolist() for name in ("normals", "offsets", "part")}
    points = np.random.default_rng(0).uniform(-1.5, 2.5, (300, 3))
    script = (
        f"{source}; const [picture, points, angles] = arguments; const picture32 = {{}};"
        "for (const name in picture) picture32[name] = Float32Array.from(picture[name]);"
        "const camera = cameraAt(angles), hidden = hiding(picture32, camera.eye);"
        "return [camera, Array.from({ length: points.length / 3 }, (_, k) => hidden(points, k))];"
    )
    for angles in ((15.0, 35.0), (-60.0, 200.0), *VIEWS.values()):
        camera, hidden = solid.execute_script(script, arrays, points.ravel().tolist(), angles)
        eye = direction_of(*angles)
        np.testing.assert_allclose(camera["eye"], eye, atol=1e-11)  # rounded
        np.testing.assert_allclose(np.cross(camera["right"], camera["up"]), eye, atol=1e-11)
        np.testing.assert_allclose(camera["right"][1], 0.0)  # y is upright
        expected = body.hides(points, eye)
        np.testing.assert_array_equal(hidden, expected)
        assert 10 < expected.sum() < 290


NOTEBOOK = """\
import jax
jax.config.update("jax_enable_x64", True)
import jaxwhisker as jw
jw.explore(lambda stiffness, distance: jw.Scene(
    jw.Whisker(), jw.Parabola(distance), jw.Support.fb(stiffness), rod=jw.ClosedForm()),
    stiffness=(10, 500, 70.0), distance=(0.1, 0.9, 0.25))
"""


@pytest.fixture
def lab(tmp_path):
    """The address of a JupyterLab with one notebook."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    cell = {"cell_type": "code", "id": "one", "metadata": {}, "outputs": [], "execution_count": None}
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = {"cells": [cell | {"source": NOTEBOOK}], "metadata": {"kernelspec": kernel}}
    (tmp_path / "explore.ipynb").write_text(json.dumps(notebook | {"nbformat": 4, "nbformat_minor": 5}))
    folders = {f"JUPYTER_{name}_DIR": str(tmp_path / name.lower()) for name in ("CONFIG", "DATA", "RUNTIME")}
    line = [sys.executable, "-m", "jupyterlab", "--allow-root", "--no-browser", f"--port={port}", "--ip=127.0.0.1"]
    line += ["--IdentityProvider.token=local", f"--ServerApp.root_dir={tmp_path}", "--LabApp.news_url=None"]
    here = f"http://127.0.0.1:{port}"
    quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(
        line, env=os.environ | folders | {"IPYTHONDIR": str(tmp_path / "ipython")}, **quiet
    ) as process:
        try:
            for _ in range(120):
                time.sleep(0.5)
                try:
                    urllib.request.urlopen(f"{here}/api?token=local", timeout=5).close()
                    break
                except OSError:
                    assert process.poll() is None
            yield f"{here}/lab/tree/explore.ipynb?token=local&reset"
        finally:
            process.terminate()
            process.wait(60)


@pytest.mark.skipif(not os.environ.get("JAXWHISKER_JUPYTERLAB"), reason="JAXWHISKER_JUPYTERLAB is not set")
def test_dragging_in_jupyterlab_draws_another_scene(driver, lab, tmp_path):
    from selenium.common.exceptions import WebDriverException
    from selenium.webdriver import ActionChains, Keys

    driver.set_window_size(1500, 1200)
    driver.get(lab)
    end = time.monotonic() + LONG
    while True:  # until JupyterLab has started
        try:
            find(driver, ".jp-Notebook .jp-Cell .cm-content").click()
            break
        except WebDriverException:
            assert time.monotonic() < end
            time.sleep(0.5)
    time.sleep(3)  # a late dialog takes the focus
    find(driver, ".jp-Notebook .jp-Cell .cm-content").click()
    ActionChains(driver).key_down(Keys.SHIFT).send_keys(Keys.ENTER).key_up(Keys.SHIFT).perform()
    settle(driver)
    driver.execute_script("document.querySelector('.jaxwhisker').scrollIntoView()")
    before = pixels(driver)
    drag(driver, "stiffness", 60)
    assert value(driver, "stiffness") > 70.0
    assert all(one != other for one, other in zip(before, pixels(driver), strict=True))
    check_numbers(driver)
    assert driver.save_screenshot(str(tmp_path / "lab.png"))


def test_all_contacts_of_a_whisker_are_shown(driver):
    with served(Session(several.circles, {"distance": (0.2, 0.3, 0.25)})) as url:
        driver.get(url)
        settle(driver)
        share = 0.42
        set_slider(driver, "drive", share)
        time.sleep(0.2)
        phase, *_, arcs = numbers(driver)
        u = value(driver, "drive")
    assert phase == "tangential, tangential"
    result = jw.scan(several.circles(), np.array([0.3, u]))
    exact = np.asarray(result.contact_arc[1, 0])
    np.testing.assert_allclose([float(arc) for arc in arcs.split(", ")], exact, atol=10 * SHOWN)
    assert [entry["message"] for entry in driver.get_log("browser")] == []


def test_all_contacts_of_a_whisker_in_space_are_shown(driver):
    def two_pegs(tilt=0.2):
        return pegs.scene(((tilt, 0.1, 1.0), (-0.3, 0.0, 1.0)))

    with served(Session(two_pegs, {"tilt": (0.1, 0.3, 0.2)})) as url:
        driver.get(url)
        settle(driver)
        set_slider(driver, "drive", 0.29)
        time.sleep(0.2)
        phase = numbers(driver)[0]
    assert phase == "tip, tangential"
    assert [entry["message"] for entry in driver.get_log("browser")] == []
