import numpy as np
import pytest
from scipy.integrate import solve_bvp

from bench.errors import ConfigError
from bench.simulation.elastica import Clamps, Elastica, Shape

WEIGHT = 1.5
SLACK = Clamps(0.7, 0.05, -0.6, 0.5)


def nodes(rod, shape):
    steps = np.stack([np.cos(shape.angle_rad), np.sin(shape.angle_rad)], axis=1) * rod.segment_m
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def solve_continuous(rod, shape, stiffness, length):
    """Solve the same boundary value problem as differential equations; scipy brings the method."""

    def slope(s, y, force):
        angle, curvature = y[0], y[1]
        carried = force[1] - WEIGHT * (length - s)
        moment = force[0] * np.sin(angle) - carried * np.cos(angle)
        return np.stack([curvature, moment / stiffness, np.cos(angle), np.sin(angle)])

    def ends(a, b, force):
        held = shape.clamps
        return np.array([a[0] - held.start_rad, b[0] - held.end_rad, a[2], a[3], b[2] - held.x_m, b[3] - held.y_m])

    s = (np.arange(rod.n_segments) + 0.5) * rod.segment_m
    middle = 0.5 * (nodes(rod, shape)[1:] + nodes(rod, shape)[:-1])
    guess = np.stack([shape.angle_rad, np.gradient(shape.angle_rad, s), *middle.T])
    grid = np.concatenate([[0.0], s, [length]])
    start = np.concatenate([guess[:, :1], guess, guess[:, -1:]], axis=1)
    found = solve_bvp(slope, ends, grid, start, p=np.array(shape.force_n), tol=1e-6, max_nodes=20_000)
    assert found.success
    return found


@pytest.mark.parametrize(("stiffness", "n_segments"), [(0.1, 150), (0.02, 150), (0.005, 300)])
def test_the_rod_agrees_with_the_differential_equations(stiffness, n_segments):
    length = 1.2
    rod = Elastica(length, WEIGHT, stiffness, n_segments)
    shape = rod.hang(SLACK)
    found = solve_continuous(rod, shape, stiffness, length)
    s = np.linspace(0.0, length, n_segments + 1)
    angle, curvature, x, y = found.sol(s)
    np.testing.assert_allclose(nodes(rod, shape), np.stack([x, y], axis=1), atol=3e-4)
    np.testing.assert_allclose(rod.curvature(shape), curvature, atol=0.001 * np.abs(curvature).max())
    np.testing.assert_allclose(rod.curvature(shape)[[0, -1]], curvature[[0, -1]], rtol=0.001)
    np.testing.assert_allclose(shape.force_n, found.p, rtol=5e-3)
    assert angle[0] == pytest.approx(SLACK.start_rad)


def limp_rod(stiffness):
    """Return the middle third of a limp rod, its catenary parameter, and the length such a catenary would have."""
    span = 0.8
    rod = Elastica(1.2, WEIGHT, stiffness, 1200)
    shape = rod.hang(Clamps(span, 0.0, -0.3, 0.3))
    parameter = shape.force_n[0] / WEIGHT
    middle = nodes(rod, shape)[400:801] - [span / 2, 0.0]
    return middle, parameter, 2 * parameter * np.sinh(span / (2 * parameter))


def test_a_limp_rod_hangs_as_a_catenary_away_from_its_clamps():
    middle, parameter, _ = limp_rod(1e-5)
    x, y = middle.T
    np.testing.assert_allclose(y - y.min(), parameter * (np.cosh(x / parameter) - 1.0), atol=2e-4)


def test_the_clamps_reach_in_by_the_root_of_the_stiffness():
    errors = [limp_rod(stiffness)[2] - 1.2 for stiffness in (4e-5, 1e-5, 2.5e-6)]
    assert errors[2] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


def test_the_ends_are_where_they_are_held():
    rod = Elastica(1.0, WEIGHT, 0.02)
    end = nodes(rod, rod.hang(SLACK))[-1]
    np.testing.assert_allclose(end, [SLACK.x_m, SLACK.y_m], atol=1e-9)


def test_forces_and_moments_balance_on_the_whole_rod():
    length, stiffness = 1.1, 0.02
    rod = Elastica(length, WEIGHT, stiffness, 400)
    shape = rod.hang(SLACK)
    h, angle = rod.segment_m, shape.angle_rad
    start_moment = stiffness * (angle[0] - SLACK.start_rad) / (h / 2)
    end_moment = stiffness * (SLACK.end_rad - angle[-1]) / (h / 2)
    at = nodes(rod, shape)
    middle = 0.5 * (at[1:] + at[:-1])
    of_weight = np.sum(-WEIGHT * h * middle[:, 0])
    of_end_force = SLACK.x_m * shape.force_n[1] - SLACK.y_m * shape.force_n[0]
    assert end_moment - start_moment + of_weight + of_end_force == pytest.approx(0.0, abs=1e-9)


def test_no_neighbouring_shape_has_less_energy():
    rod = Elastica(1.0, WEIGHT, 0.02, 150)
    shape = rod.hang(SLACK)

    def energy(angle):
        bends = np.diff(angle, prepend=SLACK.start_rad, append=SLACK.end_rad)
        bends[[0, -1]] *= np.sqrt(2.0)
        height = np.cumsum(np.sin(angle)) - 0.5 * np.sin(angle)
        return 0.02 / (2 * rod.segment_m) * np.sum(bends**2) + WEIGHT * rod.segment_m**2 * np.sum(height)

    rng = np.random.default_rng(6)
    other_ends = [rod.follow(shape, Clamps(0.7 + dx, 0.05 + dy, -0.6, 0.5)) for dx, dy in rng.normal(size=(4, 2)) / 50]
    for other in other_ends:
        # The end force is the energy's derivative by the end's position.
        dx, dy = other.clamps.x_m - SLACK.x_m, other.clamps.y_m - SLACK.y_m
        force = 0.5 * (np.array(shape.force_n) + other.force_n)
        work = force @ [dx, dy]
        assert energy(other.angle_rad) - energy(shape.angle_rad) == pytest.approx(work, rel=2e-2, abs=1e-6)
    assert rod.is_stable(shape)


def test_the_solution_does_not_depend_on_the_way_to_it():
    rod = Elastica(1.0, WEIGHT, 0.02)
    straight = rod.hang(SLACK)
    around = rod.follow(rod.follow(straight, Clamps(0.5, 0.2, -1.0, 0.9)), SLACK)
    np.testing.assert_allclose(around.angle_rad, straight.angle_rad, atol=1e-8)


def test_a_long_way_is_halved_until_the_shape_can_follow():
    rod = Elastica(1.0, WEIGHT, 0.02)
    far = Clamps(0.3, -0.3, -1.4, 1.2)
    np.testing.assert_allclose(rod.follow(rod.hang(SLACK), far).angle_rad, rod.hang(far).angle_rad, atol=1e-8)


def test_a_limp_arch_that_stands_on_its_head_is_not_stable():
    rod = Elastica(1.0, WEIGHT, 1e-3, 150)
    hanging = rod.hang(Clamps(0.7, 0.0, -1.0, 1.0))
    mirrored = Shape(Clamps(0.7, 0.0, 1.0, -1.0), -hanging.angle_rad, (-hanging.force_n[0], hanging.force_n[1]))
    standing = rod.follow(mirrored, mirrored.clamps)
    assert nodes(rod, standing)[75, 1] > 0.1
    assert rod.is_stable(hanging)
    assert not rod.is_stable(standing)


def test_a_cable_that_is_too_short_is_refused_with_its_length():
    with pytest.raises(ConfigError, match=r"cable of 0.6 m cannot hang between ends that are 0.702 m apart"):
        Elastica(0.6, WEIGHT, 0.02).hang(SLACK)
