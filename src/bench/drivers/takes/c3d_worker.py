"""The one place that calls ezc3d, in a process of its own: ``python -m bench.drivers.takes.c3d_worker IN OUT BYTES``.

ezc3d is C++ that believes its input: of 250 files damaged at random (2026-11, ezc3d 1.7.2) one ended the process and
one did not end. As a child process it can do neither to us.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

__all__ = ["main"]

REFUSED = 3
"""Exit code when ezc3d raises; its words are on stderr."""


def main(source: str, target: str, memory_bytes: int) -> int:
    """Read `source` and write what is needed of it to `target`, an ``.npz`` file; return the exit code."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    try:
        content: Any = ezc3d.c3d(source)
        parameters = content["parameters"]
        about = {
            "point": {key: _plain(value) for key, value in parameters.get("POINT", {}).items()},
            "has_trial": "TRIAL" in parameters,
            "frame_rate": float(content["header"]["points"]["frame_rate"]),
        }
        points = np.asarray(content["data"]["points"], np.float64)[:3]
        residuals = np.asarray(content["data"]["meta_points"]["residuals"], np.float64)[0]
    except Exception as error:
        sys.stderr.write(str(error).strip() or type(error).__name__)
        return REFUSED
    with Path(target).open("wb") as file:
        np.savez(file, points=points, residuals=residuals, about=np.array(json.dumps(about)))
    return 0


def _plain(parameter: Any) -> list[Any]:
    """Return a parameter's values as JSON takes them; what is no list of texts or numbers is left out."""
    values = parameter.get("value", []) if isinstance(parameter, dict) else []
    return [value for value in np.asarray(values).ravel().tolist() if isinstance(value, str | int | float)]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
