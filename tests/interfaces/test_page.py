"""Pages of one file: what Chromium draws, beside PoCL's pictures; what is in them, and what is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clvol
from clvol.base.errors import ClvolWarning, FormatError, OptionError
from clvol.device import Device
from clvol.interfaces.page.look import reduced
from tests.view.browser import SOFTWARE_GL, Browser, open_browser, why_none
from tests.view.firefox import open_firefox, why_no_firefox

SIZE = 128
WITHIN = 0.002 + 0.5 / 255  # of the range: the samplers' weights, and the pixels' 8 bits

Z, Y, X = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
BALL = clvol.Volume((1000 * (1 - np.sqrt(X**2 + 1.5 * Y**2 + Z**2))).astype(np.int16))
# A device with no more than WebGL2 promises, and a sampler as most have it, with weights of 8 bits, in place of the exact one of a
# software device
LEAST = """const of = WebGL2RenderingContext.prototype, ask = of.getParameter;
    const promised = {0x8073: 256, 0x8872: 16, 0x8B49: 224, 0x0D33: 2048};
    of.getExtension = () => null;
    of.getParameter = function (name) { return promised[name] ?? ask.call(this, name); };
    const set = of.shaderSource;
    of.shaderSource = function (shader, text) {
        const coarse = `vec4 coarse(sampler3D s, vec3 p) {
            vec3 n = vec3(textureSize(s, 0)), at = p * n - 0.5, f = at - floor(at);
            return texture(s, (floor(at) + floor(256.0 * f + 0.5) / 256.0 + 0.5) / n);
        }`;
        const last = "precision highp sampler3D;";
        set.call(this, shader, text.replaceAll("texture(", "coarse(").replace(last, last + coarse));
    };"""

# Actions of WebDriver: the arrow to the left, and a drag
KEYS = {"type": "keyDown", "value": "\ue012"}, {"type": "keyUp", "value": "\ue012"}
DRAG = (
    {"type": "pointerMove", "x": 60, "y": 60},
    {"type": "pointerDown", "button": 0},
    {"type": "pointerMove", "x": 90, "y": 70, "duration": 100},
    {"type": "pointerUp", "button": 0},
)


def drawn(browser: Browser, page: Path, width: int = SIZE) -> np.ndarray:
    """The whole picture of a page, in 0..1."""
    browser.open(page.as_uri())
    browser.js(f"document.getElementById('picture').style.cssText = 'flex: none; width: {width}px; height: {SIZE}px'")
    canvas = "document.getElementById('picture')"
    browser.wait(f"{canvas}.dataset.final === 'true' && {canvas}.width === {width}", 120, "the whole picture")
    return browser.canvas("#picture") / 255


def test_the_page_draws_what_python_draws(device: Device, tmp_path: Path) -> None:
    if why := why_none():
        pytest.skip(why)
    names = np.digitize(BALL.data, [0, 300, 600]).astype(np.uint8)
    cases: dict[str, tuple[clvol.Volume, dict[str, Any]]] = {
        "mip": (clvol.phantoms.marschner_lobb(32), {"mode": "mip"}),
        "composite": (clvol.phantoms.marschner_lobb(32), {"clip": clvol.Plane((0.3, -1, 0.4), (0, 0, 0))}),
        "ridges": (clvol.phantoms.marschner_lobb(32), {"mode": "isosurface", "isovalue": 0.5}),
        "surface": (BALL, {"mode": "isosurface", "isovalue": 300.0}),
        "labels": (clvol.Volume(names, labels=True), {}),
    }
    with open_browser(400, 400, SOFTWARE_GL) as browser:
        for name, (volume, look) in cases.items():
            page = clvol.save_html(volume, tmp_path / f"{name}.html", device=device, **look)
            wanted = np.asarray(clvol.render(volume, size=(SIZE, SIZE), rays=1, device=device, **look))
            apart = np.abs(drawn(browser, page) - wanted).max(-1)
            assert np.mean(apart <= WITHIN) >= 0.998, name  # all but rays along rims
            assert np.ptp(wanted[..., :3]) > 0.5, name
        first = browser.canvas("#picture")
        browser.js("document.getElementById('picture').focus()")
        browser.key("ArrowLeft")
        browser.wait(lambda: not np.array_equal(browser.canvas("#picture"), first), 60, "a turn by a key")
        browser.js("document.getElementById('slices-button').click()")
        assert len(np.unique(browser.canvas("#slice-canvas-0").reshape(-1, 4), axis=0)) == 4  # the labels of a slice
        assert [url for url in browser.requests() if not url.startswith("file:")] == []
        assert [line for line in browser.console() if "SEVERE" in line] == []


def test_firefox_draws_and_turns_what_chromium_does(device: Device, tmp_path: Path) -> None:
    if why := why_no_firefox():
        pytest.skip(why)
    volume = clvol.phantoms.marschner_lobb(32)
    page = clvol.save_html(volume, tmp_path / "page.html", mode="mip", device=device)
    wanted = np.asarray(clvol.render(volume, mode="mip", size=(SIZE, SIZE), rays=1, device=device))
    with open_firefox(400, 400) as browser:
        assert np.mean(np.abs(drawn(browser, page) - wanted).max(-1) <= WITHIN) >= 0.998
        for kind, actions in (("key", KEYS), ("pointer", DRAG)):
            before = browser.canvas("#picture")
            browser.js("document.getElementById('picture').focus()")
            browser.act(kind, *actions)
            browser.wait(lambda before=before: not np.array_equal(browser.canvas("#picture"), before), 20, f"a turn by a {kind}")
        browser.js("document.getElementById('slices-button').click()")
        assert np.ptp(browser.canvas("#slice-canvas-0")[..., 0]) > 50
        assert [url for url in browser.requests() if not url.startswith(("file:", "data:"))] == []
        assert [line for line in browser.console() if line.startswith("ERROR")] == []


def test_portraits_are_pythons(device: Device, tmp_path: Path) -> None:
    if why := why_none():
        pytest.skip(why)
    cameras = clvol.Camera.orbit(10, 70), clvol.Camera.look_at((90, -60, 50)), clvol.Camera(projection="orthographic")
    with open_browser(400, 400, SOFTWARE_GL) as browser:
        for camera, width in zip(cameras, (90, 60, 60), strict=True):
            page = clvol.save_html(BALL, tmp_path / "page.html", camera, "mip", device=device)
            wanted = np.asarray(clvol.render(BALL, camera, "mip", size=(width, SIZE), rays=1, device=device))
            assert np.mean(np.abs(drawn(browser, page, width) - wanted).max(-1) <= WITHIN) >= 0.998, camera
            assert np.ptp(wanted[..., :3]) > 0.5, camera


def test_the_page_fits_phones_and_fingers(device: Device, tmp_path: Path) -> None:
    if why := why_none():
        pytest.skip(why)
    page = clvol.save_html(BALL, tmp_path / "page.html", mode="mip", device=device, title="A ball", metadata=True)
    with open_browser(375, 667, SOFTWARE_GL) as browser:
        cdp = browser.driver.execute_cdp_cmd
        cdp("Emulation.setDeviceMetricsOverride", {"width": 375, "height": 667, "deviceScaleFactor": 1, "mobile": True})
        cdp("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
        first = drawn(browser, page)

        def touch(kind: str, *places: tuple[float, float]) -> None:
            points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
            cdp("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        def shown(other: np.ndarray, *, same: bool) -> np.ndarray:
            still = "document.getElementById('picture').dataset.final === 'true'"
            browser.wait(lambda: browser.js(f"return {still}") and np.array_equal(browser.canvas("#picture") / 255, other) == same)
            return browser.canvas("#picture") / 255

        touch("touchStart", (50, 80), (80, 80))
        touch("touchMove", (40, 80), (90, 80))
        touch("touchEnd")
        larger = shown(first, same=False)
        assert (larger[..., 0] > 0).sum() > (first[..., 0] > 0).sum()
        for _ in range(2):
            touch("touchStart", (60, 80))
            touch("touchEnd")
        shown(first, same=True)
        browser.js("document.getElementById('slices-button').click()")
        small = """return [...document.querySelectorAll("button, input, summary")].filter((one) => one.offsetParent)
            .map((one) => one.getBoundingClientRect())
            .filter((box) => box.height < 24 || box.width < 24 || box.right > 375).length"""
        assert browser.js(small) == 0
        assert browser.js("return document.documentElement.scrollWidth") == 375
        assert "finger" in browser.js("return document.getElementById('keys').innerText")


def test_the_least_that_webgl_promises_is_enough(device: Device, tmp_path: Path) -> None:
    if why := why_none():
        pytest.skip(why)
    volume = clvol.phantoms.marschner_lobb(32)
    page = clvol.save_html(volume, tmp_path / "page.html", device=device)
    wanted = np.asarray(clvol.render(volume, size=(SIZE, SIZE), rays=1, device=device))
    with open_browser(400, 400, SOFTWARE_GL) as browser:
        browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": LEAST})
        assert np.mean(np.abs(drawn(browser, page) - wanted).max(-1) <= WITHIN) >= 0.9998
        long = clvol.save_html(np.arange(1200.0).reshape(2, 2, 300), tmp_path / "long.html", mode="mip", device=device)
        browser.open(long.as_uri())
        browser.wait("document.getElementById('said').textContent.includes('up to 256 samples')", 60, "what is too large")


def test_noisy_samples_take_little_more_than_two_bytes(device: Device, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 20, BALL.shape)
    empty, full = (
        clvol.save_html(clvol.Volume(data), tmp_path / "page.html", device=device, mode="mip").stat().st_size
        for data in (np.pad(np.ones((1, 1, 1)), 1), BALL.data + noise)
    )
    assert empty < 70_000
    assert full - empty < 2.75 * BALL.data.size  # 16 bits in base64 are 2.67


def test_nothing_of_a_patient_is_in_the_page_unless_asked_for(device: Device, tmp_path: Path) -> None:
    header = {"PatientName": "Doe^Jane", "StudyDate": "20240229"}
    volume = clvol.Volume(BALL.data, name="doe_jane_ct.nii.gz", header=header, space="LPS")
    for word, asked in (("metadata", True), ("doe", False)):
        page = clvol.save_html(volume, tmp_path / "page.html", device=device, mode="mip", metadata=asked, title="<b>A head</b>")
        text = page.read_text(encoding="utf-8").partition('id="coefficients"')[0].lower()
        assert ("doe" in text) == ("20240229" in text) == asked, word
        assert "&lt;b&gt;a head" in text
        assert "<b>a head" not in text
        assert str(tmp_path).lower() not in text


def test_what_a_page_cannot_draw_is_refused_by_name(device: Device, tmp_path: Path) -> None:
    holes = BALL.data.astype(np.float32)
    holes[3, 4, 5] = np.nan
    long = clvol.Volume(np.zeros((2, 2, 600), np.uint8))
    corner = clvol.Corner((0, 0, 0), (9, 9, 9))
    refused: list[tuple[Any, dict[str, Any], str]] = [
        (BALL, {"shadow": 0.5}, "shadow"),
        (BALL, {"occlusion": 0.5}, "occlusion"),
        (BALL, {"mode": "attenuated"}, "mode attenuated"),
        (BALL, {"filter": "catmull-rom"}, "catmull-rom"),
        (BALL, {"mode": "isosurface", "outline": 2}, "outline"),
        (BALL, {"gradient": "central"}, "central"),
        (BALL, {"gradient_opacity": 0.5}, "gradient_opacity"),
        (BALL, {"clip": corner}, "corners"),
        (BALL, {"rays": 4}, "rays"),
        (BALL, {"scale_bar": True}, "scale_bar"),
        (clvol.Scene([BALL, BALL]), {}, "several media"),
        (clvol.Volume(holes), {}, "missing samples"),
        (long, {}, "most=256"),
    ]
    for scene, options, word in refused:
        with pytest.raises(OptionError, match=word):
            clvol.save_html(scene, tmp_path / "page.html", device=device, **options)
    with pytest.raises(FormatError, match="html"):
        clvol.save_html(BALL, tmp_path / "page.png", device=device)
    assert list(tmp_path.iterdir()) == []
    hot = BALL.data.astype(np.float32)
    hot[0, 0, 0] = 1e7
    with pytest.warns(ClvolWarning, match="steps of the page's 16 bits"):
        clvol.save_html(hot, tmp_path / "page.html", device=device, mode="mip", window=(500, 1000))


def test_a_large_volume_is_reduced_if_asked(device: Device, tmp_path: Path) -> None:
    sizes = [
        clvol.save_html(BALL, tmp_path / "page.html", device=device, mode="mip", filter="bspline3", most=most).stat().st_size
        for most in (16, None)
    ]
    assert sizes[0] < sizes[1]
    thick = clvol.Volume(np.zeros((12, 40, 40), np.int16), spacing=(1, 1, 2.5))  # of slices as coarse as it becomes
    assert reduced(thick, 16).shape == (12, 16, 16)
    assert reduced(clvol.Volume(np.zeros((12, 40, 40), np.int16)), 16).shape == (5, 16, 16)
