"""Methods that are only compared: each does what its name says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import gammainc
from support.chart_cases import RADAR, SITE, case_of_ratios
from support.significance import assert_sum

from plotfeed.feeds.lab import methods
from plotfeed.feeds.lab.methods import FREE_SPACE, TWO_RAYS, PoissonGenerator, propagation_methods
from plotfeed.models import detection
from plotfeed.models.effects.multipath import Multipath
from plotfeed.models.frames import LocalFrame, ecef_to_geodetic
from plotfeed.models.sensors.range_gate import RangeGate
from plotfeed.models.sensors.sensor_model import Prediction, Targets

HERE = LocalFrame(*SITE)


def around(distance_m: float) -> np.ndarray:
    bearings = np.radians(np.arange(0, 360, 15))
    level = np.stack([np.sin(bearings), np.cos(bearings), np.full(24, 0.05)], axis=-1)
    return distance_m * level


def errors_m(make: object, distance_m: float) -> float:
    enu_m = around(distance_m)
    found = make(HERE)(*ecef_to_geodetic(HERE.to_ecef(enu_m)))  # type: ignore[operator]
    return float(np.abs(found - enu_m).max())


@pytest.mark.parametrize(
    ("make", "order"), [(methods.ellipsoidal_flat, 2), (methods.second_order, 3)]
)
def test_errors_grow_by_the_order_that_is_left_out(make: object, order: int) -> None:
    assert errors_m(make, 20_000) / errors_m(make, 10_000) == pytest.approx(2**order, rel=0.2)


def test_a_flat_earth_errs_in_proportion_to_distance() -> None:
    near, far = (errors_m(methods.flat_earth, d) for d in (500, 1000))
    assert far / near == pytest.approx(2, rel=0.1)
    assert 1e-4 < far / 1000 < 1e-2


def test_single_precision_loses_metres() -> None:
    enu_m = around(3000)
    found = methods.single_ecef(HERE)(HERE.to_ecef(enu_m).astype(np.float32))
    assert 0.01 < np.abs(found - enu_m).max() < 2.0


def test_pyproj_agrees_with_our_frames() -> None:
    pytest.importorskip("pyproj")
    enu_m = around(10_000)
    geodetic = ecef_to_geodetic(HERE.to_ecef(enu_m))
    assert np.abs(methods.by_pyproj(HERE)(*geodetic) - enu_m).max() < 1e-7


def test_signals_hit_as_often_as_the_closed_form_says() -> None:
    n, pfa, samples = 40_000, 1e-3, 8
    snr = np.repeat([0.0, 3.0, 10.0, 30.0], n // 4)
    rng = np.random.default_rng(5)
    hits = methods.signal_cfar(snr[:, None], pfa, samples, rng)
    pd = detection.pd_cfar_swerling1(snr, pfa, samples)
    assert_sum(float(hits.sum()), float(pd.sum()), float((pd * (1 - pd)).sum()), "one look")
    snrs = np.tile([1.0, 5.0, 20.0], (n, 1))
    hits = methods.signal_cfar(snrs, pfa, 3 * samples, rng)
    pd = detection.pd_noncoherent_unequal_cfar(snrs, pfa, 3 * samples)
    assert_sum(float(hits.sum()), float(pd.sum()), float((pd * (1 - pd)).sum()), "three looks")


def test_energies_of_signals_hit_as_often_as_the_closed_form_says() -> None:
    n, pfa, samples = 4000, 1e-2, 20
    snr = np.repeat([0.1, 0.5], n // 2)
    hits = methods.signal_energy(snr, pfa, samples, np.random.default_rng(6))
    pd = detection.pd_noncoherent_swerling2(snr, pfa, samples)
    assert_sum(float(hits.sum()), float(pd.sum()), float((pd * (1 - pd)).sum()))


def test_counting_gives_a_share_of_the_trials() -> None:
    pd = methods.counted(lambda rng: rng.random(3) < [0.0, 0.5, 1.0], 64)(np.random.default_rng(1))
    assert pd[0] == 0
    assert 0 < pd[1] < 1
    assert pd[2] == 1
    assert (pd * 64 == np.rint(pd * 64)).all()


def test_printed_sums_are_the_complement_of_the_incomplete_gamma_function() -> None:
    snrs = np.array([[5.0, 10.0, 15.0]])
    threshold = detection.threshold_noncoherent(1e-6, 3)
    expected = 1 - gammainc(3, threshold / (1 + 10 / 2))
    assert methods.printed_sum(snrs, 1e-6)[0] == pytest.approx(expected, rel=1e-12)


def test_a_table_is_exact_at_its_nodes() -> None:
    looked_up = methods.table(lambda db: detection.pd_cfar_swerling1(10 ** (db / 10), 1e-6, 16))
    exact = detection.pd_cfar_swerling1(10 ** (methods.TABLE_DB / 10), 1e-6, 16)
    np.testing.assert_array_equal(looked_up(methods.TABLE_DB), exact)


def test_poisson_numbers_stand_in_for_binomial_ones() -> None:
    ours = PoissonGenerator(np.random.Philox(3))
    plain = np.random.Generator(np.random.Philox(3))
    assert ours.binomial(1000, 0.5) == plain.poisson(500.0)


@dataclass(frozen=True, kw_only=True)
class Lamp(RangeGate):
    """A sensor of which the chart knows what it predicts, and that it may stand over a ground."""

    multipath: Multipath | None = None

    def predict(self, targets: Targets) -> Prediction:
        dimmed = 0.5 if self.multipath is None else 0.25
        level = np.full(len(targets), dimmed)
        return replace(super().predict(targets), snr=2 * level, pd=level)


def test_a_new_sensor_over_a_ground_is_compared_with_free_space() -> None:
    targets = case_of_ratios(RADAR, [1.0, 2.0]).seen_targets()
    lamp = Lamp(range_max_m=1e4, sigma_m=1.0)
    found = propagation_methods(lamp, targets, 10.0)
    assert found is not None
    assert found.ours == FREE_SPACE
    assert {name: pd().tolist() for name, pd in found.pds.items()} == {
        FREE_SPACE: [0.5, 0.5],
        TWO_RAYS: [0.25, 0.25],
    }
    assert found.ratios[TWO_RAYS]().tolist() == [0.5, 0.5]
    assert propagation_methods(RangeGate(range_max_m=1e4, sigma_m=1.0), targets, 10.0) is None
