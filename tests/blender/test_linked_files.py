"""A scene copied for other machines finds what it links to beside it, wherever both are moved."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.base.images import write_png
from iris_addon.blender.images import read_image
from iris_addon.blender.insert.linked_files import PortableCopy, write_portable
from iris_addon.blender.insert.plate import plate_picture

pytestmark = pytest.mark.bpy

WOOD, CLOTH, FRAME = (200, 120, 40), (30, 60, 200), (90, 91, 92)


def picture(path: Path, color: tuple[int, int, int]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.full((6, 8, 3), color, np.uint8))
    return path


def textured(name: str, image: bpy.types.Image) -> bpy.types.Object:
    thing = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.new("ShaderNodeTexImage").image = image
    thing.data.materials.append(material)
    return thing


@pytest.fixture
def studio(tmp_path: Path) -> Path:
    """The open scene shows a plate, has a wooden thing and, linked from a library, a cloth whose picture that library
    finds by a relative path; another scene has a picture of its own."""
    root = tmp_path / "studio"
    picture(root / "textures" / "cloth.png", CLOTH)
    (root / "assets").mkdir()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cloth = textured("cloth", bpy.data.images.load(str(root / "textures" / "cloth.png")))
    bpy.context.scene.collection.objects.link(cloth)
    bpy.ops.wm.save_as_mainfile(filepath=str(root / "assets" / "cloth.blend"), relative_remap=False)
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    with bpy.data.libraries.load(str(root / "assets" / "cloth.blend"), link=True) as (_, wanted):
        wanted.objects = ["cloth"]
    scene.collection.objects.link(wanted.objects[0])
    wood = bpy.data.images.load(str(picture(root / "wood.png", WOOD)))
    scene.collection.objects.link(textured("wood", wood))
    packed = bpy.data.images.load(str(picture(root / "packed.png", WOOD)))
    packed.pack()
    scene.collection.objects.link(textured("packed", packed))
    for k in range(3):
        picture(root / "plate" / f"sh.{1001 + k}.png", FRAME)
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    clip = bpy.data.movieclips.load(str(root / "plate" / "sh.1001.png"))
    behind = camera.data.background_images.new()
    behind.source, behind.clip = "MOVIE_CLIP", clip
    elsewhere = bpy.data.scenes.new("elsewhere")
    elsewhere.collection.objects.link(textured("other", bpy.data.images.load(str(picture(root / "other.png", WOOD)))))
    return root


def written(studio: Path) -> PortableCopy:
    return write_portable(bpy.context.scene, studio.parent / "bundle" / "shot.blend")


def test_a_copy_that_is_moved_has_its_pictures_its_library_and_its_plate(studio: Path) -> None:
    before = sorted(bpy.utils.blend_paths(absolute=True))
    copy = written(studio)
    assert sorted(bpy.utils.blend_paths(absolute=True)) == before  # those of the open file
    assert copy.warnings == ()
    host = studio.parent / "host"
    shutil.move(studio.parent / "bundle", host)
    shutil.rmtree(studio)
    bpy.ops.wm.open_mainfile(filepath=str(host / "shot.blend"))
    paths = {Path(path) for path in bpy.utils.blend_paths(absolute=True, packed=False)}
    assert paths and all(path.is_relative_to(host) and path.is_file() for path in paths)
    assert not any(path.name in ("other.png", "packed.png") for path in paths)
    for name, color in (("wood.png", WOOD), ("cloth.png", CLOTH)):
        image = bpy.data.images[name]
        values = read_image(Path(bpy.path.abspath(image.filepath, library=image.library)))
        np.testing.assert_allclose(values[0, 0], np.array(color) / 255, atol=1e-6)
        assert tuple(image.size) == (8, 6)
    assert bpy.data.objects["cloth"].library is not None and len(bpy.data.objects["cloth"].data.materials) == 1
    scene = bpy.context.scene
    scene.frame_set(3)
    assert plate_picture(scene, 3) == host / "shot.files" / "plate" / "sh.1003.png"


def test_what_is_missing_or_stays_is_named_and_an_export_again_copies_only_what_changed(studio: Path) -> None:
    first = {path: path.stat().st_ino for path in written(studio).files}
    picture(studio / "wood.png", CLOTH)
    (studio / "plate" / "sh.1001.png").unlink()
    bpy.data.images.load(str(picture(studio / "gone.png", WOOD)))
    bpy.context.scene.collection.objects.link(textured("gone", bpy.data.images["gone.png"]))
    (studio / "gone.png").unlink()
    cache = bpy.context.scene.objects["wood"].modifiers.new("cache", "MESH_CACHE")
    cache.filepath = str(studio / "wind.mdd")
    copy = written(studio)
    assert [str(studio / "gone.png") in copy.warnings[0], str(studio / "wind.mdd") in copy.warnings[1]] == [True, True]
    assert "missing" in copy.warnings[0] and "under the same path" in copy.warnings[1]
    again = {path: path.stat().st_ino for path in copy.files}
    changed = {path.name for path, inode in again.items() if first[path] != inode}
    assert changed == {"wood.png"} and {path.name for path in first} - {path.name for path in again} == {"sh.1001.png"}


def test_what_stays_where_it_lies_is_named_by_its_whole_path_in_the_copy(studio: Path) -> None:
    """A path beside the scene would be one beside the copy, which is elsewhere."""
    bpy.ops.wm.save_as_mainfile(filepath=str(studio / "room.blend"), relative_remap=False)
    cache = bpy.context.scene.objects["wood"].modifiers.new("cache", "MESH_CACHE")
    cache.filepath = "//wind.mdd"
    copy = written(studio)
    assert cache.filepath == "//wind.mdd", "the scene itself has another path now"
    bpy.ops.wm.open_mainfile(filepath=str(copy.blend))
    (kept,) = (thing for thing in bpy.data.objects if "cache" in thing.modifiers)
    assert bpy.path.abspath(kept.modifiers["cache"].filepath) == str(studio / "wind.mdd")


def test_nothing_is_written_through_a_link_in_the_bundle(studio: Path) -> None:
    """A bundle that came from elsewhere may hold links to folders and files of whoever exports into it."""
    own = studio.parent / "own"
    own.mkdir()
    inside = studio.parent / "bundle" / "shot.files"
    inside.mkdir(parents=True)
    (inside / "plate").symlink_to(own, target_is_directory=True)
    with pytest.raises(BadInput, match="is a link") as caught:
        written(studio)
    assert str(inside / "plate") in str(caught.value) and not list(own.iterdir())
    (inside / "plate").unlink()
    (inside / "wood.png").symlink_to(studio / "wood.png")
    written(studio)
    assert not (inside / "wood.png").is_symlink(), "the bundle has a link where a file belongs"
