"""Relighting and insertion jobs in JSON: what they change and what they refuse."""

import json
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.edits.jobs import insertion_edits, new_lights_edit, one_emitter_edit, relight_edit
from tests.blender_room import room

CAPTURE = Path(__file__).parents[3] / "shared/captures/staircase2"
QUAD = {"corners": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "normal": [0, 0, -2], "radiance": [1, 2, 3]}


@pytest.fixture
def lit():
    return room(emission={4: (9, 9, 9), 3: (2, 1, 0)})


def test_new_lights_replace_every_lamp_by_the_quads(lit):
    edit = new_lights_edit(lit, {"new_lights": {"lights": [QUAD]}})
    assert not edit.face_emission.any()
    assert np.flatnonzero(edit.black_faces).tolist() == [6, 7, 8, 9]
    assert edit.outside_scale == 0
    np.testing.assert_allclose(edit.lights[0].normal, [0, 0, -1])


def test_one_emitter_keeps_the_listed_faces_only(lit):
    edit = one_emitter_edit(lit, {"one_emitter": {"kept_faces_of_scene_ply": [6, 8, 0]}})
    np.testing.assert_allclose(edit.face_emission[[0, 6, 7, 8, 9]], [[0] * 3, [2, 1, 0], [0] * 3, [9] * 3, [0] * 3])
    assert np.flatnonzero(edit.black_faces).tolist() == [7, 9]
    assert edit.outside_scale == 0


def test_a_relighting_job_changes_lamps_by_id_after_all(lit):
    edit = relight_edit(lit, {"recovered": {"all": {"off": True}}, "lights": [QUAD], "outside": 0.25})
    assert not edit.face_emission.any()
    assert edit.outside_scale == 0.25
    edit = relight_edit(lit, {"recovered": {"all": {"scale": 2}, "1": {"color": [0, 0, 1], "scale": 0.5}}})
    np.testing.assert_allclose(edit.face_emission[8], [18, 18, 18])
    luminance = 0.2126 * 2 + 0.7152
    np.testing.assert_allclose(edit.face_emission[6], [0, 0, 0.5 * luminance / 0.0722])
    assert not edit.black_faces.any()
    assert relight_edit(lit, {}).face_emission is None


def test_the_most_specific_entry_of_a_lamp_wins(lit):
    for own in ({}, {"scale": 1}, {"off": False}):
        edit = relight_edit(lit, {"recovered": {"0": own, "all": {"off": True}}})  # the order does not matter
        np.testing.assert_allclose(edit.face_emission[8], [9, 9, 9])
        assert not edit.face_emission[6].any()
        assert np.flatnonzero(edit.black_faces).tolist() == [6, 7]
    edit = relight_edit(lit, {"recovered": {"all": {"scale": 3, "color": [1, 0, 0]}, "0": {"color": [1, 1, 1]}}})
    np.testing.assert_allclose(edit.face_emission[8], [27, 27, 27])
    edit = relight_edit(lit, {"recovered": {"all": {"scale": 3}, "0": {"off": True}}})
    assert not edit.face_emission[8].any()


def test_parts_of_the_reference_files_are_jobs(lit):
    part = {"poses": "val/transforms.json", "original_emitters": "off", "lights": [QUAD]}
    assert not relight_edit(lit, part).face_emission.any()
    assert relight_edit(lit, {"kept_faces_of_scene_ply": [6]}).face_emission.any(axis=1).sum() == 1


def test_insertion_jobs_name_their_view(lit, tmp_path):
    ball = {"shape": "sphere", "center": [0, 1, 2], "radius": 0.1, "roughness": 0.3}
    job = {"views": [{"view": 3, "objects": [ball, {"file": "chair.glb", "location": [1, 2, 3], "scale": 2}]}]}
    ((view, edit),) = insertion_edits(lit, job, tmp_path)
    assert view == 3
    assert edit.spheres[0].roughness == 0.3
    assert edit.objects[0].file == tmp_path / "chair.glb"
    assert edit.objects[0].placement.scale == (2.0, 2.0, 2.0)


@pytest.mark.parametrize(
    ("spec", "names"),
    [
        ({"recovered": {"7": {"off": True}}}, "'7'"),
        ({"recovered": {"0": {"on": True}}}, "'on'"),
        ({"recovered": {"0": {"scale": -1}}}, "recovered.0.scale"),
        ({"recovered": {"0": {"color": [0, 0]}}}, "recovered.0.color"),
        ({"lights": [{**QUAD, "corners": [[0, 0, 0]]}]}, "corners"),
        ({"lights": [{**QUAD, "radiance": [1, 2, float("nan")]}]}, "radiance"),
        ({"lights": {}}, "lights"),
        ({"lights": [{"type": "laser"}]}, "lights.0..type"),
        ({"lights": [{"type": "spot", "position": [0, 0, 0], "intensity": 1}]}, "'direction' or 'target'"),
        ({"lights": [{"type": "sun", "direction": [0, 0, 0], "irradiance": 1}]}, "direction"),
        ({"lights": [{"type": "point", "position": [0, 0, 0], "intensity": -1}]}, "intensity"),
        ({"lights": [{"type": "mesh", "shape": "sphere", "radius": 1, "location": [0, 0, 0]}]}, "radiance"),
        ({"light": []}, "'light'"),
        ({"kept_faces_of_scene_ply": [99]}, "kept_faces"),
        ([], "relighting job"),
    ],
)
def test_a_wrong_job_is_refused_by_the_key_that_is_wrong(lit, spec, names):
    with pytest.raises(BadInput, match=names) as error:
        relight_edit(lit, spec)
    assert error.value.fix


def test_wrong_objects_are_refused(lit):
    placed = {"location": [0, 0, 0]}
    for thing in (
        {"center": [0, 0, 0], "radius": 0},
        {"shape": "cube"},
        {"file": 3},
        7,
        {"shape": "box", "size": 0, **placed},
        {"shape": "box", "size": 1},
        {"shape": "box", "size": 1, "pixel": [0, 0]},
        {"shape": "box", "size": 1, "snap": "up", **placed},
        {"shape": "box", "size": 1, "roughness": 2, **placed},
        {"shape": "box", "size": 1, "colour": 2, **placed},
    ):
        with pytest.raises(BadInput, match="objects"):
            insertion_edits(lit, {"objects": [thing]})
    for job in ({"object": []}, {"recovered": {}, "objects": []}, {"views": [{"view": 0, "things": []}]}):
        with pytest.raises(BadInput, match="unknown key"):
            insertion_edits(lit, job)


def test_the_reference_files_of_a_capture_are_read():
    if not CAPTURE.is_dir():
        pytest.skip("shared capture staircase2 is not here")
    result = room(emission={4: (9, 9, 9)})
    lights = json.loads((CAPTURE / "relight/lights.json").read_text())
    assert len(new_lights_edit(result, lights).lights) == 2
    with pytest.raises(BadInput, match="beyond the 12"):
        one_emitter_edit(result, lights)
    views = insertion_edits(result, json.loads((CAPTURE / "insert/objects.json").read_text()))
    assert [view for view, _ in views] == [0, 1, 2, 3]
    assert all(len(edit.spheres) == 2 for _, edit in views)
