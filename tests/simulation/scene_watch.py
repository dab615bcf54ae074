"""A simulated scene whose robot moves, and what it shows and knows."""

from bench.config import Config
from bench.simulation.path import JointPath
from bench.simulation.program import PathProgram
from bench.simulation.scene import Scene, make_cable

MS = 1_000_000
START = 1_700_000_000_000_000_000
PATH = JointPath()
ARC_LENGTH = [0.06, 0.18, 0.3, 0.42, 0.54, 0.66, 0.78, 0.9, 1.02, 1.14]


def make_config(anchor=None, end=None, arc_length=ARC_LENGTH, flange_body="", **simulation):
    cable = {
        "length_m": 1.2,
        "diameter_mm": 8.0,
        "marker_arc_length_m": arc_length,
        "minimum_bend_radius_mm": 60.0,
        "anchor": anchor or {"kind": "static_marker"},
    }
    if end is not None:
        cable["end"] = end
    calibration = {"flange_body": flange_body}
    return Config.model_validate({"cable": cable, "simulation": simulation, "calibration": calibration})


def make_default_cable():
    return make_cable(make_config(), PATH)


class Watch:
    """A scene whose robot moves, and the truth it hands over."""

    def __init__(self, config, cable, path=PATH):
        self.program = PathProgram(cycle_s=1.0, path=path)
        self.program.play()
        self.truth = []
        self.scene = Scene(config, self.program, cable=cable, truth=lambda *row: self.truth.append(row))
        self.cable = self.scene.cable
        self.now = START

    def expose(self, n_frames):
        seen = []
        for _ in range(n_frames):
            self.now += 10 * MS
            self.program.tick(self.now, 100)
            seen.append(self.scene.expose(1000 + len(self.truth), self.now + 3 * MS))
        return seen

    def place(self, index=-1):
        return self.truth[index][2].place
