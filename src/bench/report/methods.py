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
    "phase": "Each marker is where it was at the same place of the robot's path: the median of cycles that the most "
    "probable chain sorts, moved by what this cycle strays from it; the median follows the cable over the test. On "
    "simulated crossing motion that no number was chosen on, with 5 % of the markers hidden and two ghosts, 99.98 % of "
    "the frames were exact; with 10 % and four ghosts, most of them beside the cable, 99.9 %; with 25 markers at 40 mm "
    "99.9 %. What is left are ghosts within millimetres of a hidden marker, some riding along with it.",
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
    "elastica": "A heavy rod between both clamps: it hangs under its weight, bends with one stiffness for the whole "
    "recording, and starts in the directions in which it is held. So it knows the bends beside the clamps that no "
    "marker shows. On simulated clamped rods (markers every 167 mm, 0.2 mm noise, clamps to 0.3 degrees) it read the "
    "largest curvature to 0.1 % on average where the true smallest radius was 129, 81, 43 and 27 mm, each frame to "
    "0.2 to 0.5 %, and its band held the truth in 93 to 97 % of places. It is as right as the cable is such a rod at "
    "rest: strands that slip as it bends, read with one stiffness, gave 9 to 38 % too low; motion above 0.5 m/s a "
    "range at the clamp 21 % too low. Then it misses the markers, and the report warns.",
    "menger_gp": "Circles through neighbouring markers, and from a clamp's known direction to the next marker, "
    "smoothed as the recording's own frames tell; its band is the posterior's, widened where single bends miss it. "
    "On a circle of eight markers with 0.2 mm noise the radius errs by 0.1 %, on a catenary of twelve by 14 % where "
    "it is flattest, and the band holds the truth in 99 % of places. A bend beside a clamp that is shorter than the "
    "distance between markers it cannot see, and then its band does not hold the peak: on simulated clamped cables "
    "(markers every 167 mm) it read the largest curvature 4, 24 and 56 % too low where the true smallest radius was "
    "81, 43 and 27 mm, and 22, 64 and 82 % without the clamps' directions, where the band is twice as wide; the report "
    "warns of the worst of these, and where the largest bend is beside an end whose direction is not known. "
    "On a straight cable it reads noise, up to two standard deviations.",
    "spline": "A cubic spline through the markers, bent freely at both ends. It cannot see a bend shorter than the "
    "distance between markers, and cables bend most in just such places: beside the clamps. On simulated clamped "
    "cables (markers every 167 mm) it read the largest curvature 3, 33, 61 and 74 % too low where the true smallest "
    "radius was 136, 95, 55 and 36 mm: the cable was bent up to nearly four times tighter than it said. "
    "Between the clamps it waves about the truth: eight markers on a circle give radii up to 15.5 % wrong at "
    "the ends and 8 % inside; twelve on a catenary 12 % at the ends. Markers set closer towards the clamps help most.",
}
CYCLES = {
    "counter": "The robot's own counter says which cycle a moment belongs to. Phase is what the program reports of its "
    "place on the path; without that, the time at which a usual cycle was in the same place, found by the way that the "
    "joints went, so that a slowed cycle aligns; without joints, the share of the cycle's time that has passed.",
    "digital output": "The edges of a digital output say which cycle a moment belongs to, each to one robot sample. An "
    "edge that no sample shows, for the stream had a gap or the pulse was shorter than a sample, is a cycle lost.",
    "joints' return": "A cycle is the time from leaving the start pose to being back in it and at rest. A path that "
    "rests at its start pose half-way is counted as two cycles.",
    "motion that repeats": "No robot: the cycles are those in which the points come back to the same places, at least "
    "three times. Each start is where the take is most like the other starts, or where motion begins after each rest; "
    "phase is the share of the cycle's time that has passed.",
    "whole": "No robot, and no motion that repeats three times, or so configured: the whole take counts as cycle 0, "
    "and phase is the share of its time that has passed.",
}
OTHERWISE = "No figures for this method are kept with this report."


def describe_methods(results: Results) -> list[MethodNote]:
    """Return the steps of the analysis with their limits, in the order in which they were taken."""
    known = {"cycles": CYCLES, "sorting": SORTING, "curvature": CURVATURE}
    order = [*[step for step in known if step in results.methods], *sorted(results.methods.keys() - known.keys())]
    notes = [
        _note(step, results.methods[step], known.get(step, {}), results.method_notes.get(step, [])) for step in order
    ]
    return [*notes, _maximum_note(), _interval_note(results)]


def warn_about_clamps(results: Results) -> str:
    """Return the sentence for the first screen when the curvature's method under-reads beside clamps, else empty."""
    method = results.methods.get("curvature", "").lower()
    blind = {"spline": "a spline through the markers", "menger_gp": "the markers alone, without a fitted rod,"}
    said = next((text for name, text in blind.items() if name in method), "")
    if "elastica" in method or not said:
        return ""
    return (
        f"Beside the clamps the cable may be bent tighter than any radius on this page: {said} cannot show the short "
        "bends there (see Methods and their limits)."
    )


def _note(step: str, method: str, known: dict[str, str], in_this_run: list[str]) -> MethodNote:
    limits = [text for name, text in known.items() if name in method.lower()] or [OTHERWISE]
    return MethodNote(step, method, " ".join([*limits, *in_this_run]))


def _maximum_note() -> MethodNote:
    return MethodNote(
        "largest curvature",
        "averaged over neighbours in time",
        "The largest of many noisy values lies above the truth: of 200 equal values with independent noise by about "
        "2.7 standard deviations. So each frame is averaged with as many neighbours in time as noise deserves and "
        "motion allows, 1 to 33 frames in all, before a cycle's largest curvature is taken; its standard deviation is "
        "what is left. The map is a median over all cycles.",
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
