from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.links import link

from plotfeed.feeds.link.delays import DelayLaw
from plotfeed.feeds.scene.link_keys import LONGEST_DELAY_MS

NAMED = ("normal", "uniform", "pareto", "paretonormal")
TABLES = Path("/usr/lib/x86_64-linux-gnu/tc")
QUANTILES = {
    # Of the tables of iproute2 6.1, in jitters.
    "normal": {0.01: -2.3253, 0.1: -1.2816, 0.25: -0.6746, 0.75: 0.6740, 0.9: 1.2805, 0.99: 2.3185},
    "pareto": {0.01: -0.6622, 0.1: -0.6191, 0.5: -0.3203, 0.75: 0.1160, 0.9: 0.8705, 0.99: 3.9999},
    "paretonormal": {0.01: -1.0780, 0.1: -0.7847, 0.5: -0.2402, 0.75: 0.2554, 0.9: 0.9729},
}
laws = st.one_of(
    st.builds(
        lambda shape, latency, jitter: link(
            distribution=shape, latency_ms=latency, jitter_ms=jitter
        ),
        st.sampled_from(NAMED),
        st.floats(0, LONGEST_DELAY_MS),
        st.floats(0, LONGEST_DELAY_MS),
    ),
    st.builds(
        lambda sample, latency: link(distribution="table", delays_ms=sample, latency_ms=latency),
        st.lists(
            st.one_of(st.floats(0, LONGEST_DELAY_MS), st.sampled_from([1.0, 2.0])), min_size=1
        ),
        st.floats(0, 1e3),
    ),
).map(DelayLaw.of)


@pytest.mark.parametrize("shape", QUANTILES)
def test_shapes_have_the_quantiles_of_netem(shape: str) -> None:
    law = DelayLaw.of(link(latency_ms=1000.0, jitter_ms=100.0, distribution=shape))
    for probability, jitters in QUANTILES[shape].items():
        found = float(law.quantile_ms(probability))
        assert found == pytest.approx(1000 + 100 * jitters, abs=1.0)


@pytest.mark.skipif(not TABLES.exists(), reason="no tables of iproute2 on this machine")
@pytest.mark.parametrize("shape", QUANTILES)
def test_shapes_lie_on_the_tables_of_the_machine(shape: str) -> None:
    text = (TABLES / f"{shape}.dist").read_text()
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    table = np.sort([int(word) for line in lines for word in line.split()]) / 8192
    u = (np.arange(len(table)) + 0.5) / len(table)
    law = DelayLaw.of(link(latency_ms=1000.0, jitter_ms=100.0, distribution=shape))
    jitters = (law.quantile_ms(u) - 1000) / 100
    inner = slice(len(u) // 100, -len(u) // 100)
    assert np.abs(jitters - table)[inner].max() < 0.025
    assert abs(jitters.mean() - table.mean()) < 0.003
    assert abs(jitters.std() - table.std()) < 0.003


def test_without_a_name_the_shape_is_normal() -> None:
    law = DelayLaw.of(link(latency_ms=50.0, jitter_ms=10.0))
    assert float(law.quantile_ms(0.84134474606854)) == pytest.approx(60.0, abs=1e-9)


def test_a_sample_is_straight_between_its_order_statistics() -> None:
    sample = [3.0, 1.0, 2.0, 2.0, 9.0]
    law = DelayLaw.of(link(distribution="table", delays_ms=sample, latency_ms=10.0))
    u = np.linspace(0, 1, 41)
    np.testing.assert_allclose(law.quantile_ms(u), 10 + np.quantile(sample, u))
    at = np.array([10.9, 11.0, 11.5, 11.999, 12.0, 12.5, 16.0, 19.0, 20.0])
    np.testing.assert_allclose(law.cdf(at), [0, 0, 0.125, 0.24975, 0.5, 0.625, 0.875, 1, 1])


@given(laws, st.lists(st.floats(0, 1), min_size=1, max_size=50))
def test_quantiles_rise_and_the_distribution_undoes_them(law: DelayLaw, u: list[float]) -> None:
    at = np.sort(u)
    delays = law.quantile_ms(at)
    assert law.quantile_ms(at[:, None]).shape == law.cdf(at[:, None]).shape == (len(at), 1)
    assert np.isfinite(delays).all()
    assert (delays >= 0).all()
    assert (np.diff(delays) >= 0).all()
    # F(Q(u)) >= u, and F just below Q(u) is not above u; Q is known to so many digits.
    slack = 1e-9 * (law.latency_ms + law.jitter_ms) + 1e-6 * delays + 1e-9
    assert (law.cdf(delays + slack) >= at - 1e-9).all()
    assert (law.cdf(delays - slack) <= at + 1e-9).all()
    np.testing.assert_array_equal(law.cdf([-np.inf, -1.0, 1e11, np.inf]), [0, 0, 1, 1])


def test_no_delay_is_below_0() -> None:
    law = DelayLaw.of(link(latency_ms=1.0, jitter_ms=1.0))
    assert float(law.quantile_ms(0.0)) == 0
    assert float(law.cdf(0.0)) == pytest.approx(0.1586552539)
    assert float(law.cdf(-1e-9)) == 0
