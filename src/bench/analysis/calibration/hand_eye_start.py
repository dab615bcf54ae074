"""Where the hand-eye fit starts: rotations in closed form, shifts linearly, both against a minority of wrong poses."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.calibration.rigid import RigidTransform, align_points, estimate_sigma

__all__ = ["start_from_body", "start_from_marker"]

ROUNDS = 10
"""Reweighting by distance, so that wrong poses pull no harder than right ones: a start need not be exact."""
MARKER_ROUNDS = 60
"""Most rounds of the alternation for a single marker: it halves its error in one to three."""
NEAR_M = 0.002
"""A step of it that is near enough for the fit."""
SMALLEST = 1e-12


def start_from_body(
    turn: Floats, place_m: Floats, seen_turn: Floats, seen_m: Floats
) -> tuple[RigidTransform, RigidTransform]:
    """Return lab-from-base and TCP-from-body for TCP poses (n, 3, 3), (n, 3) and the body's poses of the same moments.

    References
    ----------
    M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product", J. Mechanisms
    Robotics 5 (2013) 031007: the rotations.
    """
    lab_turn, body_turn = _closed_rotations(turn, seen_turn)
    shift, point = _linear_shifts(lab_turn, turn, place_m, seen_m)
    return RigidTransform(lab_turn, shift), RigidTransform(body_turn, point)


def start_from_marker(turn: Floats, place_m: Floats, seen_m: Floats) -> tuple[RigidTransform, RigidTransform]:
    """Return the same for a single marker seen at (n, 3), without a rotation of its own.

    Alternates between the transform for a given point in the TCP frame and the point for a given transform.
    """
    point = np.zeros(3)
    for _ in range(MARKER_ROUNDS):
        lab, _ = align_points(place_m + turn @ point, seen_m, np.ones(len(place_m)))
        before, (_, point) = point, _linear_shifts(lab.rotation, turn, place_m, seen_m)
        if np.linalg.norm(point - before) < NEAR_M:
            break
    return lab, RigidTransform(np.eye(3), point)


def _closed_rotations(robot: Floats, seen: Floats) -> tuple[Floats, Floats]:
    """Return lab and body rotation from ``seen = lab * robot * body``, by singular values, reweighted."""
    weight = np.ones(len(robot))
    for _ in range(ROUNDS):
        matrix = np.einsum("n,nab,ncd->acbd", weight / weight.sum(), robot, seen).reshape(9, 9)
        u, _, vt = np.linalg.svd(matrix)
        sign = np.sign(np.linalg.det(u[:, 0].reshape(3, 3))) or 1.0
        lab = _nearest_rotation(sign * u[:, 0].reshape(3, 3).T)
        body = _nearest_rotation(sign * vt[0].reshape(3, 3))
        apart = np.linalg.norm(lab @ robot @ body - seen, axis=(1, 2))
        weight = 1.0 / np.maximum(apart, np.median(apart) + SMALLEST)
    return lab, body


def _nearest_rotation(matrix: Floats) -> Floats:
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _linear_shifts(lab_turn: Floats, robot: Floats, place_m: Floats, seen_m: Floats) -> tuple[Floats, Floats]:
    """Return the lab frame's shift and the point in the TCP frame for a known rotation, by reweighted linear fit."""
    matrix = np.concatenate([np.broadcast_to(np.eye(3), robot.shape), lab_turn @ robot], axis=2)
    goal = seen_m - place_m @ lab_turn.T
    weight = np.ones(len(goal))
    for _ in range(ROUNDS):
        root = np.sqrt(weight)[:, None]
        found = np.linalg.lstsq((matrix * root[:, :, None]).reshape(-1, 6), (goal * root).ravel(), rcond=1e-9)[0]
        apart = np.linalg.norm(matrix @ found - goal, axis=1)
        weight = 1.0 / np.maximum(apart, estimate_sigma(apart))
    return found[:3], found[3:]
