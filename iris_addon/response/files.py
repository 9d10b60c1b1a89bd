"""Response curves from files: a solved response.json, or a table as .npy or text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..json_files import read_json
from .curve import N_SAMPLES, Response

MAX_BYTES = 16 << 20


def read_response(path: Path) -> Response:
    """A monotone curve of 2 or more samples over x = 0 ... 1, for one or three channels.

    Accepts response.json of a result, .npy with (n,) or (3, n), or a text table of one or three columns.

    Raises:
        BadInput: missing, too large, not a table, not finite or falling.
    """
    mend = "give a response.json of a solve, or a table with one or three curves"
    if not path.is_file():
        raise BadInput("there is no such response file", "check the path", path)
    size = path.stat().st_size
    if size == 0 or size > MAX_BYTES:
        raise BadInput("the response file is empty" if size == 0 else "the response file is far too large", mend, path)
    try:
        if path.suffix == ".json":
            table = np.asarray(read_json(path).get("samples"), np.float64)
        elif path.suffix == ".npy":
            table = np.load(path, allow_pickle=False).astype(np.float64)
        else:
            table = np.loadtxt(path, dtype=np.float64, ndmin=2).T
    except (ValueError, TypeError, OSError, EOFError) as error:
        raise BadInput(f"the response file cannot be read ({error})", mend, path) from error
    table = np.atleast_2d(table)
    if table.ndim != 2 or table.shape[0] not in (1, 3) or table.shape[1] < 2 or not np.isfinite(table).all():
        raise BadInput(f"the response table has shape {table.shape} or is not finite", mend, path)
    if (np.diff(table, axis=1) < -1e-6).any() or (table[:, -1] <= table[:, 0]).any():
        raise BadInput("the response curve falls or is flat", "a response must rise with exposure", path)
    table = (table - table[:, :1]) / (table[:, -1:] - table[:, :1])
    x = np.linspace(0, 1, N_SAMPLES)
    rows = [np.interp(x, np.linspace(0, 1, table.shape[1]), np.maximum.accumulate(row)) for row in table]
    return Response(np.stack(rows if len(rows) == 3 else rows * 3), "file")
