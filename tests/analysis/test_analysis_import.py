"""What a notebook's `from bench.analysis import …` waits for: numpy, and nothing that only some functions need."""

import subprocess
import sys

SLOW = ("matplotlib", "numba", "pandas", "pyarrow", "pydantic")
"""Libraries that take 0.05 to 0.5 s to load."""
SCIPY = ("interpolate", "linalg", "ndimage", "optimize", "signal", "sparse", "spatial", "special", "stats")


def test_importing_the_analysis_loads_no_part_of_scipy_and_no_slow_library() -> None:
    code = "import sys, bench.analysis; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(ran.stdout.split())
    assert "bench.analysis.sorting.chain" in loaded
    assert loaded.isdisjoint([*SLOW, *(f"scipy.{part}" for part in SCIPY)])
