from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from iris_addon.base.errors import BadInput
from iris_addon.base.images import read_exr, write_exr, write_png
from iris_addon.evaluate import metrics
from iris_addon.evaluate.evaluation import evaluate
from iris_addon.evaluate.pictures import fit_gains, score_held_out
from iris_addon.model.capture import Camera, Photo, View
from iris_addon.model.device import Device
from iris_addon.model.recovered import Backdrop, LightState, OutsideLight, Sunlight, Textures
from iris_addon.model.response import Response, gamma
from iris_addon.results.maps import MapRenderer, bilinear
from tests.box_room import HEIGHT, WIDTH
from tests.truth_room import LAMP_FACES, LAMP_RADIANCE, true_result, write_references, write_truth_room


def brightness_of(textures: Textures, factor: float) -> Textures:
    return replace(textures, base_color=textures.base_color * np.float32(factor))


@pytest.mark.parametrize("side_by_side", [False, True])
def test_the_truth_scores_perfectly(tmp_path, side_by_side):
    scores = evaluate(true_result(), write_truth_room(tmp_path / "room", side_by_side))
    for name in ("kd_psnr", "kd_psnr_all", "a_psnr", "a_lobe_psnr", "roughness_psnr"):
        for suffix in ("", "_valid"):
            assert scores[name + suffix] > 70, name
            if name != "roughness_psnr":
                assert scores[f"{name}{suffix}_8x8"] > 70, name
    assert scores["kd_psnr_si"] > 70 and scores["metallic_l2"] == pytest.approx(0, abs=1e-12)
    assert scores["emission_iou"] == 1 and scores["emission_log_l2"] == pytest.approx(0, abs=1e-10)
    assert scores["crf_l2"] == 0 and scores["exposure_log2_rmse"] == pytest.approx(0, abs=1e-12)
    assert set(scores["left_out"]) == {
        "nvs_psnr", "nvs_ssim", "relight_psnr", "relight_ssim", "insert_psnr", "insert_psnr_around", "lpips"
    }  # fmt: skip


def test_constant_grey_scores_as_its_closed_form(tmp_path):
    root = write_truth_room(tmp_path / "room")
    result = true_result()
    grey = replace(
        result.textures, base_color=np.full((8, 8, 3), 0.5, np.float32), metallic=np.zeros((8, 8), np.float32)
    )
    scores = evaluate(replace(result, textures=grey), root)
    for index, (name, value) in enumerate(scores["per_view"]["kd_psnr_all"].items()):
        kd, emit = (read_exr(root / "gt" / "train" / kind / f"{index:03d}_0001.exr") for kind in ("DiffCol", "Emit"))
        surface = emit.max(-1) == 0
        error = (np.round(255 * kd) / 255 - 128 / 255) ** 2 * surface[..., None]
        assert value == pytest.approx(-10 * np.log10(error.mean())), name
        assert scores["per_view"]["kd_psnr_all_valid"][name] == pytest.approx(-10 * np.log10(error[surface].mean()))


def test_the_diffuse_lobe_changes_the_directional_albedo_only(tmp_path):
    root = write_truth_room(tmp_path / "room")
    lambert = evaluate(true_result(), root)
    burley = evaluate(replace(true_result(), report={"model": {"diffuse": {"lobe": "burley"}}}), root)
    assert burley["a_psnr"] == lambert["a_psnr"] and burley["kd_psnr"] == lambert["kd_psnr"]
    assert burley["a_lobe_psnr"] < 40 < lambert["a_lobe_psnr"]


def test_only_fully_rough_pixels_count_for_kd_psnr(tmp_path):
    root = write_truth_room(tmp_path / "room")
    result = true_result()
    result.textures.base_color[0, 3:5] = 0.0  # the two walls that are not rough
    scores = evaluate(result, root)
    assert scores["kd_psnr"] > 70 and scores["kd_psnr_all"] < 40


def test_si_forgives_one_factor(tmp_path):
    root = write_truth_room(tmp_path / "room")
    result = true_result()
    lamp = replace(result.emitters[0], radiance=LAMP_RADIANCE / 0.7)
    scaled = replace(result, textures=brightness_of(result.textures, 0.7), emitters=(lamp,))
    scores = evaluate(scaled, root)
    assert scores["kd_psnr"] < 30 and scores["kd_psnr_si"] > 60
    assert scores["emission_log_l2"] > 1e-3 and scores["emission_log_l2_si"] == pytest.approx(0, abs=1e-9)


def test_a_false_lamp_lowers_iou(tmp_path):
    root = write_truth_room(tmp_path / "room")
    result = true_result()
    more = replace(result.emitters[0], faces=np.array([10, 11]))
    assert evaluate(replace(result, emitters=(more,)), root)["emission_iou"] < 0.9
    assert evaluate(replace(result, emitters=()), root)["emission_iou"] == 0


def test_the_sun_is_compared_with_the_strongest_true_one(tmp_path):
    root = write_truth_room(tmp_path / "room")
    suns = [
        {"direction": [1.0, 0.0, 0.0], "irradiance": [1.0, 1.0, 1.0]},
        {"direction": [0.0, 0.6, 0.8], "irradiance": [20.0, 18.0, 15.0]},
    ]
    facts = root / "gt" / "meta_gt.json"
    facts.write_text(json.dumps({"suns": suns}))
    turn = np.radians(3.0)
    toward = np.array([0.0, 0.6 * np.cos(turn) - 0.8 * np.sin(turn), 0.6 * np.sin(turn) + 0.8 * np.cos(turn)])
    found = Sunlight(toward, np.array([22.0, 19.8, 16.5]))
    scores = evaluate(replace(true_result(), sun=found), root)
    assert scores["sun_degrees"] == pytest.approx(3.0, abs=1e-6)
    assert scores["sun_irradiance"] == pytest.approx(1.1)
    assert evaluate(true_result(), root)["left_out"]["sun_degrees"] == "no sun was found"
    facts.write_text('{"suns": [{"direction": [0, 0, 1]}]}')
    with pytest.raises(BadInput, match=r"suns\[0\].irradiance"):
        evaluate(true_result(), root)
    facts.write_text('{"suns": [{"direction": [0, 0, 0], "irradiance": [1, 1, 1]}]}')
    with pytest.raises(BadInput, match=r"suns\[0\]' has no unit direction"):
        evaluate(true_result(), root)


def test_views_without_a_true_emitter_do_not_count_for_emission(tmp_path):
    root = write_truth_room(tmp_path / "room")
    for path in sorted((root / "gt" / "train" / "Emit").iterdir())[1:]:
        write_exr(path, np.zeros((HEIGHT, WIDTH, 3)))
    scores = evaluate(true_result(), root)
    assert list(scores["per_view"]["emission_iou"]) == ["000_0001"]


def test_pictures_that_match_their_references_score_perfectly_and_edits_arrive(tmp_path):
    root = write_truth_room(tmp_path / "room")
    radiance = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    write_references(root, radiance)
    edits = []

    def render(result, cameras, *, edit=None, settings, on_view=None):
        assert settings.samples == 1
        edits.append(edit)
        for index in range(len(cameras)):
            on_view(index, radiance)
        return [radiance] * len(cameras)

    scores = evaluate(true_result(), root, render=render, samples=1)
    for name in ("nvs_psnr", "relight_psnr", "insert_psnr", "insert_psnr_around", "nvs_psnr_si", "relight_psnr_si"):
        assert scores[name] > 55, name
    assert scores["nvs_ssim"] > 0.999 and scores["relight_ssim"] == pytest.approx(1)
    assert set(scores["per_view"]["relight_psnr"]) == {
        f"{kind}/{k:03d}_0001" for kind in ("new_lights", "one_emitter") for k in (0, 1)
    }
    nvs, new_lights, one_emitter, inserted = edits
    assert nvs is None
    assert len(new_lights.lights) == 1 and new_lights.face_emission.max() == 0
    assert np.array_equal(np.flatnonzero(one_emitter.face_emission.max(1)), LAMP_FACES)
    assert inserted.spheres[0].radius == 0.2
    assert set(scores["left_out"]) == {"lpips"}


def test_references_are_compared_in_the_light_state_that_they_name(tmp_path):
    root = write_truth_room(tmp_path / "room")
    radiance = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    write_references(root, radiance)
    off = np.zeros((1, 3))
    states = (
        LightState("day", (), off, OutsideLight(np.ones((1, 3)))),
        LightState("evening", (), np.array([LAMP_RADIANCE])),
    )
    first = replace(true_result().emitters[0], radiance=off[0])
    result = replace(true_result(), emitters=(first,), outside=states[0].outside, light_states=states)
    lights, objects = root / "relight" / "lights.json", root / "insert" / "objects.json"
    rendered = []

    def render(result, cameras, *, edit=None, **_):
        rendered.append((result, edit))
        return [radiance] * len(cameras)

    unnamed = evaluate(result, root, render=render, samples=1)
    assert unnamed["left_out"]["relight_psnr of one_emitter"] == "it does not say in which light state it is"
    assert "insert_psnr of view 1" in unnamed["left_out"] and "insert_psnr" not in unnamed
    assert {name.split("/")[0] for name in unnamed["per_view"]["relight_psnr"]} == {"new_lights"}
    (new_lights,) = rendered  # the photos of this capture do not name theirs either
    assert np.array_equal(np.flatnonzero(new_lights[1].black_faces), LAMP_FACES)

    for state in ("evening", "night"):
        content = json.loads(lights.read_text())
        content["one_emitter"]["light_state"] = state
        lights.write_text(json.dumps(content))
        content = json.loads(objects.read_text())
        content["views"][0]["light_state"] = state
        objects.write_text(json.dumps(content))
        rendered.clear()
        scores = evaluate(result, root, render=render, samples=1)
        if state == "evening":
            _, one_emitter, inserted = rendered
            np.testing.assert_array_equal(one_emitter[1].face_emission[LAMP_FACES[0]], LAMP_RADIANCE)
            np.testing.assert_array_equal(inserted[0].emitters[0].radiance, LAMP_RADIANCE)
            assert inserted[0].outside is None
            assert scores["insert_psnr"] > 55 and "insert_psnr of view 1" not in scores["left_out"]
        else:
            assert scores["left_out"]["insert_psnr of view 1"] == "the light state 'night' was not solved"
            assert "insert_psnr" not in scores


def test_twice_the_light_leaves_only_si_scores_unchanged(tmp_path):
    root = write_truth_room(tmp_path / "room")
    radiance = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    write_references(root, radiance)

    def render(result, cameras, **_):
        return [2 * radiance] * len(cameras)

    scores = evaluate(true_result(), root, render=render)
    for name in ("nvs_psnr", "relight_psnr", "insert_psnr"):
        assert scores[name] < 25 and scores[name + "_si"] > 45, name


def test_a_folder_without_truth_or_held_out_photos_is_bad_input(fipt_room):
    with pytest.raises(BadInput, match="neither ground truth nor held-out photos"):
        evaluate(true_result(), fipt_room.root)
    with pytest.raises(BadInput):
        evaluate(true_result(), fipt_room.root / "missing")


# ---- held-out photos -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("response", [gamma(), gamma(0.6)])
def test_exposure_and_white_balance_of_a_photo_are_found(response: Response):
    rng = np.random.default_rng(3)
    radiance = rng.lognormal(0, 1, (40, 50, 3))
    gains = np.array([0.5, 0.3, 0.7])
    values = np.floor(255 * response.apply(np.clip(radiance * gains, 0, 1))) / 255  # a good share of it saturated
    values[:4] = 0.0
    valid = np.ones((40, 50), bool)
    valid[:4] = False  # what undistortion could not fill must not count
    found = fit_gains(radiance, Photo(values.astype(np.float32), valid, False), response)
    assert np.allclose(found, gains, rtol=0.02)


def test_a_black_photo_has_gains_too():
    photo = Photo(np.zeros((20, 20, 3), np.float32), np.ones((20, 20), bool), False)
    gains = fit_gains(np.ones((20, 20, 3)), photo, gamma())
    assert np.isfinite(gains).all() and metrics.to_ldr(np.ones((1, 1, 3)), gamma(), gains).max() < 0.01


# ---- maps ----------------------------------------------------------------------------------------------------------


def test_bilinear_hits_texel_centres_with_row_zero_on_top():
    texture = np.arange(12.0).reshape(3, 4, 1)
    u, v = (np.arange(4) + 0.5) / 4, 1 - (np.arange(3) + 0.5) / 3
    for row in range(3):
        uv = np.stack([u, np.full(4, v[row])], -1)
        assert np.allclose(bilinear(texture, uv)[:, 0], texture[row, :, 0])
    halfway = bilinear(texture, np.array([[0.25, v[0]], [u[0], (v[0] + v[1]) / 2]]))
    assert np.allclose(halfway[:, 0], [0.5, 2.0])


def test_degenerate_faces_do_not_disturb_the_maps(tmp_path):
    result = true_result()
    mesh = result.mesh
    broken = replace(
        result,
        mesh=replace(mesh, faces=np.r_[mesh.faces, [[0, 0, 1]]], uv=np.r_[mesh.uv, mesh.uv[:1]]),
        regions=np.r_[result.regions, 0].astype(np.int32),
    )
    from iris_addon.capture.reader import read_views

    camera = read_views(write_truth_room(tmp_path / "room") / "train" / "transforms.json")[0].camera
    assert np.array_equal(MapRenderer(broken).maps(camera).kd, MapRenderer(result).maps(camera).kd)


@pytest.mark.parametrize("albedo", [None, 0.0, 0.4])
def test_maps_show_the_surfaces_of_the_backdrop_through_holes(tmp_path, albedo):
    """The room without a quarter of its faces, before a shell that is a surface, an opening, or lights nothing."""
    from iris_addon.capture.reader import read_views

    result = true_result()
    mesh, holed = result.mesh, np.arange(len(result.mesh.faces)) % 4 != 0
    shell = trimesh.creation.box(extents=3 * np.ptp(mesh.vertices, axis=0))
    shell.apply_translation(mesh.vertices.mean(0))
    picture = np.full((16, 32, 3), 0.5, np.float32)
    backdrop = Backdrop(
        np.array(shell.vertices),
        np.array(shell.faces)[:, ::-1].astype(np.int64),
        picture,
        None if albedo is None else np.full_like(picture, albedo),
    )
    with_holes = replace(
        result,
        mesh=replace(mesh, faces=mesh.faces[holed], uv=mesh.uv[holed]),
        regions=result.regions[holed],
        emitters=(),
        backdrop=backdrop,
    )
    camera = read_views(write_truth_room(tmp_path / "room") / "train" / "transforms.json")[0].camera
    maps = MapRenderer(with_holes).maps(camera)
    through = ~maps.hit
    assert 0.02 < through.mean() < 0.9
    assert maps.kd[through] == pytest.approx(albedo or 0.0)
    assert maps.roughness[through] == pytest.approx(1.0 if albedo else 0.0)
    assert not maps.emission[through].any() and not maps.confidence[through].any()


@pytest.mark.slow
def test_the_truth_of_a_public_capture_scores_near_perfectly(shared):
    """Constant materials exactly, textured ones are left out: their images are not part of the capture."""
    import json

    from iris_addon.capture.reader import read_capture
    from iris_addon.model.recovered import Emitter
    from iris_addon.results.result import Result

    root = shared / "captures" / "staircase2"
    capture = read_capture(root)
    with np.load(root / "gt" / "faces.npz") as faces:
        material, emitter = faces["material"].astype(int), faces["emitter"]
    side = 32
    base, rough, metal = (
        np.full((side, side, 3), 0.5, np.float32),
        np.ones((side, side), np.float32),
        np.zeros((side, side), np.float32),
    )
    for entry in json.loads((root / "gt" / "materials.json").read_text()):
        row, column = divmod(entry["index"], side)
        base[row, column] = entry["base_color"] or 0.5
        rough[row, column], metal[row, column] = entry["roughness"], entry["metallic"]
    row, column = np.divmod(material, side)
    uv = np.repeat(np.stack([(column + 0.5) / side, 1 - (row + 0.5) / side], -1)[:, None], 3, 1).astype(np.float32)
    lamps = tuple(
        Emitter(
            id=k,
            faces=np.flatnonzero(emitter == lamp["emitter"]),
            radiance=np.array(lamp["radiance"]),
            area=lamp["area"],
            confidence=1.0,
        )
        for k, lamp in enumerate(json.loads((root / "gt" / "emitters.json").read_text()))
    )
    response = Response(np.load(root / "gt" / "cam" / "crf_gt.npy"), "file")
    exposures = {view.name: np.full(3, view.exposure) for view in capture.views}
    truth = Result(
        mesh=replace(capture.mesh, uv=uv),
        regions=material.astype(np.int32),
        textures=Textures(base, rough, metal, rough),
        emitters=lamps,
        outside=None,
        response=response,
        exposures=exposures,
    )
    scores = evaluate(truth, root)
    assert scores["kd_psnr"] > 40 and scores["roughness_psnr"] > 60 and scores["metallic_l2"] < 1e-6
    assert scores["emission_iou"] > 0.999 and scores["emission_log_l2"] < 1e-6
    assert scores["crf_l2"] == 0 and scores["exposure_log2_rmse"] < 1e-9


def test_held_out_photos_pass_through_the_curve_of_their_camera(tmp_path):
    """A photo of the second camera, made of the rendering itself, is met exactly by its curve and by no other."""
    rng = np.random.default_rng(0)
    image, camera = (
        rng.lognormal(-1, 0.5, (30, 40, 3)),
        Camera(width=40, height=30, fx=40.0, fy=40.0, cx=20.0, cy=15.0, c2w=np.eye(4)),
    )
    second = Device("Acme Two", gamma(0.8))
    path = tmp_path / "photo.png"
    write_png(path, np.floor(255 * second.response.apply(image * 0.4)).astype(np.uint8))
    result = replace(true_result(), devices=(second,))
    psnr = {
        device: score_held_out(result, [View("photo", camera, path, split="val", device=device)], [image])["nvs_psnr"]
        for device in ("Acme Two", "")
    }
    assert psnr["Acme Two"]["photo"] > 50 > 35 > psnr[""]["photo"]
