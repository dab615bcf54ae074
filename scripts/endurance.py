"""Kills and stalls bench and a simulated controller at random moments of one test, and checks what is left of it.

The operator is played by the book: what the screen says is done, and nothing else. The faults are real ones: SIGKILL,
and SIGSTOP followed by SIGCONT. The simulated controller is a process of its own, as a robot is; real time.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

from endurance_rig.checks import check_parts
from endurance_rig.lab import Fault, Lab

KINDS = ("kill bench", "kill controller", "stall controller", "stall bench")


def main() -> None:
    arguments = parse_arguments()
    folder = Path(tempfile.mkdtemp(prefix="bench-endurance-")) if arguments.folder is None else arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    print(f"seed {arguments.seed}: {arguments.faults} faults in {arguments.cycles} cycles, in {folder}", flush=True)
    began_s = time.monotonic()
    lab = Lab(folder, arguments.host, arguments.cycles, arguments.cycle_s, arguments.stall_s)
    try:
        faults = run_test(lab, random.Random(arguments.seed), arguments.faults)
    finally:
        lab.close()
    failures = check_parts(lab.parts, faults, arguments.cycles, folder / "reports")
    print_faults(faults)
    verdict = "; ".join(failures) or f"{arguments.cycles} cycles, each once, and every fault is named"
    print(f"{len(lab.parts)} files in {time.monotonic() - began_s:.0f} s: {verdict}")
    if failures:
        sys.exit(1)
    if arguments.folder is None:
        shutil.rmtree(folder)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--faults", type=int, default=20, help="as many of each of the four kinds as can be")
    parser.add_argument("--seed", type=int, default=random.randrange(1_000_000))
    parser.add_argument("--cycle-s", type=float, default=0.6)
    parser.add_argument("--stall-s", type=float, default=3.0)
    parser.add_argument("--host", default="127.0.0.41", help="loopback address of the controller; the next is used too")
    parser.add_argument("--folder", type=Path, help="where to leave all files; left out: nowhere, if all is well")
    return parser.parse_args()


def run_test(lab: Lab, chance: random.Random, n_faults: int) -> list[Fault]:
    """Run the test to its end with faults after random cycles, at random moments of the next one."""
    kinds = [KINDS[number % len(KINDS)] for number in range(n_faults)]
    chance.shuffle(kinds)
    moments = sorted(chance.sample(range(1, lab.n_cycles - 1), n_faults))
    faults = []
    lab.start()
    for kind, n_completed in zip(kinds, moments, strict=True):
        lab.wait_for_cycles(n_completed, chance.uniform(0.0, lab.cycle_s))
        fault = lab.suffer(kind)
        print(f"{kind} after {fault.n_completed} cycles: {fault.outcome}")
        print("".join(f"    {line}\n" for line in fault.told), end="", flush=True)
        faults.append(fault)
    lab.finish()
    return faults


def print_faults(faults: list[Fault]) -> None:
    rows = [("after cycles", "fault", "what happened", "run file", "named in its report")]
    for fault in faults:
        named = "; ".join(fault.named) or "NO"
        rows.append((str(fault.n_completed), fault.kind, fault.outcome, str(fault.part), named))
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


if __name__ == "__main__":
    main()
