"""Makes reports.json: what libasterix sends for reports in 015, 016, 025, 062, 063 and 205.

Run it as make_vectors.py says. Each case has what our encoders are given, and beside it the
integers that must come of it, by hand: libasterix only puts them in their places.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from asterix.generated import (
    Cat_015_1_2,
    Cat_016_1_0,
    Cat_025_1_6,
    Cat_062_1_21,
    Cat_063_1_7,
    Cat_205_1_0,
)

VECTORS = Path(__file__).with_name("reports.json")
SOURCE = (("SAC", 25), ("SIC", 3))
MIDNIGHT_NS = 1_700_006_400 * 10**9
# The last that rounds to the day before, and the first that rounds to midnight.
LAST_NS, NEXT_NS = MIDNIGHT_NS - 3_906_251, MIDNIGHT_NS - 3_906_250
LAST = 11_059_199


def twos(value: int, bits: int) -> int:
    """A number in two's complement."""
    return value & (1 << bits) - 1


def block_hex(category: Any, *records: dict[str, Any]) -> str:
    """A data block of libasterix."""
    made = [category.cv_record.create(record) for record in records]
    block: str = category.create(made).unparse().to_bytes().hex()
    return block


# Category 015: columns of a plot, and the integers of its items.
MONOSTATIC: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("2-D", {}, {}),
    (
        "3-D with everything",
        {
            "sigma_range_m": 0.26,
            "sigma_azimuth_deg": 0.5,
            "elevation_deg": 12.5,
            "sigma_elevation_deg": 1.0,
            "snr": 100.0,
            "amplitude_dbm": -101.6,
        },
        {"SDR": 3, "SDASZ": 729, "EL": 4551, "SDEL": 1457, "RPS": 20, "RPP": -102},
    ),
    (
        "errors far below an LSB are those of rounding, rounded up",
        {
            "sigma_range_m": 1e-3,
            "sigma_azimuth_deg": 0.0,
            "elevation_deg": 12.5,
            "sigma_elevation_deg": 1e-9,
        },
        {"SDR": 1, "SDASZ": 3, "EL": 4551, "SDEL": 2},
    ),
    ("below the horizon", {"elevation_deg": -1.0}, {"EL": -364}),
    ("straight down", {"elevation_deg": -90.0}, {"EL": -32768}),
    ("straight up saturates", {"elevation_deg": 90.0}, {"EL": 32767}),
    ("a range saturates", {"range_m": 838_861.0}, {"R": 8_388_607}),
    ("a tie of range goes to even", {"range_m": 1000.25}, {"R": 10_002}),
    ("a circle wraps", {"azimuth_deg": 360.0}, {"AZ": 0}),
    ("rounding wraps", {"azimuth_deg": 359.999}, {"AZ": 0}),
    ("west of north", {"azimuth_deg": -90.0}, {"AZ": 49_152}),
    ("deviations saturate", {"sigma_range_m": 2e6, "sigma_azimuth_deg": 45.0},
     {"SDR": 16_777_215, "SDASZ": 65_535}),
    ("last time of day", {"t_utc_ns": LAST_NS}, {"TOA": LAST}),
    ("rounding reaches midnight", {"t_utc_ns": NEXT_NS}, {"TOA": 0}),
    ("SNR saturates", {"snr": 1e20}, {"RPS": 127}),
    ("SNR below 1", {"snr": 0.5}, {"RPS": -3}),
    ("amplitude saturates below", {"amplitude_dbm": -300.0}, {"RPP": -256}),
    ("amplitude saturates above", {"amplitude_dbm": 300.0}, {"RPP": 255}),
    ("of a class", {"kind": "multirotor"}, {"CLS": 300}),
]  # fmt: skip
MULTISTATIC: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("passive", {"sigma_bistatic_range_m": 12.34}, {"SDR": 124}),
    ("a negative difference", {"bistatic_range_m": -12.3}, {"R": -123}),
    ("saturates below", {"bistatic_range_m": -1e6}, {"R": -8_388_608}),
]
BEARINGS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("microphones", {"elevation_deg": 30.0}, {"EL": 10_923}),
    ("in a plane", {}, {}),
]


def plot_hex(momu: int, sent: dict[str, int]) -> str:
    """A data block of one plot."""
    items: dict[str, Any] = {
        "010": SOURCE,
        "000": (1, 0),
        "020": ((momu, 3, 3, 0, None),),
        "145": sent["TOA"],
        "300": [(sent["CLS"], 100)] if "CLS" in sent else None,
        "400": (("PID", 2), ("ON", 41)) if momu == 1 else None,
        "625": subfields(sent, R=24, SDR=24),
        "627": subfields(sent, AZ=16, SDASZ=16),
        "628": subfields(sent, EL=16, SDEL=16),
        "630": {
            name: (0, twos(sent[name], 9)) if name == "RPP" else twos(sent[name], 8)
            for name in ("RPP", "RPS")
            if name in sent
        },
    }
    present = {name: item for name, item in items.items() if item not in (None, {})}
    return block_hex(Cat_015_1_2, present)


def subfields(sent: dict[str, int], **bits: int) -> dict[str, int]:
    """Those that are sent."""
    return {name: twos(sent[name], size) for name, size in bits.items() if name in sent}


# Category 205: columns of a plot, time of sending, and the integers of its items.
DIRECTIONS: list[tuple[str, dict[str, Any], int, dict[str, Any]]] = [
    ("bearing alone", {}, MIDNIGHT_NS, {}),
    (
        "everything",
        {"amplitude_dbm": -80.0, "snr": 100.0, "elevation_deg": 5.004},
        MIDNIGHT_NS + 10**9,
        {"TOD": 128, "LEVEL": 2699, "QUALITY": 128, "ELEVATION": 500},
    ),
    ("a circle wraps", {"azimuth_deg": 360.0}, MIDNIGHT_NS, {"BEARING": 0}),
    ("rounding wraps", {"azimuth_deg": 359.996}, MIDNIGHT_NS, {"BEARING": 0}),
    ("last bearing", {"azimuth_deg": 359.99}, MIDNIGHT_NS, {"BEARING": 35_999}),
    ("west of north", {"azimuth_deg": -90.0}, MIDNIGHT_NS, {"BEARING": 27_000}),
    ("level saturates", {"amplitude_dbm": -1000.0}, MIDNIGHT_NS, {"LEVEL": -32_768}),
    ("quality saturates", {"snr": 1e9}, MIDNIGHT_NS, {"QUALITY": 255}),
    ("no quality below 0 dB", {"snr": 0.1}, MIDNIGHT_NS, {"QUALITY": 0}),
    ("below the horizon", {"elevation_deg": -0.01}, MIDNIGHT_NS, {"ELEVATION": -1}),
    ("last time of day", {}, LAST_NS, {"TOD": LAST}),
    ("rounding reaches midnight", {}, NEXT_NS, {"TOD": 0}),
]


def direction_hex(sent: dict[str, int]) -> str:
    """A data block of one bearing from 40.45 N, 3.73 W."""
    items: dict[str, Any] = {
        "010": SOURCE,
        "000": 5,
        "030": sent["TOD"],
        "040": 255,
        "050": (("LAT", 7_540_427), ("LON", twos(-695_322, 32))),
        "070": sent["BEARING"],
    }
    names = {"180": ("LEVEL", 16), "190": ("QUALITY", 8), "200": ("ELEVATION", 16)}
    items |= {item: twos(sent[n], bits) for item, (n, bits) in names.items() if n in sent}
    return block_hex(Cat_205_1_0, items)


# Category 062: columns of a track, and the integers of its items.
TRACKS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("2-D", {}, {}),
    (
        "everything",
        {
            "height_m": 762.0,
            "climb_m_s": -3.175,
            "age_s": 1.5,
            "sigma_east_m": 2.5,
            "sigma_north_m": 40_000.0,
        },
        {"ALTITUDE": 400, "RATE": -100, "AGE": 6, "SDX": 6, "SDY": 65_535},
    ),
    (
        "errors below an LSB",
        {"sigma_east_m": 0.0, "sigma_north_m": 0.49},
        {"SDX": 1, "SDY": 2},
    ),
    ("begins, tentative", {"first": True, "tentative": True}, {"TSB": 1, "CNF": 1}),
    ("ends, coasted", {"last": True, "coasted": True}, {"TSE": 1, "CST": 1}),
    ("an age saturates", {"age_s": 100.0}, {"AGE": 255}),
    ("below the ellipsoid", {"height_m": -10.0}, {"ALTITUDE": -5}),
    ("the south-west", {"latitude_deg": -33.0, "longitude_deg": -70.5, "east_m": -1.0,
                        "north_m": -0.75}, {"LAT": -6_151_646, "LON": -13_142_153, "X": -2,
                                            "Y": -2}),
    ("velocities saturate", {"velocity_east_m_s": 1e4, "velocity_north_m_s": -1e4},
     {"VX": 32_767, "VY": -32_768}),
    ("rounding reaches midnight", {"t_utc_ns": NEXT_NS}, {"TOD": 0}),
]  # fmt: skip


def track_hex(sent: dict[str, int]) -> str:
    """A data block of one track."""
    high = "ALTITUDE" in sent
    cst = sent.get("CST", 0)
    items: dict[str, Any] = {
        "010": SOURCE,
        "070": sent["TOD"],
        "105": (("LAT", twos(sent["LAT"], 32)), ("LON", twos(sent["LON"], 32))),
        "100": (("X", twos(sent["X"], 24)), ("Y", twos(sent["Y"], 24))),
        "185": (("VX", twos(sent["VX"], 16)), ("VY", twos(sent["VY"], 16))),
        "040": 4711,
        "080": (
            (1, 0, 1, 2 if high else 0, sent.get("CNF", 0), None),
            (1, sent.get("TSE", 0), sent.get("TSB", 0), 0, 0, 0, 0, None),
            (0, 0, 0, 0, 0, None),
            (cst, cst, 0, 0, 0, 0, 0, None),
        ),
        "130": twos(sent["ALTITUDE"], 16) if high else None,
        "220": twos(sent["RATE"], 16) if "RATE" in sent else None,
        "290": {"PSR": sent["AGE"]} if "AGE" in sent else None,
        "500": {"APC": (("X", sent["SDX"]), ("Y", sent["SDY"]))} if "SDX" in sent else None,
    }
    return block_hex(Cat_062_1_21, {n: item for n, item in items.items() if item is not None})


TRANSMITTERS = [
    {"identity": 10, "latitude_deg": 40.0, "longitude_deg": -3.0, "height_m": 700.1},
    {"identity": 11, "latitude_deg": -40.0, "longitude_deg": 180.0, "height_m": -9000.0},
]
RECEIVER = {"identity": 20, "latitude_deg": 0.0, "longitude_deg": -180.0, "height_m": 0.0}
PAIRS = [(1, 10, 20), (2, 11, 20)]


def system_hexes() -> list[str]:
    """The two messages of a passive radar of two transmitters."""
    common = {"010": SOURCE, "140": 128}
    system = {
        "000": 1,
        "200": 10,
        "300": PAIRS,
        "400": (("LAT", 0), ("LON", 1 << 31)),
        "405": twos(-208, 16),
    }
    south, half_turn, north, west = -477_218_588, 1 << 31, 477_218_588, -35_791_394
    components = {
        "000": 2,
        "410": [
            (10, north, twos(west, 32), 2800, 0, 0, 0, 0),
            (11, twos(south, 32), half_turn, twos(-32_768, 16), 0, 0, 0, 0),
        ],
        "420": [(20, 0, half_turn, 0)],
    }
    return [block_hex(Cat_016_1_0, common | items) for items in (system, components)]


def status_hex() -> str:
    """A data block of one status."""
    items = {
        "010": SOURCE,
        "000": (1, 0),
        "070": 128,
        "100": ((0, 0, 0, None), (0, 0, 0, None)),
        "600": (("LAT", 965_174_595), ("LON", twos(-44_500_633, 32))),
        "610": 2400,
    }
    return block_hex(Cat_025_1_6, items)


def tracker_hex() -> str:
    """A data block of a sensor that works."""
    items = {"010": SOURCE, "030": 128, "050": SOURCE, "060": ((0, 0, 0, 0, 0, 0, None),)}
    return block_hex(Cat_063_1_7, items)


def plots() -> list[dict[str, Any]]:
    """The cases of category 015."""
    plot = {"t_utc_ns": MIDNIGHT_NS, "azimuth_deg": 90.0}
    sent = {"TOA": 0, "AZ": 16_384}
    ranges = (
        (MONOSTATIC, {"range_m": 1000.0}, {"R": 10_000}),
        (MULTISTATIC, {"bistatic_range_m": 1000.0, "range_m": 600.0, "channel": 2}, {"R": 10_000}),
        (BEARINGS, {}, {}),
    )
    return [
        {
            "case": case,
            "geometry": geometry,
            "plot": plot | range_m | columns,
            "block": plot_hex(geometry, sent | range_sent | integers),
        }
        for geometry, (cases, range_m, range_sent) in enumerate(ranges)
        for case, columns, integers in cases
    ]


def main() -> None:
    """Writes the vectors."""
    track = {
        "t_utc_ns": MIDNIGHT_NS,
        "track": 4711,
        "latitude_deg": 40.0,
        "longitude_deg": 3.0,
        "east_m": 100.0,
        "north_m": 200.0,
        "velocity_east_m_s": 10.0,
        "velocity_north_m_s": -10.0,
    }
    track_sent = {"TOD": 0, "LAT": 7_456_540, "LON": 559_241, "X": 200, "Y": 400}
    track_sent |= {"VX": 40, "VY": -40}
    vectors = {
        "plots": plots(),
        "bearings": [
            {
                "case": case,
                "plot": {"azimuth_deg": 90.0} | columns,
                "sent_utc_ns": t,
                "block": direction_hex({"TOD": 0, "BEARING": 9000} | sent),
            }
            for case, columns, t, sent in DIRECTIONS
        ],
        "tracks": [
            {"case": case, "track": track | columns, "block": track_hex(track_sent | sent)}
            for case, columns, sent in TRACKS
        ],
        "system": {
            "transmitters": TRANSMITTERS,
            "receiver": RECEIVER,
            "pairs": PAIRS,
            "blocks": system_hexes(),
        },
        "status": status_hex(),
        "tracker": tracker_hex(),
    }
    VECTORS.write_text(json.dumps(vectors, indent=1) + "\n")


if __name__ == "__main__":
    main()
