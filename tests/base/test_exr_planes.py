"""Channels of uncompressed EXR files, against what OpenEXR reads of them."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from iris_addon.base.color_spaces import ACESCG
from iris_addon.base.errors import BadInput
from iris_addon.base.exr_planes import read_exr_planes, write_exr_planes

RNG = np.random.default_rng(3)
RED, BLUE, DEPTH = RNG.random((3, 5, 7)).astype(np.float32)


def write(path: Path, *parts: dict, compression=OpenEXR.NO_COMPRESSION) -> Path:
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File([OpenEXR.Part(dict(header), part, f"part {k}") for k, part in enumerate(parts)]).write(str(path))
    return path


@pytest.mark.parametrize("parts", [[{"a.R": RED, "a.B": BLUE, "Z": DEPTH}], [{"a.R": RED, "a.B": BLUE}, {"Z": DEPTH}]])
def test_every_channel_is_read_as_it_was_written(parts, tmp_path):
    planes = read_exr_planes(write(tmp_path / "a.exr", *parts))
    assert planes.keys() == {"a.R", "a.B", "Z"}
    for name, values in (("a.R", RED), ("a.B", BLUE), ("Z", DEPTH)):
        np.testing.assert_array_equal(planes[name], values)


def test_what_is_compressed_cut_off_or_of_half_floats_is_refused(tmp_path):
    whole = write(tmp_path / "a.exr", {"R": RED})
    (tmp_path / "cut.exr").write_bytes(whole.read_bytes()[:-20])
    write(tmp_path / "zip.exr", {"R": RED}, compression=OpenEXR.ZIP_COMPRESSION)
    write(tmp_path / "half.exr", {"R": RED.astype(np.float16)})
    for name in ("cut", "zip", "half", "missing"):
        with pytest.raises(BadInput):
            read_exr_planes(tmp_path / f"{name}.exr")


@pytest.mark.parametrize("shape", [(5, 7), (16, 3), (37, 64), (1, 1)])
def test_openexr_reads_what_is_written(shape, tmp_path):
    """Noise that does not compress, an even picture that does, numbers below zero, and a long name."""
    noise, ramp = RNG.normal(size=shape).astype(np.float32), np.indices(shape).sum(0).astype(np.float32)
    long = "the lamp over the table in the kitchen.R"
    planes = {"object.R": noise, "A": ramp, "Z": ramp - 3, long: 0 * ramp}
    write_exr_planes(tmp_path / "a.exr", planes, ACESCG)
    (part,) = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).parts
    assert part.channels.keys() == planes.keys()
    for name, values in planes.items():
        np.testing.assert_array_equal(part.channels[name].pixels, values)
    assert part.header["chromaticities"] == pytest.approx(ACESCG.chromaticities, abs=1e-6)
