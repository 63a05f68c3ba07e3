"""Pairs of plots and looks: found wherever the plots are off, and not made of clutter."""

from __future__ import annotations

import numpy as np
import pytest

from plotfeed.models.residuals import Candidates, look_groups, plot_pairs

REACH = np.array([8.0, 500.0])


def candidates(
    rng: np.random.Generator,
    looks: int = 120,
    *,
    off: tuple[float, float] = (0.0, 0.0),
    spread: float = 1.0,
    pd: float = 0.9,
    clutter: float = 0.2,
) -> tuple[Candidates, int]:
    """Plots of looks, errors of 0.1 degrees and 5 m, and clutter about each; how many are real."""
    hit = np.flatnonzero(rng.random(looks) < pd)
    real = np.array(off) + spread * np.array([0.1, 5.0]) * rng.standard_normal((len(hit), 2))
    around = np.repeat(np.arange(looks), rng.poisson(clutter, looks))
    false = rng.uniform(-1, 1, (len(around), 2)) * [8.0, 500.0]
    error = np.concatenate([real, false])
    return (
        Candidates(
            plot=np.arange(len(error)),
            look=np.concatenate([hit, around]),
            error=error,
            sigma=np.tile([0.1, 5.0], (len(error), 1)),
        ),
        len(hit),
    )


@pytest.mark.parametrize("clutter", [0.0, 0.2, 2.0])
@pytest.mark.parametrize("off", [(0.0, 0.0), (2.0, 0.0), (0.0, 120.0), (-3.0, -60.0)])
def test_plots_are_found_however_far_they_are_off(off: tuple[float, float], clutter: float) -> None:
    found, real = candidates(np.random.default_rng(1), off=off, clutter=clutter)
    pairs = plot_pairs(found, REACH, 120)
    assert (pairs.chosen < real).sum() >= real - 1  # five standard deviations, seldom more
    assert (pairs.chosen >= real).sum() <= 3
    assert (np.abs(pairs.centre - off) <= [0.2, 10.0]).all()


def test_a_gate_is_as_wide_as_errors_are_and_no_wider_for_clutter() -> None:
    rng = np.random.default_rng(2)
    wide, real = candidates(rng, spread=2.5)
    pairs = plot_pairs(wide, REACH, 120)
    assert (pairs.chosen < real).sum() >= real - 1
    assert (pairs.gate > 9).all()
    dense, _ = candidates(rng, pd=0.2, clutter=20.0)
    assert (plot_pairs(dense, REACH, 120).gate == 5.0).all()


def test_what_is_false_in_gates_is_counted_beside_them() -> None:
    rng = np.random.default_rng(3)
    found, _ = candidates(rng, looks=4000, pd=0.5, clutter=5.0)
    pairs = plot_pairs(found, REACH, 4000)
    expected = 5.0 * (1.0 / 16.0) * (50.0 / 1000.0)  # the gate's share of the area
    assert abs(pairs.false_per_look / expected - 1) < 0.15


def test_no_plot_and_no_look_is_taken_twice() -> None:
    both = Candidates(
        plot=np.array([0, 0, 1, 1]),
        look=np.array([0, 1, 0, 1]),
        error=np.array([[0.0, 0.0], [0.1, 5.0], [0.2, 0.0], [0.0, 1.0]]),
        sigma=np.tile([0.1, 5.0], (4, 1)),
    )
    pairs = plot_pairs(both, REACH, 2)
    assert pairs.chosen.tolist() == [0, 3]


def test_plots_of_a_coarse_channel_are_looked_for_as_far_as_their_own_errors_go() -> None:
    """Errors of 300 m beside many of 5 m, of which the usual one is."""
    rng = np.random.default_rng(5)
    sigma = np.repeat([[0.1, 5.0], [0.1, 300.0]], [300, 100], axis=0)
    found = Candidates(
        plot=np.arange(400),
        look=np.arange(400),
        error=sigma * rng.standard_normal((400, 2)),
        sigma=sigma,
    )
    assert len(plot_pairs(found, REACH, 400).chosen) == 400


def test_looks_form_groups_within_the_widths_that_plots_do_not_tell_apart() -> None:
    azimuth_deg = np.array([359.9, 0.3, 1.0, 90.0, 0.2])
    range_m = np.array([100.0, 103.0, 106.0, 100.0, 500.0])
    group = look_groups([(azimuth_deg / 1.0, 360.0), (range_m / 10.0, 0.0)])
    assert group[0] == group[1] == group[2]  # over north, the ends by what is between
    assert len({*group.tolist()}) == 3
    assert look_groups([(np.zeros(1), 0.0)]).tolist() == [0]
