from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import perturb_geometry, perturb_photos, perturb_scene, remeshing
from benchmarks.clipped_pixels import radiance_behind_clipping
from benchmarks.perturb import AXES, perturb
from benchmarks.perturb_masks import true_lamp_faces
from iris_addon.base.images import read_image, write_exr, write_png
from iris_addon.capture.fipt import read_fipt, read_fipt_views
from iris_addon.capture.mesh_files import read_mesh
from iris_addon.capture.reader import read_capture
from iris_addon.evaluate.evaluation import evaluate
from iris_addon.model.response import gamma
from iris_addon.surface.topology import initial_regions
from tests.box_room import ROOM_MAX, ROOM_MIN, box_mesh
from tests.truth_room import LAMP_FACES, SIDE, true_result, write_references, write_truth_room

RADIANCE = 2.0


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """The box room with everything a sweep needs: lamps, relighting jobs, radiance of the training photos."""
    root = write_truth_room(tmp_path / "room")
    write_references(root, np.full((24, 32, 3), 0.3, np.float32))
    lamp = {"emitter": 0, "radiance": [8, 6, 4], "faces": [int(LAMP_FACES[0]), int(LAMP_FACES[0]) + 1]}
    (root / "gt" / "emitters.json").write_text(json.dumps([lamp]))
    ramp = np.linspace(0.001, RADIANCE, 32, dtype=np.float32)
    for view in read_fipt_views(root, "train"):
        write_exr(root / "gt" / "train" / "Image" / f"{view.name}.exr", np.tile(ramp[:, None], (24, 1, 3)))
    film = perturb_photos.Film.of(root)
    film.take(lambda radiance, view: film.shoot(radiance, view.exposure or 1.0), np.random.default_rng(0))
    return root


def contents(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def mesh_of(root: Path):
    return read_mesh(read_fipt(root).mesh_file)[0]


NEEDS_SHARED = {"measured_response"}


@pytest.mark.parametrize("axis", sorted(AXES))
def test_the_first_level_is_the_capture_itself(room, tmp_path, axis):
    before = contents(room)
    made = perturb(room, axis, 0, 0, tmp_path / "out")
    assert made.capture == made.truth == room and contents(room) == before


@pytest.mark.parametrize("axis", sorted(AXES))
def test_a_level_is_the_same_for_the_same_seed_and_leaves_its_source_alone(room, tmp_path, axis):
    if axis in perturb_scene.CHANGES:
        pytest.skip("rendered anew, which takes minutes")
    if axis in NEEDS_SHARED and not perturb_photos.DORF.is_file():
        pytest.skip("shared/crf/dorf_dev.npz is not beside the repository")
    before = contents(room)
    first, second = (perturb(room, axis, 2, 7, tmp_path / str(k)) for k in range(2))
    assert contents(first.capture) == contents(second.capture) and first.note == second.note
    assert contents(room) == before
    assert contents(first.capture) != before, "nothing was perturbed"
    read_capture(first.capture)


def test_raised_exposures_clip_more_and_are_recorded(room, tmp_path):
    made = perturb(room, "exposure", 2, 0, tmp_path / "out")
    for old, new in zip(read_fipt_views(room, "train"), read_fipt_views(made.capture, "train"), strict=True):
        assert new.exposure == pytest.approx(4 * old.exposure)
        assert (read_image(new.photo) >= read_image(old.photo)).all()
        clipped = 255 * (np.linspace(0.001, RADIANCE, 32) * new.exposure >= 1)
        assert np.array_equal(read_image(new.photo)[0, :, 0] == 255, clipped == 255)


def test_photos_without_radiance_are_inverted_and_come_back_the_same(room):
    exact = {view.name: read_image(view.photo) for view in read_fipt_views(room, "train")}
    for path in (room / "gt" / "train" / "Image").iterdir():
        path.unlink()
    film = perturb_photos.Film.of(room)
    assert not film.exact
    film.take(lambda radiance, view: film.shoot(radiance, view.exposure or 1.0), np.random.default_rng(0))
    for view in film.views:
        difference = read_image(view.photo).astype(int) - exact[view.name]
        assert np.abs(difference).max() <= 1 and (difference != 0).mean() < 0.02


def test_white_balance_leaves_green_alone(room, tmp_path):
    made = perturb(room, "white_balance", 4, 0, tmp_path / "out")
    for old, new in zip(read_fipt_views(room, "train"), read_fipt_views(made.capture, "train"), strict=True):
        a, b = read_image(old.photo), read_image(new.photo)
        assert np.array_equal(a[..., 1], b[..., 1]) and not np.array_equal(a[..., 0], b[..., 0])


def test_tone_mapping_lowers_large_scale_contrast(room, tmp_path):
    made = perturb(room, "tone_mapping", 4, 0, tmp_path / "out")
    darkest = read_fipt_views(room, "train")[0].photo
    spread = [
        np.ptp(read_image(root / "train" / "Image" / darkest.name)[12, 4:-4].astype(float))
        for root in (room, made.capture)
    ]
    assert spread[1] < 0.8 * spread[0]


def test_vignetting_darkens_corners_by_so_many_stops(room, tmp_path):
    made = perturb(room, "vignetting", 4, 0, tmp_path / "out")
    old, new = (perturb_photos.Film.of(root) for root in (room, made.capture))
    photos = [read_image(film.views[0].photo).astype(float) for film in (old, new)]
    exposed = [old.response.invert((photo + 0.5) / 255) for photo in photos]
    # The last row is the brightest; its first pixel is the corner, half a pixel off, and few bytes bright at the end.
    assert np.log2(exposed[0][-1, 0] / exposed[1][-1, 0]) == pytest.approx(np.full(3, 2.0), abs=0.4)
    assert np.log2(exposed[0][12, 16] / exposed[1][12, 16]) == pytest.approx(np.zeros(3), abs=0.05)


def test_what_a_photo_clips_is_taken_from_a_darker_one(room, tmp_path):
    """Of a room that shines alike everywhere: two photos that show the same place, and one that shows another."""
    bright, camera = 1.5, gamma()
    here, elsewhere = perturb_photos.Film.of(room).views[:2]
    views = [
        replace(view, photo=tmp_path / f"{k}.png", exposure=exposure, name=str(k))
        for k, (view, exposure) in enumerate([(here, 1.0), (here, 0.5), (elsewhere, 1.0)])
    ]
    for view in views:
        shown = camera.apply(np.full((24, 32, 3), np.clip(bright * view.exposure, 0, 1)))
        write_png(view.photo, np.floor(255 * shown).astype(np.uint8))
    found = radiance_behind_clipping(room, views, camera)
    assert found["0"] == pytest.approx(np.full((24, 32, 3), bright), rel=0.02)
    assert np.isnan(found["1"]).all(), "nothing of it is clipped"
    assert np.isnan(found["2"]).any(), "no darker photo shows all that it shows"


def test_a_scan_lies_on_the_walls_within_its_noise_and_keeps_the_lamps(room, tmp_path):
    old = mesh_of(room)
    off = []
    for level in (1, 4):
        made = perturb(room, "scan", level, 0, tmp_path / str(level))
        scan = mesh_of(made.capture)
        assert len(scan.faces) > 20 * len(old.faces) and (scan.regions is None or len(np.unique(scan.regions)) == 1)
        inside = np.minimum(scan.vertices - ROOM_MIN, ROOM_MAX - scan.vertices)
        off.append(np.median(np.abs(inside).min(1)))
        (lamp,) = true_lamp_faces(made.capture)
        centre = scan.vertices[scan.faces[lamp]].mean((0, 1))
        assert centre == pytest.approx(old.vertices[old.faces[true_lamp_faces(room)[0]]].mean((0, 1)), abs=0.15)
    assert off[0] < 0.01 and 1.5 * off[0] < off[1] < 0.04


def test_odd_responses_rise_and_lie_as_far_from_the_prior_as_asked(room, tmp_path):
    distance = []
    for level in (1, 4):
        made = perturb(room, "response", level, 3, tmp_path / str(level))
        samples = np.load(made.truth / "gt" / "cam" / "crf_gt.npy")
        assert (np.diff(samples) >= 0).all() and samples[0, 0] == 0 and samples[0, -1] == pytest.approx(1)
        distance.append(samples[0])
    assert made.truth == made.capture
    assert not np.allclose(*distance, atol=0.02)


def test_unknown_exposures_are_not_there_at_all(room, tmp_path):
    made = perturb(room, "exposure_noise", 5, 0, tmp_path / "out")
    assert not read_capture(made.capture).exposures_known and made.truth == room


def test_poses_err_by_what_the_level_says_and_stay_rigid(room, tmp_path):
    errors, angles = [], []
    for seed in range(20):
        made = perturb(room, "pose", 4, seed, tmp_path / str(seed))
        for old, new in zip(read_fipt_views(room, "train"), read_fipt_views(made.capture, "train"), strict=True):
            errors.append(np.linalg.norm(new.camera.position - old.camera.position))
            turn = new.camera.c2w[:3, :3].T @ old.camera.c2w[:3, :3]
            assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
            angles.append(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.02, rel=0.15)
    assert np.sqrt(np.mean(np.square(angles))) == pytest.approx(1.0, rel=0.15)


def test_fewer_photos_are_among_the_more_and_keep_their_exposures(room, tmp_path, monkeypatch):
    monkeypatch.setitem(AXES, "photos", replace(AXES["photos"], levels=(-1, 5, 3)))
    names = {view.name: view.exposure for view in read_fipt_views(room, "train")}
    five, three = (
        {v.name: v.exposure for v in read_fipt_views(perturb(room, "photos", k, 1, tmp_path / str(k)).capture, "train")}
        for k in (1, 2)
    )
    assert len(five) == 5 and len(three) == 3
    assert three.items() <= five.items() <= names.items()


def test_holes_let_the_asked_share_of_rays_escape_and_the_lamp_stays(room, tmp_path):
    shares = []
    for level in (1, 4):
        made = perturb(room, "holes", level, 0, tmp_path / str(level))
        shares.append(float(made.note.split("%")[0]) / 100)
        corners = mesh_of(made.truth)
        corners = corners.vertices[corners.faces[np.concatenate(true_lamp_faces(made.truth))]]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        assert area.sum() == pytest.approx(6.0, rel=1e-6)
    assert shares == pytest.approx([0.15, 0.6], abs=0.03)


def test_true_albedo_behind_a_hole_is_what_a_result_shows_there(room, tmp_path):
    made = perturb(room, "holes", 4, 0, tmp_path / "out")
    scores = evaluate(replace(true_result(), mesh=uv_of_walls(mesh_of(made.truth))), made.truth)
    assert scores["kd_psnr_all"] > 60


def uv_of_walls(mesh):
    """``mesh``, cut out of the box room, with the texels that :func:`true_result` gives its walls."""
    centres = mesh.vertices[mesh.faces].mean(1)
    sides = np.stack([centres - ROOM_MIN, ROOM_MAX - centres], -1).reshape(-1, 6)
    wall = np.abs(sides).argmin(1)
    uv = np.stack([(wall + 0.5) / SIDE, np.full(len(wall), 1 - 0.5 / SIDE)], -1)
    return mesh.with_uv(np.repeat(uv[:, None], 3, axis=1).astype(np.float32))


def test_relighting_follows_the_faces_of_a_perturbed_mesh(room, tmp_path):
    made = perturb(room, "density", 1, 0, tmp_path / "out")
    kept = json.loads((made.truth / "relight" / "lights.json").read_text())["one_emitter"]["kept_faces_of_scene_ply"]
    assert np.array_equal(kept, np.concatenate(true_lamp_faces(made.truth))) and len(kept) > 100


def test_subdivision_keeps_area_and_joins_and_knows_its_parents():
    fine, old = remeshing.subdivide_edges(box_mesh(), 0.5)
    ends = fine.vertices[fine.faces]
    assert np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2).max() <= 0.5
    area = 0.5 * np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1)
    assert np.bincount(old, area) == pytest.approx(np.repeat([3.75, 3.75, 5, 5, 6, 6], 2))
    assert (np.diff(old) >= 0).all()
    edges = np.sort(np.stack([fine.faces, np.roll(fine.faces, -1, axis=1)], -1).reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "a gap or a T-junction"


def test_clustering_leaves_the_kept_faces_as_they_are():
    fine, _ = remeshing.subdivide_edges(box_mesh(), 0.3)
    keep = np.zeros(len(fine.faces), bool)
    keep[:40] = True
    coarse, old = remeshing.cluster(fine, 0.8, keep)
    assert len(coarse.faces) < 0.5 * len(fine.faces)
    assert np.array_equal(coarse.vertices[coarse.faces[:40]], fine.vertices[fine.faces[:40]])
    assert np.array_equal(old[:40], np.arange(40))


def test_regions_can_be_merged_into_one(room, tmp_path):
    made = perturb(room, "parts", 4, 0, tmp_path / "out")
    regions = initial_regions(read_capture(made.capture).mesh)
    assert np.bincount(regions).max() == len(regions) - 1


@pytest.mark.parametrize(("axis", "grows"), [("mask_dilated", True), ("mask_false", True), ("mask_missed", False)])
def test_masks_change_in_the_direction_they_say(room, tmp_path, axis, grows):
    perturb_geometry.subdivide(room, room, 40, np.random.default_rng(0))
    made = perturb(room, axis, 4, 0, tmp_path / "out")
    lamps = json.loads((made.capture / "mask.json").read_text())["emitters"]
    size = sum(last - first for lamp in lamps for first, last in lamp["faces"])
    true = len(np.concatenate(true_lamp_faces(room)))
    assert size > true if grows else size < true


class Socket:
    def __init__(self, value):
        self.default_value = value


def shader(strength: float = 0.0) -> dict[str, Socket]:
    return {
        "Base Color": Socket((0.6, 0.4, 0.2, 1.0)), "Roughness": Socket(0.5),
        "Emission Color": Socket((1.0, 0.8, 0.6, 1.0)), "Emission Strength": Socket(strength),
    }  # fmt: skip


def test_a_changed_room_changes_what_it_says_alone():
    wall, lamp, other = shader(), shader(20.0), shader()
    for name, inputs in (("plaster", wall), ("ceiling lamp", lamp), ("brass", other)):
        perturb_scene.CHANGES["gloss"](name, inputs, 0.5)
        perturb_scene.CHANGES["dark_walls"](name, inputs, 0.5)
        perturb_scene.CHANGES["lamp_colour"](name, inputs, 2.0)
        perturb_scene.CHANGES["dominant_lamp"](name, inputs, 1.0)
    assert (
        wall["Base Color"].default_value == pytest.approx((0.3, 0.2, 0.1, 1))
        and wall["Roughness"].default_value == 0.25
    )
    assert other["Base Color"].default_value == (0.6, 0.4, 0.2, 1.0)
    assert lamp["Roughness"].default_value == 0.5 and lamp["Emission Strength"].default_value == 40
    colour = np.array(lamp["Emission Color"].default_value[:3])
    assert colour.mean() == pytest.approx(0.8) and colour / colour[0] == pytest.approx([1, 0.64, 0.36])
