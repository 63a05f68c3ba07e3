"""Prints the figures of docs/equations.md.

python docs/commands/equation_figures.py
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import exp1, gammaincc, gammainccinv, gammaincinv
from section_4 import scene_with

from plotfeed.feeds.scene.scene import example
from plotfeed.models import detection, propagation
from plotfeed.models.accuracy import paired_snr, sigma_rate_m_s
from plotfeed.models.frames import aer_to_enu
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.bistatic_places import flat_solution
from plotfeed.models.sensors.sensor_model import Targets
from plotfeed.models.state import Signatures

PFA, N = 1e-6, 16
LEVELS_DB = (10, 20, 30, 40)


def multiplier(pfa: float, n: float) -> float:
    """Eq 6."""
    return float(np.expm1(-np.log(pfa) / n))


def snr_for(pd: float, pfa: float, n: int) -> float:
    """The ratio at which eq 7 gives that Pd."""
    root = pd ** (1 / n)
    return float(multiplier(pfa, n) * root / (1 - root) - 1)


def rms_over_printed(snr: float) -> float:
    """Rms error over detections, beside the printed form with the mean ratio in it."""
    alpha = multiplier(PFA, N)
    shares = (np.arange(20_000) + 0.5) / 20_000
    y = alpha * gammaincinv(N, shares) / (1 + snr + alpha)
    return float(np.sqrt(snr * np.mean(np.exp(y) * exp1(y)) / (1 + snr)))


def models() -> dict[str, Any]:
    """Models of the sensors of section-4, by their ids."""
    scene = example("section-4")
    return {sensor.id: sensor.model(scene.scene.site) for sensor in scene.sensor}


def approaching(range_m: float, sound_power_db: float = 80.0) -> Targets:
    """The drone of section-4 at a slant range: to the north-east, 50 m up."""
    ground_m = sqrt(max(range_m**2 - 50.0**2, 1.0))
    enu_m = np.array([[ground_m * sqrt(0.5), ground_m * sqrt(0.5), 50.0]])
    zero = np.zeros(1, np.int64)
    return Targets(
        drone=zero,
        t_utc_ns=zero,
        position_enu_m=enu_m,
        true_position_enu_m=enu_m,
        signatures=Signatures(
            rcs_m2=np.array([0.01]), sound_power_db=np.array([sound_power_db]), emitters=[()]
        ),
    )


def reach_m(model: Any, pd: float = 0.8, sound_power_db: float = 80.0) -> float:
    """The slant range at which the drone is detected with that probability."""

    def surplus(range_m: float) -> float:
        return float(model.predict(approaching(range_m, sound_power_db)).pd[0]) - pd

    return float(brentq(surplus, 52.0, 30_000.0, xtol=0.01))


def main() -> None:
    """One figure a line."""
    active()
    mimo()
    passive()
    microphones()
    beyond()


def active() -> None:
    """Equations 1 to 15."""
    (radar,) = scene_with("active")["sensor"]
    known_noise = np.log(PFA) / np.log(0.5) - 1  # Pd = Pfa^(1/(1+S)), noise known
    loss_db = 10 * np.log10(snr_for(0.5, PFA, N) / known_noise)
    print(f"eqs 6, 7: CFAR loss at Pd 0.5, Pfa {PFA:g}, N {N}: {loss_db:.2f} dB")
    rounded = abs((1e-6 ** (-1 / 1e12) - 1) / multiplier(1e-6, 1e12) - 1)
    print(f"eq 6 as printed in float64, Pfa 1e-6, N 1e12: relative error {rounded:.0e}")
    beams = round(360 / radar["azimuth_beamwidth_deg"])
    print(f"eqs 4, 9: {beams} azimuth cells, not {radar['receive_beams']}: "
          f"{beams / radar['receive_beams']:.3g} times the false alarms")  # fmt: skip
    near = models()["active"].predict(approaching(1000.0))
    print(f"eqs 13 to 15: at 1 km rms {near.sigma_range_m[0]:.3f} m, "
          f"{near.sigma_azimuth_deg[0]:.4f} degrees without floors")  # fmt: skip
    rng = np.random.default_rng(1)
    for range_max_m in (1000, 10_000):
        range_m, height_m = rng.uniform(0, range_max_m, 10**6), rng.uniform(20, 120, 10**6)
        print(f"eqs 10, 12: height above range for {np.mean(height_m > range_m):.2%} of the alarms "
              f"within {range_max_m / 1000:g} km")  # fmt: skip
    print(f"eqs 14, 15: printed over ours: {1.6 * 2**0.5 / 2:.3f}")
    ratios = ", ".join(f"{rms_over_printed(10 ** (x / 10)):.2f}" for x in LEVELS_DB)
    print(f"eqs 13 to 15: rms of all detections over the printed form, at a mean of {LEVELS_DB} "
          f"dB: {ratios}")  # fmt: skip


def mimo() -> None:
    """Equations 16 to 23."""
    radar = models()["mimo"]
    gain_dbi = float(propagation.beam_gain_dbi(3.0, 30.0))
    by_eq_20_m = reach_m(replace(radar, gain_rx_dbi=gain_dbi, range_max_m=1e5))
    print(f"eq 20: {gain_dbi:.1f} dBi in place of 11.6 at the receiver: Pd 0.8 to "
          f"{by_eq_20_m / 1000:.2f} km, not {reach_m(radar) / 1000:.2f}")  # fmt: skip
    print(f"eq 4: {120 / 32:g} times the false alarms of 32 beams")
    for spread_db in (4, 10, 20):
        print(f"eq 18: one transmitter {spread_db} dB above the others: Pd of the mean up to "
              f"{too_high(spread_db):.3f} too high")  # fmt: skip
    for range_m in (200.0, 1000.0):
        snrs = radar.signal_snrs(approaching(range_m).position_enu_m, np.array([0.01]))[0]
        print(f"eq 18: at {range_m:g} m the three echoes differ by "
              f"{10 * np.log10(snrs.max() / snrs.min()):.2f} dB")  # fmt: skip
    threshold = float(gammainccinv(3, PFA))
    print(f"eq 22: arguments in the other order: Pfa {gammaincc(threshold, 3):.10f}; "
          f"inverse of 1 - 1e-17: {gammaincinv(3, 1 - 1e-17):g}")  # fmt: skip
    snr = 10.0
    ours = float(detection.pd_noncoherent_swerling2(snr, PFA, 3))
    rng = np.random.default_rng(1)
    power = rng.standard_exponential((2_000_000, 3)).sum(axis=1) * (1 + snr)
    print(f"eq 23: S 10 dB, 3 looks: printed {gammaincc(3, threshold / (1 + snr / 2)):.4f}, "
          f"ours {ours:.4f}, drawn {np.mean(power > threshold):.4f}; "
          f"range times {2**-0.25:.3f}")  # fmt: skip
    for pfa, n in ((1e-4, 30), (1e-6, 30), (1e-6, 48)):
        print(f"eq 23: CFAR loss of 3 looks, {n} samples in all, Pfa {pfa:g}, Pd 0.8: "
              f"{cfar_loss_db(pfa, n):.2f} dB")  # fmt: skip


def too_high(spread_db: float) -> float:
    """The most by which the Pd of the mean ratio exceeds the true one."""
    others_db = np.linspace(-10, 40, 501)
    snrs = 10 ** (np.stack([others_db, others_db, others_db + spread_db], axis=-1) / 10)
    means = np.repeat(snrs.mean(axis=-1, keepdims=True), 3, axis=-1)
    by_mean = detection.pd_noncoherent_unequal_cfar(means, PFA, 48)
    return float(np.max(by_mean - detection.pd_noncoherent_unequal_cfar(snrs, PFA, 48)))


def cfar_loss_db(pfa: float, n_reference: int) -> float:
    """What an unknown noise power costs three looks of equal strength at Pd 0.8."""

    def needed(pd: Callable[[float], float]) -> float:
        return float(brentq(lambda snr: pd(snr) - 0.8, 0.1, 1e4))

    known = needed(lambda snr: float(detection.pd_noncoherent_swerling2(snr, pfa, 3)))
    looks = np.ones(3)
    unknown = needed(
        lambda snr: float(detection.pd_noncoherent_unequal_cfar(snr * looks, pfa, n_reference))
    )
    return float(10 * np.log10(unknown / known))


def passive() -> None:
    """Equations 24 to 36."""
    radar = models()["passive"]
    channel = radar.transmitters[0]
    ours_km = reach_m(radar) / 1000
    time_bandwidth = radar.integration_s * channel.bandwidth_hz
    print(f"eq 25: S never above BT, {10 * np.log10(time_bandwidth):.1f} dB")
    for name, wrong in (
        ("eq 28: side lobes of +22 dB", replace(radar, sidelobe_db=22.0)),
        ("eq 31: F_a of 5 dB",
         replace(radar, transmitters=(replace(channel, external_noise_db=5.0),))),
    ):  # fmt: skip
        print(f"{name}: Pd 0.8 to {reach_m(wrong) / 1000:.2f} km, not {ours_km:.2f}")
    print(f"eq 29: cancellation of +60 dB: Pd {pd_at(replace(radar, cancellation_db=60.0)):.2g} "
          "at 100 m")  # fmt: skip
    for noise_db in (5.0, channel.external_noise_db):
        factor = 10 ** (noise_db / 10) - 1 + 10**0.5
        print(f"eq 31: F_a {noise_db:g} dB gives a total of {10 * np.log10(factor):.2f} dB")
    print(f"eq 13, passive: c/B is {C_M_S / channel.bandwidth_hz:.1f} m, c/2B "
          f"{C_M_S / channel.bandwidth_hz / 2:.1f} m")  # fmt: skip
    share = radar.placed_shares[0]
    cells = radar.resolution_cells[0]
    print(f"eq 9, passive: at Pfa 1e-4 {cells * 1e-4:.3f} cells a scan alarm, "
          f"{cells * share * 1e-4:.3f} plots come of them")  # fmt: skip
    for angle_deg in (90, 45, 20, 5, 1):
        excess_m, slopes = geometry(angle_deg, 3000.0)
        print(f"eqs 32 to 35: {angle_deg} degrees from the transmitter, 3 km away: bistatic range "
              f"{excess_m:.1f} m, a metre of it is {slopes:.3g} m of range")  # fmt: skip
    excess_m = geometry(90, 3000.0)[0]
    by_print = propagation.range_from_bistatic(excess_m, 20_000.0, 45.0)[0]
    print(f"eqs 34, 35: transmitter taken as due east, it is 90 degrees from the drone: "
          f"{float(by_print) / 1000:.2f} km, not 3.00")  # fmt: skip
    for angle_deg in (90, 45, 10):
        print(f"eq 36: drone 100 m up at 500 m on the ground, {angle_deg} degrees: flat solution "
              f"{flat_bias_m(angle_deg):+.0f} m")  # fmt: skip


def pd_at(model: Any, range_m: float = 100.0) -> float:
    """Pd of the drone at that slant range."""
    return float(model.predict(approaching(range_m)).pd[0])


def geometry(angle_deg: float, range_m: float) -> tuple[float, float]:
    """Bistatic range of a place at that angle from a transmitter 20 km away, and dR_rx/dR."""
    transmitter, place = _at(0.0, 0.0, 20_000.0), _at(angle_deg, 0.0, range_m)
    excess_m = propagation.bistatic_range(place, transmitter)
    _, slope, _ = propagation.range_from_bistatic(excess_m, 20_000.0, angle_deg)
    return float(excess_m), float(slope)


def flat_bias_m(angle_deg: float) -> float:
    """Distance that the flat solution gives, less the distance on the ground."""
    place = np.array([*_at(angle_deg, 0.0, 500.0)[:2], 100.0])
    transmitter = _at(0.0, 0.0, 20_000.0)
    excess_m = np.asarray(propagation.bistatic_range(place, transmitter))
    return float(flat_solution(excess_m, np.asarray(angle_deg), transmitter).range_m) - 500.0


def _at(azimuth_deg: float, elevation_deg: float, range_m: float) -> NDArray[np.float64]:
    return aer_to_enu(azimuth_deg, elevation_deg, range_m)


def microphones() -> None:
    """Equations 37 to 44."""
    array = models()["microphone"]
    enu_m = approaching(100.0).position_enu_m
    level_db = float(array.level_db(np.array([80.0]), enu_m)[0])
    attenuation_db = 80.0 + array.directivity_db - level_db
    mixed_db = 80.0 - 10 * np.log10(10**0.3 * attenuation_db)
    print(f"eq 37: at 100 m {level_db:.1f} dB; with the attenuation of {attenuation_db:.1f} dB "
          f"taken for a ratio, and divided by D_C: {mixed_db:.1f} dB")  # fmt: skip
    half_m = reach_m(array, 0.5)
    print(f"eq 43: Pd 0.5 at {half_m:.0f} m, where the SNR is {array.sensitivity_db:g} dB")
    print(f"eq 40: 80 dB taken as the level at 1 m, so 91 dB of power: Pd 0.5 at "
          f"{reach_m(array, 0.5, 91.0):.0f} m; 11 dB are {10 ** (11 / 20):.2f} times the range by "
          "spreading alone")  # fmt: skip
    absorption = float(propagation.sound_absorption_db_per_m(1000.0, 20.0, 70.0, 101.325))
    print(f"eq 41: ISO 9613-1 at 1 kHz, 20 C, 70 %: {absorption * 1000:.2f} dB/km")
    lift = 4.8 - 2 * (50 + 1.5) / 2 / 60 * (17 + 300 / 60)
    print(f"eq 42: as printed at 60 m, heights 50 and 1.5 m: {lift:.1f} dB")
    print(f"eq 43: as printed, with S of nothing: 1 - Pd is {1 / (1 + np.exp(32.0)):.2g}")
    print(f"bearing of sound, 20 m/s across the line of sight: late by "
          f"{np.degrees(np.arctan(20 / array.sound_speed_m_s)):.1f} degrees")  # fmt: skip
    sigma_deg = array.sigma_azimuth_deg(np.array([10**3.2]))[0]
    print(f"eqs 14, 43: rms azimuth at the sensitivity: {sigma_deg:.3f} degrees, of which the "
          f"floor is {array.azimuth_floor_deg:g}")  # fmt: skip


def phase_errors_deg(samples: float, pfa: float) -> tuple[float, float, float]:
    """Of the weakest detection: by one channel's noise, by both of strong signals, by both."""
    snr = float(detection.threshold_noncoherent(pfa, samples)) / samples - 1
    shares = (2 * snr, snr, float(paired_snr(snr)))
    one, strong, ours = (float(np.degrees(1 / np.sqrt(share * samples))) for share in shares)
    return one, strong, ours


def beyond() -> None:
    """What scenes may name besides."""
    (radar,) = scene_with("active")["sensor"]
    print(f"bias: 0.3 degrees at 5 km: {np.radians(0.3) * 5000:.0f} m")
    ground_m = np.linspace(100.0, 20_000.0, 2_000_000)
    two_ways_db = 20 * np.log10(propagation.two_ray_factor(10.0, 100.0, ground_m, 0.03, -0.9))
    print(f"multipath: two ways at -0.9: {two_ways_db.min():.1f} to {two_ways_db.max():.1f} dB")
    wavelength_m = C_M_S / radar["frequency_hz"]
    print(f"multipath: lobes {np.degrees(wavelength_m / (2 * 5.0)):.2f} degrees apart at 5 m")
    phases_deg = phase_errors_deg(1e4, 1e-6)
    print(
        "rf: weakest detection of 1e4 samples at Pfa 1e-6, phase between two channels: "
        "{:.2f} degrees by 1/sqrt(2 S M), {:.2f} by 1/sqrt(S M), {:.2f} ours".format(*phases_deg)
    )
    cell_m_s = wavelength_m / (2 * radar["integration_s"])
    print(f"doppler: cell {cell_m_s:.2f} m/s, sigma at 13 dB "
          f"{float(sigma_rate_m_s(10**1.3, cell_m_s)):.3f} m/s")  # fmt: skip
    for rate_m_s in (0.5, 1.0, 2.0):
        print(f"doppler: notch of 1 m/s at {rate_m_s:g} m/s: {1 - np.exp(-(rate_m_s**2)):.2f}")
    for widths in (0.5, 1.0, 2.0):
        print(f"merging: {widths:g} widths apart: {2.0 ** -(widths**2):.2f}")


if __name__ == "__main__":
    main()
