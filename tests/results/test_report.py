from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from iris_addon.base.images import read_image, write_exr
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.model.capture import Capture
from iris_addon.model.device import Device
from iris_addon.model.recovered import LightState
from iris_addon.model.response import gamma, srgb
from iris_addon.results import report as report_html
from iris_addon.results.report import heat, write_report
from iris_addon.results.result import Result
from tests.result_room import room


class Page(HTMLParser):
    """Sources of pictures, text, and whether every element is closed in order."""

    VOID = ("meta", "img", "path", "polyline")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.sources, self.text, self.open, self.tags = [], "", [], set()
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag == "img":
            self.sources.append(dict(attrs)["src"])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert tag in self.VOID or self.open.pop() == tag

    def handle_data(self, data):
        self.text += data + " "


@pytest.fixture
def solved(fipt_room) -> tuple[Result, Capture]:
    capture = read_capture(fipt_room.root)
    result = room()
    uv = result.mesh.uv[: len(capture.mesh.faces)]
    return replace(result, mesh=replace(capture.mesh, uv=uv), report={**result.report, "holdout_psnr": 31.25}), capture


def test_page_stands_alone_and_shows_each_picture(solved, tmp_path):
    result, capture = solved
    view = capture.views[0]
    photo = load_photo(view).values
    path = write_report(result, capture, tmp_path, {view.name: photo}, {"relit": photo})
    html = path.read_text(encoding="utf-8")
    page = Page(html)
    assert "http" not in html and "script" not in page.tags
    assert len(page.sources) == 1 + 3 + 5 + 2, "relit, photo, maps, lamps"
    assert all((tmp_path / source).is_file() for source in page.sources)
    assert "31.25 dB" in page.text and "a lamp is guessed" in page.text


def test_large_pictures_are_shrunk(solved, tmp_path, monkeypatch):
    result, capture = solved
    view = capture.views[0]
    photo = load_photo(view).values
    monkeypatch.setattr(report_html, "MAX_WIDTH", photo.shape[1] // 2)
    write_report(result, capture, tmp_path, {view.name: photo[::2, ::2]})
    pictures = {path.name: read_image(path) for path in (tmp_path / "report").glob("0*.png")}
    assert len(pictures) == 8 and {p.shape for p in pictures.values()} == {
        (photo.shape[0] // 2, photo.shape[1] // 2, 3)
    }
    assert pictures[f"{view.name}-photo.png"].mean() == pytest.approx(255 * photo.mean(), rel=0.05)


def test_error_of_a_perfect_render_is_black_and_of_a_wrong_one_is_not(solved, tmp_path):
    result, capture = solved
    first, second = capture.views[:2]
    photo = load_photo(first).values
    write_report(result, capture, tmp_path, {first.name: photo, second.name: 1 - load_photo(second).values})
    right = read_image(tmp_path / "report" / f"{first.name}-error.png")
    wrong = read_image(tmp_path / "report" / f"{second.name}-error.png")
    assert right.max() <= 6 and wrong.mean() > 30
    assert np.array_equal(read_image(tmp_path / "report" / f"{first.name}-photo.png"), np.round(photo * 255))


def test_radiance_photos_are_shown_with_their_median_at_middle_grey(solved, tmp_path):
    result, capture = solved
    view = capture.views[0]
    grey = load_photo(view).values.mean(-1, keepdims=True)
    values = np.repeat(40.0 * (0.1 + grey), 3, axis=-1)
    path = tmp_path / "radiance.exr"
    write_exr(path, values)
    capture = replace(capture, views=(replace(view, photo=path), *capture.views[1:]))
    write_report(result, capture, tmp_path, {view.name: load_photo(capture.views[0]).values})
    shown = {kind: read_image(tmp_path / "report" / f"{view.name}-{kind}.png") for kind in ("photo", "render", "error")}
    assert np.array_equal(shown["photo"], shown["render"]) and shown["error"].max() <= 6
    assert np.median(shown["photo"]) == pytest.approx(255 * srgb(np.array(0.18)), abs=1)


def test_names_from_files_are_escaped(solved, tmp_path):
    result, capture = solved
    evil = '<script>alert("x")</script>'
    result = replace(result, report={"warnings": [evil], "model": {evil: evil}}, exposures={evil: np.ones(3)})
    page = Page(write_report(result, replace(capture, name=evil), tmp_path, {}).read_text(encoding="utf-8"))
    assert "script" not in page.tags and evil in page.text


def test_a_room_without_lights_or_report_still_has_a_page(solved, tmp_path):
    result, capture = solved
    result = replace(result, emitters=(), outside=None, report={}, exposures={})
    assert "No light was found" in write_report(result, capture, tmp_path, {}).read_text(encoding="utf-8")


def test_each_camera_has_its_curve(solved, tmp_path):
    result, capture = solved
    html = write_report(result, capture, tmp_path, {}).read_text(encoding="utf-8")
    assert html.count('aria-label="response curve"') == 1
    result = replace(result, devices=(Device("Acme <Two>", gamma(0.8), photos=("000_0001",)),))
    html = write_report(result, capture, tmp_path, {}).read_text(encoding="utf-8")
    assert html.count('aria-label="response curve"') == 2 and "camera 2, Acme &lt;Two&gt;" in html


def test_light_states_are_listed_with_the_lamps_that_are_on(solved, tmp_path):
    result, capture = solved
    assert "Light states" not in write_report(result, capture, tmp_path, {}).read_text(encoding="utf-8")
    evil = "<u>bed</u>"
    states = (
        LightState("all", ("a", "b"), np.array([emitter.radiance for emitter in result.emitters])),
        LightState(evil, ("c",), np.array([np.zeros(3), [12.5, 6.25, 3.125]])),
    )
    page = Page(write_report(replace(result, light_states=states), capture, tmp_path, {}).read_text(encoding="utf-8"))
    assert evil in page.text
    assert "u" not in page.tags
    assert "12.5 6.25 3.12" in page.text


def test_heat_rises_in_lightness():
    assert np.allclose(srgb(np.array([0.0, 0.0031308, 0.214041, 1.0])), [0, 0.04045, 0.5, 1], atol=1e-4)
    assert (np.diff(heat(np.linspace(0, 1, 50)) @ [0.2126, 0.7152, 0.0722]) > 0).all()
