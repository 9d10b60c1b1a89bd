from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from iris_addon.base import images as imaging
from iris_addon.base.errors import BadInput, IrisError
from iris_addon.base.files import from_ranges, plain, to_ranges
from iris_addon.model.capture import Camera, View
from iris_addon.model.device import Device
from iris_addon.model.local_exposure import LocalSettings
from iris_addon.model.recovered import Backdrop, LightState, Sunlight
from iris_addon.model.response import Response, gamma
from iris_addon.results.files import WHOLE, complete_save
from iris_addon.results.folder import load_result, read_coverage, save_result
from iris_addon.results.records import read_response
from iris_addon.results.result import Result
from iris_addon.results.saving import emission_texture
from tests.result_room import room

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def saved(tmp_path):
    save_result(room(), tmp_path / "r")
    return tmp_path / "r"


def test_round_trip_reproduces_the_result(tmp_path):
    result = room()
    save_result(result, tmp_path)
    loaded = load_result(tmp_path)

    assert np.array_equal(loaded.mesh.vertices, result.mesh.vertices)
    assert np.array_equal(loaded.mesh.faces, result.mesh.faces)
    assert np.allclose(loaded.mesh.uv, result.mesh.uv, atol=1e-7, rtol=0) and loaded.mesh.uv.dtype == np.float32
    assert loaded.mesh.regions is None
    assert np.array_equal(loaded.regions, result.regions)
    for mine, yours in zip(result.emitters, loaded.emitters, strict=True):
        assert (mine.id, mine.area, mine.confidence) == (yours.id, yours.area, yours.confidence)
        assert np.array_equal(mine.faces, yours.faces) and np.array_equal(mine.radiance, yours.radiance)
    assert np.array_equal(loaded.outside.sh, result.outside.sh)
    assert np.array_equal(loaded.response.samples, result.response.samples)
    assert loaded.response.family == "gamma" and loaded.response.coefficients == result.response.coefficients
    assert loaded.exposures.keys() == result.exposures.keys()
    assert all(np.array_equal(loaded.exposures[k], result.exposures[k]) for k in result.exposures)
    assert loaded.report == result.report and loaded.up == result.up
    assert np.abs(loaded.textures.base_color - result.textures.base_color).max() <= 2**-11  # half precision in [0, 1]
    for name in ("roughness", "metallic", "confidence"):
        assert np.abs(getattr(loaded.textures, name) - getattr(result.textures, name)).max() <= 0.51 / 65535


def test_the_coverage_survives_and_goes_with_its_result(tmp_path):
    plain = room()
    coverage = np.random.default_rng(3).random(plain.textures.confidence.shape).astype(np.float32)
    save_result(replace(plain, textures=replace(plain.textures, coverage=coverage)), tmp_path)
    assert np.abs(load_result(tmp_path).textures.coverage - coverage).max() <= 0.51 / 255
    save_result(plain, tmp_path)
    assert load_result(tmp_path).textures.coverage is None, "an older result does not show that of a newer one"


def with_backdrop() -> Result:
    """A room before a tetrahedron that reflects."""
    corners = np.array([[-3.0, -3, -3], [5, 0, 0], [0, 5, 0], [0, 0, 5 + 1 / 3]])
    picture, albedo = np.random.default_rng(5).random((2, 8, 16, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    return replace(room(), backdrop=Backdrop(corners, faces, picture, albedo))


def patterned() -> Result:
    """The room, whose second lamp is bright in the left part of the atlas."""
    result = room()
    pattern = np.ones((*result.textures.base_color.shape[:2], 3), np.float32)
    pattern[:, :10], pattern[:, 10:] = 1.75, 0.25
    first, second = result.emitters
    lamps = first, replace(second, patterned=True)
    return replace(result, emitters=lamps, textures=replace(result.textures, lamp_pattern=pattern))


def test_the_pattern_of_a_lamp_survives_is_seen_and_goes_with_its_result(tmp_path):
    result = patterned()
    save_result(result, tmp_path)
    loaded = load_result(tmp_path)
    assert [emitter.patterned for emitter in loaded.emitters] == [False, True]
    np.testing.assert_array_equal(loaded.textures.lamp_pattern, result.textures.lamp_pattern)
    eye = np.array([[0, 0, 1, 2.0], [0, 1, 0, 0.5], [-1, 0, 0, 0.5], [0, 0, 0, 1]])  # looks along -x
    camera = Camera(width=40, height=40, fx=40, fy=40, cx=20, cy=20, c2w=eye)
    seen, plain = (r.render_maps(camera).emission for r in (loaded, replace(result, emitters=room().emitters)))
    lit = plain.max(-1) > 0
    factor = (seen[lit] / plain[lit]).ravel()
    assert lit.any() and factor.min() >= 0.249 and factor.max() <= 1.751 and np.ptp(factor) > 0.5
    shown = imaging.read_exr(tmp_path / "materials" / "emission.exr")
    assert {round(float(v), 2) for v in np.unique(shown[..., 0])} >= {0.0, 1.0, 7.0}

    save_result(room(), tmp_path)
    assert load_result(tmp_path).textures.lamp_pattern is None
    assert not (tmp_path / "materials" / "lamp_pattern.exr").exists()


@pytest.mark.parametrize("side", [48, 1024, 1280, 1536, 2048])
def test_the_emission_picture_has_the_pattern_at_any_size_of_the_atlas(side):
    """The left half of the atlas is bright, of which the second lamp has some."""
    result = patterned()
    pattern = np.full((side, side, 3), 0.25, np.float32)
    pattern[:, : side // 2] = 1.75
    small = np.zeros((side, side, 3), np.float32)
    result = replace(result, textures=replace(result.textures, base_color=small, lamp_pattern=pattern))
    shown = emission_texture(result)[..., 0]
    left, right = np.array_split(shown, 2, axis=1)
    assert {0.0, 7.0} <= set(np.unique(left)) and {0.0, 1.0} <= set(np.unique(right)) and not (right == 7).any()


def in_two_states() -> Result:
    """The room, solved with both lamps on, and with the second alone beside more light from outside."""
    plain = room()
    assert plain.outside is not None
    both = LightState("both", ("000_0001",), np.array([emitter.radiance for emitter in plain.emitters]), plain.outside)
    second = np.array([np.zeros(3), [3.0, 2.0, 1.0]])
    sun = Sunlight(np.array([0.0, 0.6, 0.8]), np.array([9.0, 8.0, 7.0]))
    return replace(plain, light_states=(both, LightState("second", ("001_0001",), second, sun=sun)))


def test_light_states_survive_and_scale_with_exposures(tmp_path):
    result = in_two_states()
    save_result(result, tmp_path)
    for loaded, expected in ((load_result(tmp_path), result), (result.with_exposures_times(4.0), None)):
        for k, (mine, yours) in enumerate(zip(result.light_states, loaded.light_states, strict=True)):
            factor = 1.0 if expected is not None else 4.0
            assert (mine.name, mine.photos) == (yours.name, yours.photos)
            np.testing.assert_array_equal(yours.radiance, mine.radiance / factor)
            assert (yours.outside is None, yours.sun is None) == (k == 1, k == 0)
    assert loaded.light_states[1].sun.irradiance == pytest.approx([9 / 4, 2, 7 / 4])
    save_result(room(), tmp_path)
    assert not load_result(tmp_path).light_states


def test_a_room_in_a_light_state_has_its_light():
    result = in_two_states()
    lit = result.in_state("second")
    assert [emitter.id for emitter in lit.emitters] == [3, 5]
    assert not lit.emitters[0].radiance.any() and lit.emitters[1].radiance == pytest.approx([3, 2, 1])
    assert not lit.light_states
    assert lit.outside is None and lit.sun is result.light_states[1].sun
    assert np.array_equal(result.in_state("both").face_emission(), result.face_emission())
    assert np.array_equal(result.in_state(None).face_emission(), result.face_emission())
    assert room().in_state(None).emitters
    assert not result.switched_faces.any()
    reversed_ = replace(result, emitters=lit.emitters)
    assert np.flatnonzero(reversed_.switched_faces).tolist() == [10, 11]
    with pytest.raises(BadInput, match="no light state 'third'"):
        result.in_state("third")
    with pytest.raises(BadInput, match="no light state 'both'"):
        room().in_state("both")


def test_a_lamp_that_is_changed_is_changed_in_what_is_saved(tmp_path):
    in_two_states().with_emitter(3, 7.0).save(tmp_path)
    loaded = load_result(tmp_path)
    assert not loaded.light_states and loaded.in_state(None).emitters[0].radiance == pytest.approx(7.0)


def test_a_view_is_seen_in_its_light_state():
    camera = Camera(width=4, height=3, fx=4, fy=4, cx=2, cy=1.5, c2w=np.eye(4))
    result = in_two_states()
    seen = result.in_state_of(View("v", camera, None, light_state="second"))
    assert seen is not None and not seen.emitters[0].radiance.any()
    assert result.in_state_of(View("v", camera, None, light_state="other")) is None
    plain = room()
    assert plain.in_state_of(View("v", camera, None, light_state="second")) is plain


@pytest.mark.parametrize(
    "change",
    [
        {"name": ""},
        {"name": "both"},
        {"photos": "001_0001"},
        {"radiance": [[1, 2, 3]]},
        {"radiance": [[1, 2, 3], [1, -2, 3]]},
        {"radiance": [[1, 2, 3], [1, "x", 3]]},
        {"sun": {"direction": [0, 0, 9], "irradiance": [1, 1, 1]}},
        {"outside": {"sh": [[1, 2, 3]] * 2}},
    ],
)
def test_damaged_light_states_are_bad_input_that_names_the_file(tmp_path, change):
    save_result(in_two_states(), tmp_path)
    path = tmp_path / "emitters.json"
    content = json.loads(path.read_text())
    content["light_states"][1].update(change)
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput) as refused:
        load_result(tmp_path)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize("damage", ["missing", "size", "negative", "grey"])
def test_a_damaged_pattern_is_bad_input_that_names_the_file(tmp_path, damage):
    save_result(patterned(), tmp_path)
    path = tmp_path / "materials" / "lamp_pattern.exr"
    shape = (8, 8, 3) if damage == "size" else (16, 16) if damage == "grey" else (16, 16, 3)
    path.unlink()
    if damage != "missing":
        imaging.write_exr(path, np.full(shape, -1.0 if damage == "negative" else 1.0, np.float32))
    with pytest.raises(BadInput, match=r"lamp_pattern\.exr"):
        load_result(tmp_path)


def test_a_backdrop_survives_and_goes_with_its_result(tmp_path):
    result = with_backdrop()
    save_result(result, tmp_path)
    loaded = load_result(tmp_path).backdrop
    assert np.array_equal(loaded.vertices, result.backdrop.vertices)
    assert np.array_equal(loaded.faces, result.backdrop.faces)
    assert np.abs(loaded.picture - result.backdrop.picture).max() <= 2**-11
    assert np.abs(loaded.albedo - result.backdrop.albedo).max() <= 2**-11
    save_result(replace(result, backdrop=replace(result.backdrop, albedo=None)), tmp_path)
    assert load_result(tmp_path).backdrop.albedo is None and not (tmp_path / "backdrop_albedo.exr").exists()
    save_result(room(), tmp_path)
    assert load_result(tmp_path).backdrop is None and not (tmp_path / "backdrop.exr").exists()


BACKDROP_DAMAGE = [
    ("emitters.json", lambda p: _edit(p, lambda c: c["backdrop"]["faces"][0].__setitem__(0, 4))),
    ("emitters.json", lambda p: _edit(p, lambda c: c["backdrop"]["faces"][0].__setitem__(0, 0.5))),
    ("emitters.json", lambda p: _edit(p, lambda c: c["backdrop"].update(vertices=[[0, 0, 0]]))),
    ("backdrop.exr", lambda p: p.unlink()),
    ("backdrop.exr", lambda p: imaging.write_exr(p, np.zeros((8, 8, 3)))),
    ("backdrop.exr", lambda p: imaging.write_exr(p, np.full((8, 16, 3), -1.0))),
    ("backdrop_albedo.exr", lambda p: p.unlink()),
    ("backdrop_albedo.exr", lambda p: imaging.write_exr(p, np.zeros((4, 8, 3)))),
    ("backdrop_albedo.exr", lambda p: imaging.write_exr(p, np.full((8, 16, 3), 1.5))),
]


@pytest.mark.parametrize(("name", "damage"), BACKDROP_DAMAGE)
def test_a_damaged_backdrop_is_bad_input_that_names_the_file(tmp_path, name, damage):
    save_result(with_backdrop(), tmp_path)
    damage(tmp_path / name)
    with pytest.raises(BadInput) as caught:
        load_result(tmp_path)
    assert str(tmp_path / name) in str(caught.value)


def test_panes_survive_and_cameras_see_through_them(tmp_path):
    """Of results of earlier versions, which do not name panes, there are none."""
    pose = np.eye(4)
    pose[:3, 3] = 0.5, 0.5, 3.0
    camera = Camera(width=5, height=5, fx=20.0, fy=20.0, cx=2.5, cy=2.5, c2w=pose)
    whole = room()
    front = np.flatnonzero((whole.mesh.vertices[whole.mesh.faces][..., 2] == 1).all(1))
    glazed = replace(whole, panes=front)
    save_result(glazed, tmp_path)
    loaded = load_result(tmp_path)
    assert np.array_equal(loaded.panes, front)
    far, near = loaded.render_maps(camera), whole.render_maps(camera)
    assert far.hit.all() and near.hit.all()
    assert not np.allclose(far.base_color, near.base_color, atol=0.01)
    without = replace(whole, mesh=whole.mesh.without(front), emitters=())
    assert np.allclose(far.base_color, without.render_maps(camera).base_color, atol=0.01)
    shown = read_coverage(tmp_path, lambda path: imaging.read_map(path) / 65535)[0]
    assert len(shown.faces) == len(whole.mesh.faces) - len(front)
    _edit(tmp_path / "emitters.json", lambda c: c.pop("panes"))
    assert not len(load_result(tmp_path).panes)


def test_channels_of_the_response_and_regions_of_the_file_survive(tmp_path):
    curve = np.stack([gamma(g).samples[0] for g in (0.4, 0.5, 0.6)])
    result = room(outside=False, response=Response(curve, "power-spline", (0.1, 0.2)))
    result = replace(result, mesh=replace(result.mesh, regions=np.arange(12, dtype=np.int32)))
    result = replace(result, local=LocalSettings(strength=0.3, scale=0.05, headroom=2.0, falloff=0.1))
    save_result(result, tmp_path)
    loaded = load_result(tmp_path)
    assert loaded.local == result.local
    assert np.array_equal(loaded.response.samples, curve)
    assert loaded.outside is None
    assert np.array_equal(loaded.mesh.regions, result.mesh.regions)


def test_normals_of_the_surface_behind_a_scan_survive(tmp_path):
    normals = np.random.default_rng(0).normal(size=(12, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    result = room()
    save_result(replace(result, mesh=replace(result.mesh, normals=normals.astype(np.float32))), tmp_path)
    assert np.allclose(load_result(tmp_path).mesh.normals, normals, atol=1e-4)
    save_result(result, tmp_path)
    assert load_result(tmp_path).mesh.normals is None


def test_other_programs_read_the_glb_with_faces_in_order_and_y_up(saved):
    mesh = trimesh.load(saved / "materials" / "mesh.glb", process=False).to_geometry()
    result = room()
    corners = result.mesh.vertices[result.mesh.faces]
    assert np.allclose(mesh.vertices[mesh.faces], corners, atol=1e-6)  # up is +y already, so nothing turns
    assert np.allclose(mesh.visual.uv[mesh.faces], result.mesh.uv, atol=1e-6)

    save_result(replace(result, up=(0.0, 0.0, 1.0)), saved)
    turned = trimesh.load(saved / "materials" / "mesh.glb", process=False).to_geometry()
    assert np.allclose(turned.vertices[turned.faces][..., 1], corners[..., 2], atol=1e-6)


def test_emission_picture_shows_each_lamp_where_its_faces_are(saved):
    emission = imaging.read_exr(saved / "materials" / "emission.exr")
    side = len(emission)
    uv = room().mesh.uv
    for emitter in room().emitters:
        for face in emitter.faces:
            u, v = uv[face].mean(0)
            assert np.allclose(emission[int((1 - v) * side), int(u * side)], emitter.radiance, rtol=1e-3)
    u, v = uv[6].mean(0)
    assert not emission[int((1 - v) * side), int(u * side)].any()


def test_an_injected_reader_is_the_only_one_used(saved, monkeypatch):
    def reader(path: Path) -> np.ndarray:  # three channels for everything, as Blender gives
        return np.full((16, 16, 3), 0.25, np.float32)

    monkeypatch.setattr(imaging, "read_exr", None)
    monkeypatch.setattr(imaging, "read_map", None)
    loaded = load_result(saved, reader)
    assert loaded.textures.base_color.shape == (16, 16, 3)
    assert loaded.textures.roughness.shape == (16, 16) and (loaded.textures.roughness == 0.25).all()


def test_a_full_disk_leaves_the_earlier_result_untouched(saved, monkeypatch):
    before = {p: p.read_bytes() for p in saved.rglob("*") if p.is_file()}

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("iris_addon.results.saving.encode_glb", full)
    with pytest.raises(IrisError, match=r"No space left.*free some space") as caught:
        save_result(room(seed=1), saved)
    assert caught.value.exit_code == 1
    assert {p: p.read_bytes() for p in saved.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("moved", range(9))
def test_a_save_killed_while_it_moves_files_is_read_as_the_new_result_and_completed_by_the_next(
    tmp_path, monkeypatch, moved
):
    save_result(with_backdrop(), tmp_path / "r")
    save_result(room(seed=1), tmp_path / "r" / WHOLE)

    with monkeypatch.context() as patch:
        left = [os.replace] * moved

        def move(source: Path, target: Path) -> None:
            if not left:
                raise KeyboardInterrupt
            left.pop()(source, target)

        patch.setattr("iris_addon.results.files.replace_when_free", move)
        with pytest.raises(KeyboardInterrupt):
            complete_save(tmp_path / "r")
    listed = sorted((tmp_path / "r").rglob("*"))
    loaded = load_result(tmp_path / "r")
    assert np.array_equal(loaded.outside.sh, room(seed=1).outside.sh) and loaded.backdrop is None
    assert np.abs(loaded.textures.roughness - room(seed=1).textures.roughness).max() < 1e-4
    assert sorted((tmp_path / "r").rglob("*")) == listed
    complete_save(tmp_path / "r")
    assert not (tmp_path / "r" / WHOLE).exists() and not (tmp_path / "r" / "backdrop.exr").exists()
    assert np.array_equal(load_result(tmp_path / "r").outside.sh, room(seed=1).outside.sh)


SAVES = """
import sys
from dataclasses import replace
from pathlib import Path
from iris_addon.results.folder import save_result
from tests.result_room import room
print("ready", flush=True)
for number in range(60):
    result = room(seed=number)
    save_result(replace(result, report={**result.report, "seed": number}), Path(sys.argv[1]))
"""


def test_a_result_is_read_whole_while_another_process_replaces_it(saved):
    numbers = {tuple(room(seed=number).outside.sh.ravel()): number for number in range(60)}
    with subprocess.Popen(
        [sys.executable, "-c", SAVES, str(saved)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        seen = set()
        while process.poll() is None:
            loaded = load_result(saved)
            number = numbers[tuple(loaded.outside.sh.ravel())]
            assert loaded.report.get("seed", 0) == number
            assert np.abs(loaded.textures.roughness - room(seed=number).textures.roughness).max() < 1e-4
            seen.add(number)
        _, errors = process.communicate()
    assert process.returncode == 0, errors
    assert len(seen) > 1


def _edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


DAMAGE = {
    "report.json": [
        lambda p: _edit(p, lambda c: c.update(schema_version=99)),
        lambda p: p.write_text("{"),
        lambda p: p.write_text("[1]"),
        lambda p: p.unlink(),
    ],
    "response.json": [
        lambda p: _edit(p, lambda c: c.update(samples=c["samples"][:-1])),
        lambda p: _edit(p, lambda c: c["samples"].__setitem__(5, float("nan"))),
        lambda p: _edit(p, lambda c: c["exposures"]["000_0001"].update(factor=["a", 1, 2])),
        lambda p: _edit(p, lambda c: c.pop("exposures")),
        lambda p: _edit(p, lambda c: c["local_exposure"].update(strength=1.5)),
        lambda p: _edit(p, lambda c: c["local_exposure"].update(scale=float("nan"))),
        lambda p: _edit(p, lambda c: c["local_exposure"].update(falloff="much")),
    ],
    "emitters.json": [
        lambda p: _edit(p, lambda c: c.update(panes=[[0, 13]])),
        lambda p: _edit(p, lambda c: c.update(panes="all")),
        lambda p: _edit(p, lambda c: c["emitters"][0].update(faces=[[10, 13]])),
        lambda p: _edit(p, lambda c: c["emitters"][0].update(faces=[[0, 2], [1, 3]])),
        lambda p: _edit(p, lambda c: c["emitters"][0].update(radiance=[1, -1, 1])),
        lambda p: _edit(p, lambda c: c["emitters"][0].update(radiance=[1, 1])),
        lambda p: _edit(p, lambda c: c["emitters"][0].pop("id")),
        lambda p: _edit(p, lambda c: c["outside"].update(sh=[[1, 2, 3]] * 5)),
    ],
    "materials/mesh.glb": [
        lambda p: p.write_bytes(p.read_bytes()[:-100]),
        lambda p: p.write_bytes(b"glTF"),
        lambda p: p.write_bytes(p.read_bytes().replace(b'"faces":3', b'"faces":9')),
        lambda p: p.write_bytes(p.read_bytes().replace(b'"faces":3', b'"faces":2')),
        lambda p: p.unlink(),
    ],
    "materials/base_color.exr": [
        lambda p: p.write_bytes(p.read_bytes()[:400]),
        lambda p: imaging.write_exr(p, np.full((16, 16, 3), np.nan)),
        lambda p: imaging.write_exr(p, np.zeros((16, 8, 3))),
        lambda p: p.unlink(),
    ],
    "materials/roughness.png": [
        lambda p: p.write_bytes(p.read_bytes()[:60]),
        lambda p: imaging.write_png(p, np.zeros((8, 8), np.uint16)),
        lambda p: p.write_bytes(p.read_bytes()[:16] + b"\x00\x10\x00\x00" * 2 + p.read_bytes()[24:]),
    ],
}


@pytest.mark.parametrize(("name", "number"), [(name, i) for name, all_ in DAMAGE.items() for i in range(len(all_))])
def test_damage_is_bad_input_that_names_the_file(saved, name, number):
    DAMAGE[name][number](saved / name)
    with pytest.raises(BadInput) as caught:
        load_result(saved)
    named = str(saved) if name == "report.json" else str(saved / name)
    assert named in str(caught.value) and " — " in str(caught.value)


def test_ranges_are_compact_and_exact():
    faces = np.array([7, 1, 2, 3, 9, 10])
    assert to_ranges(faces) == [[1, 4], [7, 8], [9, 11]]
    assert np.array_equal(from_ranges(to_ranges(faces), 11, "faces", Path("x")), np.sort(faces))
    assert from_ranges([], 11, "faces", Path("x")).shape == (0,)


def test_plain_gives_json_types_alone():
    value = {1: np.float32(0.5), "a": (np.nan, np.arange(2)), "p": Path("x") / "y", "i": np.int64(3), "b": np.True_}
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == {
        "1": 0.5, "a": [None, [0, 1]], "p": "x/y", "i": 3, "b": True,
    }  # fmt: skip


def test_loading_needs_numpy_alone(saved):
    code = f"""
import sys
for name in ("OpenEXR", "PIL", "torch", "scipy", "trimesh", "embreex", "xatlas"):
    sys.modules[name] = None
import numpy as np
from pathlib import Path
from iris_addon.results.folder import load_result
print(len(load_result(Path({str(saved)!r}), lambda path: np.zeros((16, 16, 3), np.float32)).emitters))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.stdout.strip() == "2", run.stderr


def of_two_cameras():
    curve = np.stack([gamma(g).samples[0] for g in (0.4, 0.5, 0.6)])
    local = LocalSettings(falloff=0.2)
    second = Device(
        name="Acme Two",
        response=Response(curve, "power-spline", (0.1, 0.2)),
        local=local,
        photos=("001_0001",),
        exposure_factor=(1.2, 1.0, 0.9),
    )
    return replace(room(), devices=(second,))


def test_cameras_survive_and_photos_are_theirs(tmp_path):
    result = of_two_cameras()
    save_result(result, tmp_path)
    loaded, (second,) = load_result(tmp_path), result.devices
    (found,) = loaded.devices
    assert np.array_equal(found.response.samples, second.response.samples)
    assert replace(found, response=second.response) == second
    camera = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=2.0, cy=1.5, c2w=np.eye(4))
    for view, name in (
        (View("001_0001", camera, None), "Acme Two"),  # a photo of the solve, whatever became of its EXIF
        (View("000_0001", camera, None), ""),
        (View("001_0001", camera, None, split="val"), ""),  # held-out photos have names of their own
        (View("7", camera, None, split="val", device="Acme Two"), "Acme Two"),
        (View("7", camera, None, split="val", device="Acme Three"), ""),
    ):
        assert loaded.device_of(view).name == name
    assert read_response(tmp_path).device_of("001_0001").local == LocalSettings(falloff=0.2)
    assert read_response(tmp_path).device_of("").response.family == "gamma"


def test_a_result_of_one_camera_is_written_as_ever(tmp_path):
    save_result(room(), tmp_path)
    assert "devices" not in json.loads((tmp_path / "response.json").read_text())
    assert load_result(tmp_path).devices == ()


@pytest.mark.parametrize(
    "damage",
    [
        "photos",
        {"name": 3},
        {"photos": ["of another result"]},
        {"photos": [["000_0001"]]},
        {"photos": "000_0001"},
        {"samples": [0.0, 1.0]},
        {"exposure_factor": [1.0, 0.0, 1.0]},
        {"local_exposure": {"strength": 2}},
    ],
)
def test_damaged_cameras_are_bad_input(tmp_path, damage):
    save_result(of_two_cameras(), tmp_path)
    path = tmp_path / "response.json"
    content = json.loads(path.read_text())
    content["devices"] = damage if isinstance(damage, str) else [{**content["devices"][0], **damage}]
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput, match=r"response\.json"):
        load_result(tmp_path)
