"""Everything on the bundled capture: the first thing to run, and a short example of the use of each room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from iris_addon.base.errors import BadInput
from iris_addon.base.files import write_json
from iris_addon.base.progress import Progress
from iris_addon.base.untrusted import read_json
from iris_addon.capture.photos import load_photo
from iris_addon.capture.reader import read_capture
from iris_addon.config import preset
from iris_addon.edits.jobs import insertion_edits, relight_edit
from iris_addon.edits.scene_edit import SceneEdit
from iris_addon.model.capture import Capture, View
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import srgb
from iris_addon.rays.tracer import Tracer
from iris_addon.results.result import Result

from .outcome import Outcome, summarise
from .pictures import Developer, FloatArray, photo_exposure, write_picture

CAPTURE = Path(__file__).resolve().parents[1] / "assets" / "demo_room"
RENDER = RenderSettings(samples=48)
SHOWN_METRICS = ("kd_psnr", "kd_psnr_all", "emission_iou", "emission_log_l2", "crf_l2")


def run_demo(out: Path, progress: Progress) -> Outcome:
    """Solve the bundled room into ``out``; write scene.blend, pictures, report.html and evaluation.json there."""
    from iris_addon.blender.apply.scene_files import apply
    from iris_addon.evaluate.evaluation import evaluate
    from iris_addon.pipeline import solve
    from iris_addon.results.report import write_report

    if not CAPTURE.is_dir():
        fix = "run it in a clone of the repository, which has the room in assets/ (the package leaves it out)"
        raise BadInput("the bundled capture is missing", fix, CAPTURE)
    capture = read_capture(CAPTURE)
    result = solve(capture, preset("balanced"), out, progress)
    with progress.stage("scene"):
        apply(result, out / "scene.blend", views=capture.views)
    with progress.stage("pictures"):
        view = max(capture.views, key=visible_detail)
        shown, rerender = make_pictures(result, capture, view, progress)
        files = [write_picture(out / "pictures" / f"{name}.png", image) for name, image in shown.items()]
    scores = evaluate(result, CAPTURE, progress=progress)
    write_json(out / "evaluation.json", scores)
    gallery = {name.replace("_", " "): shown[name] for name in ("relit", "inserted")}
    report = write_report(result, capture, out, {view.name: rerender}, gallery)
    figures = {
        **summarise(result),
        **{name: scores[name] for name in SHOWN_METRICS if name in scores},
        "report": report,
        "scene": out / "scene.blend",
        "pictures": files,
    }
    return Outcome.of("The bundled room is solved; look at", figures)


def make_pictures(
    result: Result, capture: Capture, view: View, progress: Progress
) -> tuple[Mapping[str, FloatArray], FloatArray]:
    """Pictures by name and the re-render of ``view`` alone, display values (H, W, 3)."""
    from iris_addon.blender.insert.differential import insert_onto_photo
    from iris_addon.blender.render.cycles import render_views
    from iris_addon.results.maps import MapRenderer

    def rendered(edit: SceneEdit | None) -> FloatArray:
        (radiance,) = render_views(result, [view.camera], edit=edit, settings=RENDER)
        return radiance

    photo = load_photo(view).values
    rerender = Developer(result, Path(), "photo").develop(view, rendered(None))
    progress.update(1 / 3)
    relit = Developer(result, Path(), "auto").develop(view, rendered(night(result)))
    progress.update(2 / 3)
    edits = [edit for _, edit in insertion_edits(result, read_json(CAPTURE / "insert" / "objects.json"))]
    edit, host = best_seen(edits, capture.views, Tracer(result.mesh, without=result.panes))
    onto = load_photo(host).values
    device = result.device_of(host)
    exposure = photo_exposure(result, host) * device.gain(onto)
    inserted = insert_onto_photo(result, host.camera, onto, exposure, edit, RENDER, device.response)
    renderer = MapRenderer(result)
    maps = renderer.maps(view.camera)
    # The view that shows most of the lamps; ``view`` may show none.
    emission = max((renderer.maps(v.camera).emission for v in capture.views[::3]), key=lambda e: (e > 0).sum())
    peak = max(float(emission.max()), 1e-9)
    pictures = {
        "photo_and_rerender": np.concatenate([photo, rerender], axis=1),
        "relit": relit,
        "inserted": inserted,
        "albedo": srgb(maps.base_color),
        "lights": np.log1p(emission) / np.log1p(peak),  # a logarithmic scale keeps dim lamps visible
    }
    return pictures, rerender


def visible_detail(view: View) -> float:
    """How much detail a photo shows: the mean gradient of its values between nearly black and nearly clipped."""
    grey = np.clip(load_photo(view).values.mean(-1), 0.1, 0.9)
    return float(np.abs(np.diff(grey, axis=0)).mean() + np.abs(np.diff(grey, axis=1)).mean())


def night(result: Result) -> SceneEdit:
    """The strongest lamp (in the bundled room the window) and the light from outside off, the other lamps on."""
    strongest = max(result.emitters, key=lambda lamp: lamp.area * float(lamp.radiance.mean()), default=None)
    off = {} if strongest is None or len(result.emitters) == 1 else {str(strongest.id): {"off": True}}
    return relight_edit(result, {"recovered": off, "outside": 0.0})


def best_seen(edits: Sequence[SceneEdit], views: Sequence[View], tracer: Tracer) -> tuple[SceneEdit, View]:
    """The edit and the photo that show most of the inserted balls, by the area of their discs in pixels."""

    def seen(edit: SceneEdit, view: View) -> float:
        camera, area = view.camera, 0.0
        for ball in edit.spheres:
            local = camera.local(ball.center)
            if -local[2] < ball.radius:
                continue
            (i, j), radius = camera.project(local), camera.fx * ball.radius / -local[2]
            inside = radius < i < camera.width - radius and radius < j < camera.height - radius
            if inside and tracer.visible(camera.position[None], ball.center[None])[0]:
                area += np.pi * radius**2
        return area

    return max(((edit, view) for edit in edits for view in views), key=lambda pair: seen(*pair))
