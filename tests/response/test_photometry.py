"""Photometry: what photos cannot tell of it, and responses read from files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.model.local_exposure import COLUMNS, ROWS, LocalExposure, LocalSettings
from iris_addon.model.response import N_SAMPLES, Response
from iris_addon.response import family
from iris_addon.response.photometry import Photometry, read_response

X = np.linspace(0, 1, N_SAMPLES)


@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.7])
def test_photos_are_invariant_to_raising_radiance_exposures_and_response(exponent: float) -> None:
    rng = np.random.default_rng(0)
    radiance, view, pixel = rng.uniform(0.05, 1.2, (200, 3)), rng.integers(0, 4, 200), rng.integers(0, 40 * 30, 200)
    local = LocalExposure(
        LocalSettings(falloff=1.0), rng.normal(0, 0.2, (4, ROWS, COLUMNS)).astype(np.float32), np.tile([30, 40], (4, 1))
    )
    samples = np.stack([np.linspace(0, 1, 1024) ** p for p in (0.4, 0.45, 0.6)])
    found = Photometry(
        response=Response(samples, family.FITTED),
        exposures=rng.uniform(0.5, 1.0, (4, 3)),
        held_out=0.0,
        per_channel=True,
        known_exposures=False,
        local=local,
    )
    raised = found.raised(exponent)
    assert raised.exponent == exponent
    z = found.develop(radiance, view, pixel)
    assert raised.develop(radiance**exponent, view, pixel) == pytest.approx(z, abs=2e-3)
    both = [p.linearise_pixels(z.astype(np.float32), view, pixel) for p in (found, raised)]
    unclipped = both[0].unclipped & (z > 0.2)
    assert both[1].radiance[unclipped] == pytest.approx(both[0].radiance[unclipped] ** exponent, rel=0.02)
    assert both[1].bound == pytest.approx(both[0].bound ** exponent)


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("kind", ["json", "npy", "txt"])
def test_curves_are_read_from_files(tmp_path: Path, kind: str, rows: int) -> None:
    table = np.stack([np.linspace(0, 1, 257) ** (1 / g) for g in (2.2, 1.8, 2.6)])[:rows]
    path = tmp_path / f"response.{kind}"
    if kind == "json":
        path.write_text(json.dumps({"samples": table.tolist() if rows == 3 else table[0].tolist()}))
    elif kind == "npy":
        np.save(path, table)
    else:
        np.savetxt(path, table.T)
    response = read_response(path)
    assert response.samples[-1] == pytest.approx(np.interp(X, np.linspace(0, 1, 257), table[-1]), abs=1e-6)


@pytest.mark.parametrize(
    "content",
    ["", "not numbers", "1 2 3 4\n5 6 7 8", "0.0\nnan\n1.0", "0\n1\n0.5", "1\n1\n1", "0 0 0\n1 0 1"],
    ids=repr,
)
def test_a_bad_curve_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "curve.txt"
    path.write_text(content)
    with pytest.raises(BadInput, match=r"curve\.txt"):
        read_response(path)


@pytest.mark.parametrize("content", ["{}", '{"samples": {"r": 1}}', "[1, 2]", "{"])
def test_a_bad_response_json_is_refused_by_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "response.json"
    path.write_text(content)
    with pytest.raises(BadInput, match=r"response\.json"):
        read_response(path)


def test_an_empty_or_missing_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "curve.npy").write_bytes(b"")
    for name in ("curve.npy", "nothing.npy"):
        with pytest.raises(BadInput, match=name):
            read_response(tmp_path / name)
