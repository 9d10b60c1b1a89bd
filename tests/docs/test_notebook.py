"""The notebook of the documentation runs as it stands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs" / "notebooks" / "room_in_ten_lines.ipynb"
MAX_BYTES = 600_000


def test_the_notebook_is_committed_with_its_outputs_and_small() -> None:
    cells = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in cells) and all(cell["outputs"] for cell in cells)
    assert not [out for cell in cells for out in cell["outputs"] if out["output_type"] == "error"]
    assert NOTEBOOK.stat().st_size < MAX_BYTES


@pytest.mark.slow
def test_the_notebook_runs() -> None:
    nbformat = pytest.importorskip("nbformat", reason="comes with the extra docs")
    nbclient = pytest.importorskip("nbclient", reason="comes with the extra docs")
    pytest.importorskip("ipykernel", reason="comes with the extra docs")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    place = {"metadata": {"path": str(ROOT)}}
    nbclient.NotebookClient(notebook, timeout=900, kernel_name="python3", resources=place).execute()
    solved = notebook.cells[5].outputs[-1]["data"]["text/plain"]
    assert solved.startswith("Result(") and "1024×1024" in solved
