"""Writes reference/*.csv: reference values of 60 digits, by mpmath, of nothing of the package.

    .venv/bin/python tests/golden/make_reference.py

Each comes from a definition, in another way than the package has it: chances of sums of exponential
powers as finite sums of their laws, thresholds as roots of those, places on the ellipsoid from its
equation, levels from the pages of the standards. Cells have 20 digits.
"""

from __future__ import annotations

import csv
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from detection_values import energies, fluctuations, looks, sums, thresholds, unequal
from effect_values import effects
from mpmath import mp
from place_values import bistatic, inverse, local

mp.dps = 60
HERE = Path(__file__).parent / "reference"
Row = dict[str, Any]
F = mp.mpf


def logistic() -> Iterator[Row]:
    """The logistic law by how far a level lies over the sensitivity."""
    for margin in ("-700", "-40", "-3", "-1e-6", "0", "0.5", "12", "600"):
        odds = mp.exp(F(margin))
        pd = odds / (1 + odds)
        yield {"snr_minus_sens_db": margin, "pd": pd, "one_minus_pd": 1 - pd}


def radar() -> Iterator[Row]:
    """Echo by the spreading of power over two spheres, over the noise in 1/T."""
    c, k, t0 = F(299_792_458), F("1.380649e-23"), F(290)
    names = "p_av_w gt_dbi gr_dbi rcs_m2 freq_hz t_int_s r_tx_m r_rx_m loss_db noise_fig_db"
    for case in (
        ("500", "20", "35.4", "0.01", "10e9", "0.06", "7000", "7000", "4", "5"),
        ("2000", "11.6", "11.6", "0.01", "15e9", "0.06", "3850", "3850", "2", "5"),
        ("3", "30", "31", "0.002", "24.15e9", "0.0125", "812.5", "812.5", "6.5", "7.25"),
        ("1e4", "0", "17", "1.5", "98e6", "1", "41000", "12345", "0", "3"),
        ("0.25", "14", "12", "30", "77e9", "0.001", "15", "20", "1", "12"),
    ):
        p, gt, gr, rcs, freq, t, r_tx, r_rx, loss, noise = map(F, case)
        density = p * 10 ** (gt / 10) / (4 * mp.pi * r_tx**2)
        aperture = 10 ** (gr / 10) * (c / freq) ** 2 / (4 * mp.pi)
        echo = density * rcs / (4 * mp.pi * r_rx**2) * aperture / 10 ** (loss / 10)
        snr = echo * t / (k * t0 * 10 ** (noise / 10))
        yield dict(zip(names.split(), case, strict=True)) | {"snr": snr}


def passive() -> Iterator[Row]:
    """A broadcast at 600 MHz off 0.01 m2: its echo against itself and radio noise, correlated."""
    wavelength = F(299_792_458) / F("600e6")
    names = (
        "erp_w gr_dbi t_int_s bandwidth_hz loss_db fa_db sidelobe_db cancel_db "
        "baseline_m r_rx_m r_tx_m"
    )
    for case in (
        ("10e3", "2", "0.3", "7.61e6", "4", "-4.45", "-22", "-60", "20000", "3100", "20238.8"),
        ("50e3", "12", "0.5", "7.61e6", "3", "10", "-25", "-90", "35000", "6000", "30000"),
        ("1e3", "6", "1", "1.5e6", "5", "0", "-15", "-70", "8000", "900", "8100"),
    ):
        erp, gain, t, band, loss, fa, lobe, cancelled, base, r_rx, r_tx = map(F, case)
        radiated = erp * 10 ** ((F("2.15") + gain) / 10)
        per_area = wavelength**2 / (4 * mp.pi)
        target = radiated / (4 * mp.pi * r_tx**2) * F("0.01") / (4 * mp.pi * r_rx**2)
        target *= per_area / 10 ** (loss / 10)
        direct = radiated / (4 * mp.pi * base**2) * per_area * 10 ** ((lobe + cancelled) / 10)
        factor = 10 ** (fa / 10) - 1 + 10 ** F("0.5")
        noise = F("1.380649e-23") * 290 * band * factor
        yield dict(zip(names.split(), case, strict=True)) | {
            "p_target_w": target,
            "p_direct_w": direct,
            "p_noise_w": noise,
            "snr": band * t * target / (target + direct + noise),
        }


def absorption_db_per_m(freq: Any, temp_c: Any, humidity: Any, pressure_kpa: Any) -> Any:
    """ISO 9613-1, equations 3 to 5 and annex B."""
    kelvin, at = F(temp_c) + F("273.15"), F(pressure_kpa) / F("101.325")
    saturation = 10 ** (F("-6.8346") * (F("273.16") / kelvin) ** F("1.261") + F("4.6151"))
    water = F(humidity) * saturation / at
    warm = kelvin / F("293.15")
    oxygen = at * (24 + F("4.04e4") * water * (F("0.02") + water) / (F("0.391") + water))
    nitrogen = warm ** F("-0.5") * at
    nitrogen *= 9 + 280 * water * mp.exp(F("-4.170") * (warm ** (F(-1) / 3) - 1))
    f = F(freq)
    relaxed = F("0.01275") * mp.exp(F("-2239.1") / kelvin) / (oxygen + f**2 / oxygen)
    relaxed += F("0.1068") * mp.exp(F("-3352.0") / kelvin) / (nitrogen + f**2 / nitrogen)
    classic = F("1.84e-11") / at * mp.sqrt(warm)
    return F("8.686") * f**2 * (classic + warm ** F("-2.5") * relaxed)


def absorption() -> Iterator[Row]:
    """Cold and hot, dry and wet, high and low."""
    names = ("temp_c", "rh_pct", "pressure_kpa", "freq_hz")
    values = ((-15, 10, 20, 40), (15, 70, 100), (85, "101.325"), (63, 1000, 8000))
    for *air, freq in itertools.product(*values):
        told = dict(zip(names, (*air, freq), strict=True))
        yield told | {"alpha_db_per_m": absorption_db_per_m(freq, *air)}


def levels() -> Iterator[Row]:
    """ISO 9613-2, equations 7, 8 and 10; a barrier and the rest take 3 dB each."""
    cases = ((80, 0, 12, 25), (80, 0, 60, 700), (93, 3, 2, 400), (81, 3, 120, 90))
    for lw, dc, source, ground in cases:
        receiver = F("1.5")
        slant = mp.hypot(ground, source - receiver)
        spread = 20 * mp.log10(slant) + 11
        air = absorption_db_per_m(1000, 15, 70, "101.325") * slant
        earth = max(F(0), F("4.8") - (source + receiver) / slant * (17 + 300 / slant))
        yield {
            "lw_db": lw,
            "dc_db": dc,
            "h_source_m": source,
            "h_receiver_m": "1.5",
            "slant_m": slant,
            "a_div_db": spread,
            "a_atm_db_15C_70pct_1kHz": air,
            "a_gr_db": earth,
            "level_db_with_abar3_amisc3": lw + dc - spread - air - earth - 6,
        }


TABLES: dict[str, Callable[[], Iterator[Row]]] = {
    "bistatic": bistatic,
    "effects": effects,
    "fluctuating_rms_given_detection": fluctuations,
    "geodesy_inverse": inverse,
    "geodesy_local": local,
    "iso9613_1_alpha": absorption,
    "iso9613_2_level": levels,
    "logistic": logistic,
    "nci_cacfar_pd_sw2": sums,
    "nci_pd_sw2": energies,
    "nci_pd_unequal_snr": unequal,
    "nci_threshold": thresholds,
    "passive_snr": passive,
    "pd_cacfar_sw1": looks,
    "radar_equation": radar,
}


def cell(value: Any) -> str:
    """Twenty digits of what was worked out; what was given, as it was given."""
    if isinstance(value, str | int):
        return str(value)
    if isinstance(value, float):
        return repr(value)
    return str(mp.nstr(value, 20, min_fixed=-5, max_fixed=9))


def write(folder: Path) -> None:
    """All tables."""
    for name, rows in TABLES.items():
        made = [{key: cell(value) for key, value in row.items()} for row in rows()]
        with (folder / f"{name}.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, list(made[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(made)


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
