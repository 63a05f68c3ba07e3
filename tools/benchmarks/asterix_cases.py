"""Records that benchmarks encode: our items by path, and the same ones as libasterix has them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.encode import Encoder

SAC, SIC = 25, 3
SOURCE = (("SAC", SAC), ("SIC", SIC))
DAY = (0.0, 86_399.0)


class Case(NamedTuple):
    """A record: its items, the parts that never change, and the limits of those that do.

    Columns are in the order of the record; limits of integers make columns of integers.
    """

    paths: str
    constants: dict[str, float | str]
    columns: dict[str, tuple[float, float]]


CASES = {
    15: Case(
        "010 000 020 145 625/R 625/SDR 627/AZ 627/SDASZ 628/EL 628/SDEL 630/RPS",
        {"000/MT": 1, "000/RG": 0, "020/MOMU": 0, "020/TTAX": 3, "020/SCD": 3},
        {
            "145": DAY,
            "625/R": (0.0, 9e4),
            "625/SDR": (0.0, 9.0),
            "627/AZ": (0.0, 359.0),
            "627/SDASZ": (0.0, 9.0),
            "628/EL": (-20.0, 80.0),
            "628/SDEL": (0.0, 9.0),
            "630/RPS": (0.0, 60.0),
        },
    ),
    16: Case(
        "010 000 140 200 300*2 400 405",
        {"000": 1, "200": 10, "400/LAT": 40.0, "400/LON": -3.0, "405": 700.0}
        | {f"300/{i}/{name}": i for i in range(2) for name in ("PID", "TID", "RID")},
        {"140": DAY},
    ),
    25: Case(
        "010 000 070 100 100/SYSTAT 600 610",
        {"000/RTYP": 1, "000/RG": 0, "600/LAT": 40.0, "600/LON": -3.0, "610": 700.0},
        {
            "070": DAY,
            "100/NOGO": (0, 1),
            "100/OPS": (0, 3),
            "100/SSTAT": (0, 4),
            "100/SYSTAT": (0, 4),
            "100/SESTAT": (0, 4),
        },
    ),
    34: Case("010 000 030 020", {"000": 2}, {"030": DAY, "020": (0.0, 358.0)}),
    48: Case(
        "010 140 020 040 130/PRL 130/PAM 110",
        {"020/TYP": 1, "020/SIM": 1, "020/RDP": 0, "020/SPI": 0, "020/RAB": 0},
        {
            "140": DAY,
            "040/RHO": (0.0, 255.0),
            "040/THETA": (0.0, 359.0),
            "130/PRL": (0.0, 11.0),
            "130/PAM": (-120.0, 0.0),
            "110": (-500.0, 3e4),
        },
    ),
    62: Case(
        "010 070 105 100 185 040 080 290/PSR 130",
        {f"080/{name}": 0 for name in ("SPI", "MRH", "SRC")} | {"080/MON": 1},
        {
            "070": DAY,
            "105/LAT": (-90.0, 90.0),
            "105/LON": (-180.0, 180.0),
            "100/X": (-1e5, 1e5),
            "100/Y": (-1e5, 1e5),
            "185/VX": (-100.0, 100.0),
            "185/VY": (-100.0, 100.0),
            "040": (0, 65_535),
            "080/CNF": (0, 1),
            "290/PSR": (0.0, 9.0),
            "130": (0.0, 9e3),
        },
    ),
    63: Case(
        "010 030 050 060",
        {f"060/{name}": 0 for name in ("SSR", "MDS", "ADS", "MLT")},
        {
            "030": DAY,
            "050/SAC": (0, 255),
            "050/SIC": (0, 255),
            "060/CON": (0, 3),
            "060/PSR": (0, 1),
        },
    ),
    129: Case(
        "010 040 050 070 080 090 185 220",
        {"040": "1581F45T2201", "050": "ES"},
        {
            "070": DAY,
            "080/LAT": (-90.0, 90.0),
            "080/LON": (-180.0, 180.0),
            "090": (0.0, 500.0),
            "185/VX": (-20.0, 20.0),
            "185/VY": (-20.0, 20.0),
            "220": (-5.0, 5.0),
        },
    ),
    205: Case(
        "010 000 030 040 090 050 070 180 190 200",
        {"000": 5, "090": "2437.00", "050/LAT": 40.0, "050/LON": -3.0},
        {
            "030": DAY,
            "040": (0, 255),
            "070": (0.0, 359.0),
            "180": (-20.0, 100.0),
            "190": (0, 255),
            "200": (-20.0, 80.0),
        },
    ),
}


def encoded(number: int, records: int) -> tuple[Encoder, dict[str, NDArray[Any]]]:
    """What encodes a category's case, and as many records by column."""
    case, name = CASES[number], f"I{number:03}/"
    constants = {"010/SAC": SAC, "010/SIC": SIC} | case.constants
    encoder = Encoder(
        CATEGORIES[number],
        [name + path for path in case.paths.split()],
        constants={name + path: value for path, value in constants.items()},
    )
    rng = np.random.default_rng(1)
    columns = {
        name + path: rng.integers(low, high, records, endpoint=True)
        if isinstance(low, int)
        else rng.uniform(low, high, records)
        for path, (low, high) in case.columns.items()
    }
    assert tuple(sorted(columns)) == tuple(sorted(encoder.columns)), encoder.columns
    return encoder, columns


def theirs(category: int, v: list[Any]) -> dict[str, Any]:  # noqa: PLR0911 - one for each
    """The items of one record for libasterix, without the source."""
    match category:
        case 15:
            return {
                "000": (1, 0),
                "020": ((0, 3, 3, 0, None),),
                "145": v[0],
                "625": {"R": v[1], "SDR": v[2]},
                "627": {"AZ": v[3], "SDASZ": v[4]},
                "628": {"EL": v[5], "SDEL": v[6]},
                "630": {"RPS": v[7]},
            }
        case 16:
            pairs = [(i, i, i) for i in range(2)]
            place = (("LAT", 40.0), ("LON", -3.0))
            return {"000": 1, "140": v[0], "200": 10, "300": pairs, "400": place, "405": 700.0}
        case 25:
            status = ((v[1], v[2], v[3], None), (0, v[4], v[5], None))
            # Its longitudes have another LSB than ours; the number sent is the same.
            place = (("LAT", 40.0), ("LON", -1.5))
            return {"000": (1, 0), "070": v[0], "100": status, "600": place, "610": 700.0}
        case 34:
            return {"000": 2, "030": v[0], "020": v[1]}
        case 48:
            return {
                "140": v[0],
                "020": ((1, 1, 0, 0, 0, None),),
                "040": (("RHO", v[1]), ("THETA", v[2])),
                "130": {"PRL": v[3], "PAM": v[4]},
                "110": (0, ("3DH", v[5])),
            }
        case 62:
            return {
                "070": v[0],
                "105": (("LAT", v[1]), ("LON", v[2])),
                "100": (("X", v[3]), ("Y", v[4])),
                "185": (("VX", v[5]), ("VY", v[6])),
                "040": v[7],
                "080": ((1, 0, 0, 0, v[8], None),),
                "290": {"PSR": v[9]},
                "130": v[10],
            }
        case 63:
            status = ((v[3], v[4], 0, 0, 0, 0, None),)
            return {"030": v[0], "050": (("SAC", v[1]), ("SIC", v[2])), "060": status}
        case _:
            return {
                "000": 5,
                "030": v[0],
                "040": v[1],
                "090": "2437.00",
                "050": (("LAT", 40.0), ("LON", -3.0)),
                "070": v[2],
                "180": v[3],
                "190": v[4],
                "200": v[5],
            }
