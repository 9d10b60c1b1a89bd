"""report.html, which shows a result in a browser: one page without scripts, its pictures in report/.

All text from files or captures is escaped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.files import atomic_write, require_own_folder
from ..base.images import to_codes, write_png
from ..base.parallel import over_each
from ..capture.photos import load_photo, shrink
from ..model.capture import Camera, Capture, View
from ..model.device import Device
from ..model.response import Response, grey_exposure, srgb
from ..rays.tracer import Tracer
from .files import PICTURES, REPORT_PAGE
from .lamp_pictures import write_lamp_pictures
from .maps import MapRenderer, ViewMaps
from .result import Result

FloatArray = NDArray[np.floating]
MAX_VIEWS = 6
"""Photos shown at most."""
CHANNEL_COLOURS = ("#d33", "#2a2", "#36d")
MAX_WIDTH = 1280
"""Pixels in a row of a picture of the report; larger pictures are shrunk."""
ERROR_GAIN = 4.0
"""Factor on differences of display values, for the picture of them."""


def write_report(
    result: Result,
    capture: Capture,
    folder: Path,
    pictures: Mapping[str, FloatArray],
    gallery: Mapping[str, FloatArray] | None = None,
) -> Path:
    """Write ``folder/report.html`` and its pictures.

    Args:
        pictures: re-renders by view name, (H, W, 3) of about the photo's shape, training or held-out views: display
            values in [0, 1], radiance where the photo is radiance. Without any, maps are shown for a few training
            views.
        gallery: further pictures by caption (relit, inserted), (H, W, 3) display values.

    Returns:
        The path of the page.

    Raises:
        BadInput: ``folder/report`` is a link.
        IrisError: the folder cannot be written.
    """
    require_own_folder(folder / PICTURES)
    views = {view.name: view for view in (*capture.val_views, *capture.views)}
    shown = [views[name] for name in pictures if name in views] or _spread(capture.views, 3)
    shown = shown[:MAX_VIEWS]
    saver = Pictures(folder / PICTURES)
    tracer = Tracer(result.mesh, without=result.panes)
    renderer = MapRenderer(result, tracer)
    lamps = write_lamp_pictures(result, capture.views, tracer, folder)
    maps = {view.name: renderer.maps(view.camera.shrunk(MAX_WIDTH)) for view in shown}
    sections = [
        _summary(result, capture),
        _gallery(saver, gallery or {}),
        _photos(saver, shown, pictures),
        _maps(saver, shown, maps),
        _responses(result),
        _emitters(result, lamps),
        _light_states(result),
        _outside(result),
        _sun(result),
        _model(result),
        _exposures(result),
    ]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(capture.name)} · IRIS</title><style>{CSS}</style></head><body><main>"
        + "".join(sections)
        + "</main></body></html>\n"
    )
    saver.save()
    path = folder / REPORT_PAGE
    atomic_write(path, lambda temporary: temporary.write_text(page, encoding="utf-8"))
    return path


def _spread(views: Sequence[View], count: int) -> list[View]:
    """``count`` views evenly over the capture."""
    return [views[i] for i in np.unique(np.linspace(0, len(views) - 1, count).astype(int))] if views else []


# ---- pictures ------------------------------------------------------------------------------------------------------


def _gallery(saver: Pictures, gallery: Mapping[str, FloatArray]) -> str:
    figures = "".join(saver.figure(f"gallery-{caption}", image, caption) for caption, image in gallery.items())
    return f'<section><h2>With the recovered room</h2><div class="grid">{figures}</div></section>' if figures else ""


def _photos(saver: Pictures, shown: Sequence[View], pictures: Mapping[str, FloatArray]) -> str:
    rows = []
    for view in shown:
        if view.photo is None or view.name not in pictures:
            continue
        photo = load_photo(view.reduced_to(MAX_WIDTH))
        valid = np.repeat(photo.valid[..., None].astype(np.float32), 3, -1)
        theirs, ours, valid = (_shown(image, view.camera) for image in (photo.values, pictures[view.name], valid))
        if photo.hdr:  # radiance is looked at with its median at middle grey
            exposure = grey_exposure(photo.values[photo.valid])
            theirs, ours = srgb(theirs * exposure), srgb(ours * exposure)
        theirs, ours = np.clip(theirs, 0.0, 1.0), np.clip(ours, 0.0, 1.0)
        error = (np.abs(ours - theirs) * valid).mean(-1)
        kind = "held out" if view.split == "val" else "used"
        rows.append(
            '<div class="triple">'
            + saver.figure(f"{view.name}-photo", theirs, f"{view.name}: photo ({kind})")
            + saver.figure(f"{view.name}-render", ours, "re-render")
            + saver.figure(f"{view.name}-error", heat(error * ERROR_GAIN), f"error × {ERROR_GAIN:g}")
            + "</div>"
        )
    return f"<section><h2>Photo, re-render, error</h2>{''.join(rows)}</section>" if rows else ""


def _shown(image: FloatArray, camera: Camera) -> FloatArray:
    """``image`` (H, W, 3) of the view of ``camera`` at the size it has on the page."""
    small = camera.shrunk(MAX_WIDTH)
    same = image.shape[:2] == (small.height, small.width)
    return image if same else shrink(image, small.height, small.width)


def _maps(saver: Pictures, shown: Sequence[View], maps: Mapping[str, ViewMaps]) -> str:
    peak = max((float(m.emission.max()) for m in maps.values()), default=0.0)
    rows = []
    for view in shown:
        m = maps[view.name]
        # Lights span decades: log1p keeps the dim ones visible beside the bright.
        lights = np.log1p(m.emission) / np.log1p(peak) if peak > 0 else m.emission
        rows.append(
            '<div class="grid">'
            + saver.figure(f"{view.name}-albedo", srgb(m.base_color), f"{view.name}: base color")
            + saver.figure(f"{view.name}-roughness", m.roughness, "roughness")
            + saver.figure(f"{view.name}-metallic", m.metallic, "metallic")
            + saver.figure(f"{view.name}-lights", lights, f"lights (log, white = {peak:.3g})")
            + saver.figure(f"{view.name}-confidence", heat(m.confidence), "confidence")
            + "</div>"
        )
    return f"<section><h2>Materials and lights</h2>{''.join(rows)}</section>"


# ---- text and tables -----------------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Cells are HTML already."""
    heading = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{heading}</tr></thead><tbody>{body}</tbody></table></div>'


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{escape(str(key))}: {_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return "–" if value is None else escape(str(value))


def _summary(result: Result, capture: Capture) -> str:
    report = result.report
    seconds = report.get("seconds") or {}
    total = sum(seconds.values()) if isinstance(seconds, Mapping) else None
    facts = {
        "preset": report.get("preset"),
        "photos": report.get("n_views", len(capture.views)),
        "noise of the photos": _share((report.get("photos") or {}).get("noise")),
        "lights": len(result.emitters),
        "held-out PSNR": None if report.get("holdout_psnr") is None else f"{report['holdout_psnr']:.2f} dB",
        "seconds": None if total is None else f"{total:.0f}",
        "rays": None if report.get("rays_traced") is None else f"{report['rays_traced']:.2e}",
        "rays on": report.get("rays_on"),
        "patches": report.get("n_patches"),
        "texels a side": (report.get("atlas") or {}).get("side"),
        "texels per metre": (report.get("atlas") or {}).get("texels_per_metre"),
        "peak memory": None
        if not report.get("peak_memory_bytes")
        else f"{report['peak_memory_bytes'] / 2**30:.1f} GiB",
    }
    tiles = "".join(
        f"<div><b>{_text(value)}</b><span>{key}</span></div>" for key, value in facts.items() if value is not None
    )
    warnings = "".join(f"<li>{_text(warning)}</li>" for warning in report.get("warnings") or ())
    stages = _bars(seconds) if isinstance(seconds, Mapping) and seconds else ""
    return (
        f"<h1>{escape(capture.name)}</h1><div class='tiles'>{tiles}</div>"
        + (f'<ul class="warnings">{warnings}</ul>' if warnings else "")
        + stages
    )


def _share(value: float | None) -> str | None:
    """A share in per cent; None where it is not known."""
    return None if value is None else f"{value:.1%}"


def _bars(seconds: Mapping[str, float]) -> str:
    longest = max(max(seconds.values()), 1e-9)
    rows = "".join(
        f'<span>{escape(str(name))}</span><i style="width:{100 * value / longest:.1f}%"></i><span>{value:.1f} s</span>'
        for name, value in seconds.items()
    )
    return f'<section><h2>Seconds per stage</h2><div class="bars">{rows}</div></section>'


def _responses(result: Result) -> str:
    """The curve of each camera."""
    devices = (Device("", result.response, result.local), *result.devices)
    curves = "".join(
        _curve(device.response, f"camera {number}{f', {device.name}' if device.name else ''}" if number else "")
        for number, device in enumerate(devices, start=len(devices) > 1)
    )
    return f"<section><h2>Camera response</h2>{curves}</section>"


def _curve(response: Response, of: str) -> str:
    """The curve as inline SVG beside its family, ``of`` a camera among several."""
    x = np.linspace(0, 1, response.samples.shape[1])[::8]
    lines = "".join(
        f'<polyline fill="none" stroke="{color}" stroke-width="2" points="'
        + " ".join(f"{200 * a:.1f},{200 * (1 - b):.1f}" for a, b in zip(x, row[::8], strict=True))
        + '"/>'
        for color, row in zip(CHANNEL_COLOURS, response.samples, strict=True)
    )
    grid = "".join(f'<path d="M{50 * i} 0V200M0 {50 * i}H200" stroke="currentColor" opacity=".15"/>' for i in range(5))
    coefficients = ", ".join(f"{value:.4g}" for value in response.coefficients)
    return (
        f'<svg viewBox="-8 -8 216 216" role="img" aria-label="response curve">{grid}{lines}</svg>'
        f"<p>{escape(f'{of}: ' if of else '')}{escape(response.family)}"
        f"{f' ({coefficients})' if coefficients else ''}; relative exposure to the right, display value up.</p>"
    )


def _swatch(linear: FloatArray) -> str:
    peak = float(np.max(linear))
    r, g, b = np.round(255 * srgb(np.asarray(linear) / peak)).astype(int) if peak > 0 else (0, 0, 0)
    return f'<span class="swatch" style="background:rgb({r},{g},{b})"></span>'


def _emitters(result: Result, pictures: Mapping[int, Path]) -> str:
    def picture(number: int) -> str:
        if number not in pictures:
            return ""
        return f'<img src="{PICTURES}/{pictures[number].name}" width="48" height="48" alt="lamp {number}">'

    ordered = sorted(result.emitters, key=lambda emitter: -float(emitter.area * np.mean(emitter.radiance)))
    rows = [
        [
            str(emitter.id),
            picture(emitter.id),
            _swatch(emitter.radiance),
            " ".join(f"{value:.3g}" for value in emitter.radiance),
            f"{emitter.area:.4f}",
            f"{np.pi * emitter.area * np.mean(emitter.radiance):.3g}",
            "even" if emitter.profile is None else f"{emitter.profile.beam_angle:.0f}°",
            str(len(emitter.faces)),
            f'<meter min="0" max="1" value="{emitter.confidence:.2f}"></meter> {emitter.confidence:.2f}',
        ]
        for emitter in ordered
    ]
    head = ("id", "photo", "color", "radiance R G B", "area, m²", "power per side", "beam", "faces", "confidence")
    body = _table(head, rows) if rows else "<p>No light was found in the room itself.</p>"
    return f"<section><h2>Lights</h2>{body}</section>"


def _light_states(result: Result) -> str:
    """The lamps that are on in each state, with their radiance; nothing where there is one state."""
    if not result.light_states:
        return ""
    rows = [
        [
            escape(state.name),
            str(len(state.photos)),
            "; ".join(
                f"{emitter.id}: {_swatch(radiance)} {' '.join(f'{value:.3g}' for value in radiance)}"
                for emitter, radiance in zip(result.emitters, state.radiance, strict=True)
                if radiance.any()
            ),
        ]
        for state in result.light_states
    ]
    first = escape(result.light_states[0].name)
    return (
        f"<section><h2>Light states</h2>{_table(('state', 'photos', 'lamps that are on, radiance R G B'), rows)}"
        f"<p>All other figures of lights are those of {first}.</p></section>"
    )


def _outside(result: Result) -> str:
    if result.outside is None:
        return ""
    mean = result.outside.mean
    return (
        f"<section><h2>Light from outside</h2><p>{_swatch(np.maximum(mean, 0))} {len(result.outside.sh)} spherical "
        f"harmonics, mean radiance {' '.join(f'{value:.3g}' for value in mean)}.</p></section>"
    )


def _sun(result: Result) -> str:
    if result.sun is None:
        return ""
    level, up = result.sun.irradiance, result.sun.direction @ np.asarray(result.up)
    return (
        f"<section><h2>Sun</h2><p>{_swatch(level)} {np.degrees(np.arcsin(np.clip(up, -1, 1))):.1f}° above the horizon, "
        f"irradiance {' '.join(f'{value:.3g}' for value in level)}.</p></section>"
    )


def _model(result: Result) -> str:
    model = result.report.get("model")
    if not model:
        return ""
    items = model.items() if isinstance(model, Mapping) else ((str(i), entry) for i, entry in enumerate(model))
    rows = [[escape(str(name)), _text(value)] for name, value in items]
    return (
        f"<section><h2>What was switched on, and what it earned</h2>{_table(('refinement', 'value'), rows)}</section>"
    )


def _exposures(result: Result) -> str:
    rows = []
    for name, value in result.exposures.items():
        balance = value / value[1] if value[1] else value
        rows.append(
            [
                escape(name),
                f"{value[1]:.4g}",
                f"{np.log2(max(value[1], 1e-30)):+.2f}",
                *(f"{b:.3f}" for b in balance[[0, 2]]),
            ]
        )
    table = _table(("photo", "exposure", "stops", "R / G", "B / G"), rows)
    title = f"Exposure and white balance of {len(rows)} photos"
    return f"<section><details><summary>{title}</summary>{table}</details></section>"


# ---- style sheet ---------------------------------------------------------------------------------------------------


CSS = """
:root{--bg:#fbfaf8;--fg:#222;--dim:#666;--line:#ddd;--card:#fff;--accent:#c4621a}
@media(prefers-color-scheme:dark){:root{--bg:#17171a;--fg:#e6e4e0;--dim:#999;--line:#333;--card:#202024;--accent:#f0954a}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--fg);font:15px/1.5 system-ui,sans-serif}
main{max-width:1200px;margin:0 auto;padding:1.5rem}
h1{font-size:1.8rem;margin:.5rem 0 1rem}
h2{font-size:1.05rem;margin:2rem 0 .7rem;color:var(--accent);font-weight:600}
.tiles{display:flex;flex-wrap:wrap;gap:.7rem}
.tiles div{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:.6rem 1rem}
.tiles b{display:block;font-size:1.2rem}
.tiles span{color:var(--dim);font-size:.8rem}
.warnings{background:var(--card);border-left:4px solid var(--accent);margin:1rem 0;padding:.6rem 1rem .6rem 2rem}
.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:.6rem;margin-bottom:.6rem}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(210px,1fr));gap:.6rem;margin-bottom:.6rem}
figure{margin:0}
img{width:100%;height:auto;border-radius:6px;display:block;background:#000}
figcaption{color:var(--dim);font-size:.8rem;padding:.2rem 0}
svg{width:min(320px,100%);display:block}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .9rem .3rem 0;text-align:left;border-bottom:1px solid var(--line)}
th{color:var(--dim);font-weight:500}
.swatch{display:inline-block;width:2.2em;height:1.2em;border-radius:4px;
  border:1px solid var(--line);vertical-align:middle}
.bars{display:grid;max-width:640px;
  grid-template-columns:max-content 1fr max-content;gap:.25rem .8rem;align-items:center}
.bars i{height:.7em;background:var(--accent);border-radius:3px;min-width:2px}
summary{cursor:pointer}
@media print{body{background:#fff}}
"""


# ---- picture files -------------------------------------------------------------------------------------------------


class Pictures:
    """Pictures of the page: :meth:`figure` gives the HTML for an array, :meth:`save` writes all as PNG files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._codes: dict[str, NDArray[np.uint8]] = {}

    def figure(self, name: str, image: FloatArray, caption: str) -> str:
        """HTML of ``image``, (H, W, 3) or (H, W) display values, with its caption; ``name`` is that of its file."""
        stem = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)[:80]
        while stem in self._codes:
            stem += "_"
        self._codes[stem] = to_codes(image)
        height, width = image.shape[:2]
        return (
            f'<figure><img src="{self._folder.name}/{stem}.png" width="{width}" height="{height}" loading="lazy" '
            f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
        )

    def save(self) -> None:
        """Write all pictures."""
        over_each(list(self._codes), lambda stem: write_png(self._folder / f"{stem}.png", self._codes[stem]))


def heat(values: FloatArray) -> FloatArray:
    """(..., 3) display values from black over blue, magenta and orange to white, for values 0 to 1; lightness rises."""
    stops = np.array([[0.0, 0.0, 0.02], [0.2, 0.1, 0.5], [0.75, 0.2, 0.45], [1.0, 0.6, 0.2], [1.0, 1.0, 0.9]])
    position = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(values, position, stops[:, c]) for c in range(3)], -1)
