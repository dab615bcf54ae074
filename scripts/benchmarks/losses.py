"""What a recording loses when its process is killed, at random moments: 500 states and 100 frames a second."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.table import Row, ratio_row

N_KILLED = 50
LOSS_LIMIT_S = 1.0
WRITING_PROCESS = Path(__file__).parents[2] / "tests" / "recording" / "writing_process.py"


def measure_losses() -> list[Row]:
    """Kill processes that record, one after the other, and compare what each put with what its file holds."""
    found = json.loads(subprocess.check_output([sys.executable, WRITING_PROCESS, str(N_KILLED)], text=True))
    what = f"{N_KILLED} killed while recording: "
    return [
        ratio_row(what + "lost at most, s", found["lost_at_most_s"], LOSS_LIMIT_S, "limit"),
        ratio_row(what + "lost in the median, s", found["lost_in_the_median_s"], LOSS_LIMIT_S, "limit"),
        Row(what + "files with gaps before their end", str(found["files_with_gaps"]), "0", "-"),
    ]
