"""Makes vectors.json: what libasterix sends for plots and service messages at every edge.

With libasterix 0.36.3, which `make .venv/.ready-test` installs, from the root of the project:

    .venv/bin/python tests/proto/asterix/vectors/make_vectors.py

Each case has what our encoders are given, and beside it the integers that must come of it, by
hand: libasterix only puts them in their places.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from asterix.generated import Cat_034_1_29, Cat_048_1_32

VECTORS = Path(__file__).with_name("vectors.json")
SAC, SIC = 25, 3
MIDNIGHT_NS = 1_700_006_400 * 10**9
PERIOD_S = 4.9453125  # 633 / 128

# Columns of a plot, and what is sent: time of day, RHO, THETA, PRL, PAM, height.
PLOT = {"t_utc_ns": MIDNIGHT_NS, "range_m": 18520.0, "azimuth_deg": 90.0}
SENT = {"TOD": 0, "RHO": 2560, "THETA": 16384}
PLOTS: list[tuple[str, dict[str, float], dict[str, int]]] = [
    ("2-D, no amplitude", {}, {}),
    (
        "3-D",
        {"run_length_deg": 1.40625, "amplitude_dbm": -72.0, "height_m": 762.0},
        {"PRL": 32, "PAM": -72, "3DH": 100},
    ),
    ("2-D with amplitude", {"run_length_deg": 0, "amplitude_dbm": 0}, {"PRL": 0, "PAM": 0}),
    ("height alone", {"height_m": 0.0}, {"3DH": 0}),
    ("amplitude alone", {"amplitude_dbm": -1.0}, {"PAM": -1}),
    ("run length alone", {"run_length_deg": 5.0}, {"PRL": 114}),
    ("range saturates", {"range_m": 474_112.0}, {"RHO": 65535}),
    ("last range", {"range_m": 474_104.0}, {"RHO": 65535}),
    ("no negative range", {"range_m": -20.0}, {"RHO": 0}),
    ("a tie of range goes down to even", {"range_m": 18.0859375}, {"RHO": 2}),
    ("a tie of range goes up to even", {"range_m": 10.8515625}, {"RHO": 2}),
    ("a circle wraps", {"azimuth_deg": 360.0}, {"THETA": 0}),
    ("rounding wraps", {"azimuth_deg": 359.999}, {"THETA": 0}),
    ("last azimuth", {"azimuth_deg": 359.995}, {"THETA": 65535}),
    ("west of north", {"azimuth_deg": -90.0}, {"THETA": 49152}),
    ("last time of day", {"t_utc_ns": MIDNIGHT_NS - 3_906_251}, {"TOD": 11_059_199}),
    ("rounding reaches midnight", {"t_utc_ns": MIDNIGHT_NS - 3_906_250}, {"TOD": 0}),
    ("a tie of time goes down to even", {"t_utc_ns": MIDNIGHT_NS + 3_906_250}, {"TOD": 0}),
    ("a tie of time goes up to even", {"t_utc_ns": MIDNIGHT_NS + 11_718_750}, {"TOD": 2}),
    ("amplitude saturates below", {"amplitude_dbm": -200.0}, {"PAM": -128}),
    ("amplitude saturates above", {"amplitude_dbm": 200.0}, {"PAM": 127}),
    ("run length saturates", {"run_length_deg": 12.0}, {"PRL": 255}),
    ("below sea level", {"height_m": -100.0}, {"3DH": -13}),
    ("a tie of height goes to even", {"height_m": -3.81}, {"3DH": 0}),
    ("height saturates above", {"height_m": 70_000.0}, {"3DH": 8191}),
    ("height saturates below", {"height_m": -70_000.0}, {"3DH": -8192}),
]

# Where the radar stands, south and west and below the ellipsoid, and what is sent of it.
PLACE = [-34.5, -58.25, -12.4]
SENT_PLACE = [("HGT", -12, 16), ("LAT", -1_607_817, 24), ("LON", -2_714_647, 24)]

# Time, sector azimuth (None: north marker), and what is sent: time of day, sector.
SERVICES: list[tuple[str, int, float | None, int, int | None]] = [
    ("north", MIDNIGHT_NS + 10**9, None, 128, None),
    ("north before midnight", MIDNIGHT_NS - 7_812_500, None, 11_059_199, None),
    ("north at midnight", MIDNIGHT_NS - 1, None, 0, None),
    ("first sector", MIDNIGHT_NS + 10**9, 11.25, 128, 8),
    ("sector at north", MIDNIGHT_NS + 10**9, 0.0, 128, 0),
    ("sector at a whole turn", MIDNIGHT_NS + 10**9, 360.0, 128, 0),
    ("last sector", MIDNIGHT_NS + 10**9, 358.59375, 128, 255),
    ("rounding wraps", MIDNIGHT_NS + 10**9, 359.5, 128, 0),
]


def twos(value: int, bits: int) -> int:
    """A number in two's complement."""
    return value & (1 << bits) - 1


def plot_hex(sent: dict[str, int]) -> str:
    """A data block of one plot."""
    items: dict[str, Any] = {
        "010": (("SAC", SAC), ("SIC", SIC)),
        "140": sent["TOD"],
        "020": ((1, 1, 0, 0, 0, None),),
        "040": (("RHO", sent["RHO"]), ("THETA", sent["THETA"])),
    }
    characteristics = {name: twos(sent[name], 8) for name in ("PRL", "PAM") if name in sent}
    if characteristics:
        items["130"] = characteristics
    if "3DH" in sent:
        items["110"] = (0, ("3DH", twos(sent["3DH"], 14)))
    return block_hex(Cat_048_1_32, items)


def service_hex(time_of_day: int, sector: int | None) -> str:
    """A data block of one service message."""
    items: dict[str, Any] = {"010": (("SAC", SAC), ("SIC", SIC)), "030": time_of_day}
    place = tuple((name, twos(value, bits)) for name, value, bits in SENT_PLACE)
    items |= {"000": 1, "041": 633, "120": place} if sector is None else {"000": 2, "020": sector}
    return block_hex(Cat_034_1_29, items)


def block_hex(category: Any, items: dict[str, Any]) -> str:
    """A data block of one record of libasterix."""
    return category.create([category.cv_record.create(items)]).unparse().to_bytes().hex()


def main() -> None:
    """Writes the vectors."""
    vectors = {
        "sac": SAC,
        "sic": SIC,
        "antenna_period_s": PERIOD_S,
        "place": PLACE,
        "plots": [
            {"case": case, "plot": PLOT | plot, "block": plot_hex(SENT | sent)}
            for case, plot, sent in PLOTS
        ],
        "services": [
            {"case": case, "t_utc_ns": t, "azimuth_deg": azimuth, "block": service_hex(tod, sector)}
            for case, t, azimuth, tod, sector in SERVICES
        ],
    }
    VECTORS.write_text(json.dumps(vectors, indent=1) + "\n")


if __name__ == "__main__":
    main()
