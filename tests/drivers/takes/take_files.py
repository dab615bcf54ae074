"""Writes takes as the tracker's software does, for tests: the reader must give back what was written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench.drivers.takes import read_take
from bench.model import TrackerFrame

DATA = Path(__file__).parent / "data"
WITH_MARKERS = DATA / "ha5dzs" / "test_markers_enabled.csv"
WITHOUT_MARKERS = DATA / "ha5dzs" / "test_default.csv"
RIGID_BODY = DATA / "hmv" / "sample_optitrack_take.csv"
BEAM = DATA / "beam" / "beam_gravity_V2_a.c3d"

Point = tuple[float, float, float] | None
Pose = tuple[float, ...]


@dataclass
class MotiveTake:
    """What is to stand in a Motive export: markers by name, and for each frame one point or None for each of them."""

    names: Sequence[str]
    frames: Sequence[Sequence[Point]]
    version: str = "1.23"
    rate: str = "120.000000"
    units: str = "Meters"
    first_frame: int = 0
    numbers: Sequence[int] | None = None
    promised: int | None = None
    keys: dict[str, str] = field(default_factory=dict)
    timecode: bool = False
    parents: Sequence[str] = ()
    bodies: Sequence[str] = ()
    poses: Sequence[Sequence[Pose | None]] = ()
    """For each frame, for each body: qx, qy, qz, qw, x, y, z, error."""

    def text(self) -> str:
        """Return the export."""
        lines = [",".join(f"{key},{value}" for key, value in self._keys().items()), ""]
        lines += [",".join(row) for row in self._header()]
        numbers = self.numbers or range(self.first_frame, self.first_frame + len(self.frames))
        lines += [self._row(i, number) for i, number in enumerate(numbers)]
        return "\n".join(lines) + "\n"

    def _keys(self) -> dict[str, str]:
        count = len(self.frames) if self.promised is None else self.promised
        return {
            "Format Version": self.version,
            "Take Name": "test",
            "Capture Frame Rate": self.rate,
            "Export Frame Rate": self.rate,
            "Total Exported Frames": str(count),
            "Rotation Type": "Quaternion",
            "Length Units": self.units,
            "Coordinate Space": "Global",
        } | self.keys

    def _header(self) -> list[list[str]]:
        named = self.version not in ("1.2", "1.21")
        columns = [("Rigid Body", name, c, a) for name in self.bodies for c, a in BODY]
        columns += [("Marker", name, "Position", axis) for name in self.names for axis in "XYZ"]
        blank = [""] * (2 + self.timecode)
        words = {"Type": 0, "Name": 1, "ID": 1}
        rows = [[*self._lead(word if named else ""), *(c[i] for c in columns)] for word, i in words.items()]
        if self.parents:
            by_name = dict(zip(self.names, self.parents, strict=True))
            rows.append([*self._lead("Parent"), *(by_name.get(c[1], "") for c in columns)])
        rows.append([*blank, *(c[2] for c in columns)])
        first = ["Frame", "Time (Seconds)" if named else "Time", *(["TimeCode"] if self.timecode else [])]
        return [*rows, [*first, *(c[3] for c in columns)]]

    def _lead(self, word: str) -> list[str]:
        return ["", word, *([""] if self.timecode else [])]

    def _row(self, i: int, number: int) -> str:
        cells = [str(number), f"{number / float(self.rate):.3f}000", *(["15:26:46:12.02"] if self.timecode else [])]
        for pose in self.poses[i] if self.poses else ():
            cells += [f"{value:.6f}" for value in pose] if pose else [""] * len(BODY)
        for point in self.frames[i]:
            cells += [f"{value:.6f}" for value in point] if point else ["", "", ""]
        return ",".join(cells)


BODY = (*(("Rotation", axis) for axis in "XYZW"), *(("Position", axis) for axis in "XYZ"), ("Mean Marker Error", ""))


@dataclass
class TrackingToolsTake:
    """What is to stand in a Tracking Tools export: for each frame its points, in any number and order."""

    frames: Sequence[Sequence[tuple[float, float, float]]]
    version: str = ""
    step_s: float = 0.01
    body: str = "gripper"
    offsets: Sequence[tuple[float, float, float]] = ((0.01, 0.0, 0.0), (0.0, 0.02, 0.0), (-0.01, -0.02, 0.0))
    promised: int | None = None
    extended: bool = False
    bodies: bool = True

    def text(self) -> str:
        """Return the export."""
        word = "rigidbody" if self.version == "1.1" else "trackable"
        count = len(self.frames) if self.promised is None else self.promised
        lines = ['comment,"NaturalPoint Trackable Export Data"', "righthanded"]
        lines += [f"info,version,{self.version}"] * bool(self.version)
        lines += [f"info,framecount,{count}", f"info,{word}count,{int(self.bodies)}"]
        cells = ",".join(f"{v:.8f}" for offset in self.offsets for v in offset)
        lines += [f'{word},"{self.body}",7,{len(self.offsets)},{cells}'] * self.bodies
        for i, points in enumerate(self.frames):
            lines.append(self._frame(i, points))
            if self.extended:
                lines.append(f'{word},{i},{i * self.step_s:.8f},"{self.body}",7,0,3,0.1,0.2,NAN,0.001')
        return "\n".join(lines) + "\n"

    def _frame(self, i: int, points: Sequence[tuple[float, float, float]]) -> str:
        pose = "1,7,0.1,0.2,0.3,0,0,0,1,0.0,0.0,0.0" if self.bodies else "0"
        tail = "1000,marker" if self.version == "1.1" else "0"
        seen = "".join(f",{x:.8f},{y:.8f},{z:.8f},{tail}" for x, y, z in points)
        return f"frame,{i},{i * self.step_s:.8f},{pose},{len(points)}{seen}"


@dataclass
class TrcTake:
    """What is to stand in a TRC file: markers by name, and for each frame one point or None for each of them."""

    names: Sequence[str]
    frames: Sequence[Sequence[Point]]
    rate: str = "120.00"
    units: str = "mm"
    first_frame: int = 1
    promised: int | None = None
    blank_line: bool = True

    def text(self) -> str:
        """Return the file."""
        n = len(self.names)
        count = len(self.frames) if self.promised is None else self.promised
        keys = [
            "DataRate",
            "CameraRate",
            "NumFrames",
            "NumMarkers",
            "Units",
            "OrigDataRate",
            "OrigDataStartFrame",
            "OrigNumFrames",
        ]
        values = [self.rate, self.rate, str(count), str(n), self.units, self.rate, str(self.first_frame), str(count)]
        lines = [
            ["PathFileType", "4", "(X/Y/Z)", "test.trc"],
            keys,
            values,
            ["Frame#", "Time", *(cell for name in self.names for cell in (name, "", ""))],
            ["", "", *(f"{axis}{i}" for i in range(1, n + 1) for axis in "XYZ")],
        ]
        lines += [[]] * self.blank_line
        for i, points in enumerate(self.frames):
            cells = [f"{value:.6f}" if point else "" for point in points for value in point or (0, 0, 0)]
            lines.append([str(self.first_frame + i), f"{i / float(self.rate):.3f}", *cells])
        return "\n".join("\t".join(line) for line in lines) + "\n"


def read_all(path: Path) -> list[TrackerFrame]:
    """Read a take to its end, where what is wrong with a cell is found at the latest."""
    return list(read_take(path).frames)


def write(folder: Path, text: str | bytes, name: str = "take.csv") -> Path:
    """Write a take and return its path."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path
