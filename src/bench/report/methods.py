"""What the methods cannot do, in words that a reader of the report needs before trusting a number."""

from __future__ import annotations

from dataclasses import dataclass

from bench.report.results import Results

__all__ = ["MethodNote", "describe_methods", "warn_about_clamps"]


@dataclass(frozen=True)
class MethodNote:
    """One step of the analysis: what was used, and what it is known to get wrong."""

    step: str
    method: str
    limits: str


SORTING = {
    "chain": "The most probable chain of points in each frame by itself: by distances and turning angles, which are "
    "learnt from this take, both ends, and up to three hidden markers in a row. A ghost beside a hidden one can take "
    "its place: with 5 % of the markers hidden and two ghosts in each simulated frame that costs up to 1 % of the "
    "frames, with 10 % and four ghosts beside the cable up to 5 %. Frames in which two chains are nearly as probable "
    "are marked.",
    "paper": "A greedy chain from the anchor: each next marker is the nearest unused point inside its distance gate. "
    "Exact while every marker is seen and no ghost lies near the cable. On simulated motion with 5 % of the markers "
    "hidden and two ghosts in each frame it was exact in 64 % of the frames, and in 41 % where the cable crossed "
    "itself; a wrong marker shows as a bend that is not there.",
    "track": "Points are joined into tracks through time, the most probable chain of single frames names the tracks, "
    "and where a marker is hidden only a point that fits its motion before and after is taken. On a real cable with "
    "many ghosts 99.8 % of the frames were exact and 0.03 % had a wrong label; a ghost that rides along within a few "
    "millimetres of a hidden marker can still take its place. Markers filled in between tracks are marked.",
}
CURVATURE = {
    "spline": "A cubic spline through the markers, bent freely at both ends. It cannot see a bend shorter than the "
    "distance between markers, and cables bend most in just such places: beside the clamps. On simulated clamped "
    "cables (markers every 167 mm) it read the largest curvature 3, 33, 61 and 74 % too low where the true smallest "
    "radius was 136, 95, 55 and 36 mm: the cable was bent up to nearly four times tighter than it said. "
    "Between the clamps it waves about the truth: eight markers on a circle give radii up to 15.5 % wrong at "
    "the ends and 8 % inside; twelve on a catenary 12 % at the ends. Markers set closer towards the clamps help most.",
}
CYCLES = {
    "counter": "The robot's own counter says which cycle a moment belongs to; phase is the share of the cycle's time "
    "that has passed, or the place on the path where the program reports it.",
    "digital output": "The edges of a digital output say which cycle a moment belongs to, each to one robot sample. An "
    "edge that no sample shows, for the stream had a gap or the pulse was shorter than a sample, is a cycle lost.",
    "joints' return": "A cycle is the time from leaving the start pose to being back in it and at rest. A path that "
    "rests at its start pose half-way is counted as two cycles.",
    "whole": "No robot: the whole take counts as cycle 0, and phase is the share of its time that has passed.",
}
OTHERWISE = "No figures for this method are kept with this report."


def describe_methods(results: Results) -> list[MethodNote]:
    """Return the steps of the analysis with their limits, in the order in which they were taken."""
    known = {"cycles": CYCLES, "sorting": SORTING, "curvature": CURVATURE}
    order = [*[step for step in known if step in results.methods], *sorted(results.methods.keys() - known.keys())]
    notes = [_note(step, results.methods[step], known.get(step, {})) for step in order]
    return [*notes, _maximum_note(), _interval_note(results)]


def warn_about_clamps(results: Results) -> str:
    """Return the sentence for the first screen when the curvature's method under-reads beside clamps, else empty."""
    if "spline" not in results.methods.get("curvature", "").lower():
        return ""
    return (
        "The spline reads bends beside the clamps too gently: the cable may be bent tighter there than any radius "
        "on this page (see Methods and their limits)."
    )


def _note(step: str, method: str, known: dict[str, str]) -> MethodNote:
    limits = next((text for name, text in known.items() if name in method.lower()), OTHERWISE)
    return MethodNote(step, method, limits)


def _maximum_note() -> MethodNote:
    return MethodNote(
        "largest curvature",
        "largest value of a cycle",
        "The largest of many noisy values lies above the truth: of 200 equal values with independent noise, the "
        "largest is about 2.7 standard deviations too large. So a cycle's smallest bend radius reads too tight "
        "where noise rules, and the map, being a median over all cycles, does not.",
    )


def _interval_note(results: Results) -> MethodNote:
    noise_mm = results.config.analysis.marker_noise_mm
    return MethodNote(
        "uncertainty",
        "two standard deviations",
        f"From a noise of {noise_mm:g} mm in each coordinate of each marker ([analysis] marker_noise_mm), carried "
        "through the curve. A bend radius R has the interval R / (1 ± 2σ/κ). It holds neither the method's own error "
        "nor markers glued in the wrong place nor the tracker's calibration.",
    )
