"""Reports of every kind that sensors send: what is measured comes back, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.asterix_input import numeric_slots, plots, tracks

from plotfeed.proto.asterix.cat015 import CAT015, Geometry, PlotEncoder015, Scanning
from plotfeed.proto.asterix.cat016 import SystemEncoder016
from plotfeed.proto.asterix.cat025 import CAT025, CAT025_HALF_TURN, status_025
from plotfeed.proto.asterix.cat048 import CAT048, PlotEncoder048, north_markers
from plotfeed.proto.asterix.cat062 import CAT062, TrackEncoder062, status_063
from plotfeed.proto.asterix.cat129 import CAT129, TargetEncoder129
from plotfeed.proto.asterix.cat205 import CAT205, BearingEncoder205
from plotfeed.proto.asterix.categories import CATEGORIES
from plotfeed.proto.asterix.codec.decode import Record, decode
from plotfeed.proto.asterix.codec.encode import Reports
from plotfeed.proto.asterix.codec.layout import Category, Overflow, Quantity
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.units import FOOT_M, NM_M

OURS, FIRST = (25, 3), np.array([0])
SITE = {"latitude_deg": 40.45, "longitude_deg": -3.73}
DAY_NS = 86_400 * 10**9


class Kind(NamedTuple):
    """Reports of one kind."""

    encode: Callable[..., list[bytes]]  # Of columns by their names
    layout: Category
    always: str  # The items that every record has
    told: Mapping[str, tuple[str, float]]  # Path and unit of each column that is told as it is


def unmanned(**columns: Any) -> list[bytes]:
    """Reports of one aircraft, all of whose columns have the same length."""
    n = max(np.size(column) for column in columns.values())
    axes = [np.broadcast_to(columns.pop(name, 0.0), n) for name in ("east", "north", "up")]
    usual = {"t_utc_ns": np.zeros(n, np.int64), "latitude_deg": np.zeros(n)}
    usual |= {"longitude_deg": np.zeros(n), "velocity_m_s": np.stack(axes, axis=-1)}
    return TargetEncoder129(country="ES").blocks(["SN"] * n, **usual | columns)


ANGLES = {"azimuth_deg": ("I015/627/AZ", 1.0), "elevation_deg": ("I015/628/EL", 1.0)}
KINDS = {
    "048": Kind(
        lambda **columns: PlotEncoder048(*OURS).blocks(plots(**columns)),
        CAT048,
        "010 020 040 140",
        {
            "range_m": ("I048/040/RHO", NM_M),
            "azimuth_deg": ("I048/040/THETA", 1.0),
            "run_length_deg": ("I048/130/PRL", 1.0),
            "amplitude_dbm": ("I048/130/PAM", 1.0),
            "height_m": ("I048/110", FOOT_M),
            "range_rate_m_s": ("I048/120/CAL/CAL", 1.0),
        },
    ),
    "015": Kind(
        lambda **columns: PlotEncoder015(*OURS).blocks(plots(**columns)),
        CAT015,
        "000 010 020 145 625 627",
        ANGLES
        | {
            "range_m": ("I015/625/R", 1.0),
            "range_rate_m_s": ("I015/626/DV", 1.0),
            "amplitude_dbm": ("I015/630/RPP", 1.0),
        },
    ),
    "015 multistatic": Kind(
        lambda **columns: PlotEncoder015(*OURS, geometry=Geometry.MULTISTATIC).blocks(
            plots(**{"channel": 1 if np.size(next(iter(columns.values()))) else [], **columns})
        ),
        CAT015,
        "000 010 020 145 400 627",
        ANGLES | {"bistatic_range_m": ("I015/625/R", 1.0)},
    ),
    "015 bearings": Kind(
        lambda **columns: PlotEncoder015(*OURS, geometry=Geometry.OTHER).blocks(plots(**columns)),
        CAT015,
        "000 010 020 145 627",
        ANGLES,
    ),
    "205": Kind(
        lambda **columns: BearingEncoder205(*OURS, **SITE).blocks(plots(**columns), 0),
        CAT205,
        "000 010 030 040 050 070",
        {"azimuth_deg": ("I205/070", 1.0), "elevation_deg": ("I205/200", 1.0)},
    ),
    "062": Kind(
        lambda **columns: TrackEncoder062(*OURS).blocks(tracks(**columns)),
        CAT062,
        "010 040 070 080 100 105 185",
        {
            "east_m": ("I062/100/X", 1.0),
            "north_m": ("I062/100/Y", 1.0),
            "velocity_east_m_s": ("I062/185/VX", 1.0),
            "velocity_north_m_s": ("I062/185/VY", 1.0),
            "height_m": ("I062/130", FOOT_M),
            "climb_m_s": ("I062/220", FOOT_M / 60),
            "age_s": ("I062/290/PSR", 1.0),
        },
    ),
    "129": Kind(
        unmanned,
        CAT129,
        "010 040 050 070 080 185 220",
        {
            "altitude_m": ("I129/090", 1.0),
            "height_m": ("I129/100", 1.0),
            "east": ("I129/185/VX", 1.0),
            "north": ("I129/185/VY", 1.0),
            "up": ("I129/220", 1.0),
        },
    ),
}
EVERY_KIND = pytest.mark.parametrize("name", KINDS)
EVERY_COLUMN = [(name, column) for name, kind in KINDS.items() for column in kind.told]


@cache
def part_of(number: int, path: str) -> Quantity:
    (part,) = (slot.part for slot in numeric_slots(CATEGORIES[number]) if slot.path == path)
    assert isinstance(part, Quantity)
    return part


def one(name: str, **columns: Any) -> Record:
    """One report there and back."""
    (block,) = KINDS[name].encode(**columns)
    (record,) = decode(block)
    return record


@pytest.mark.parametrize(("name", "column"), EVERY_COLUMN)
@given(share=st.floats(-1.2, 1.2) | st.sampled_from([-1.0, 0.0, 1.0, 0.9999999]))
def test_what_is_measured_comes_back_to_half_a_step_or_saturates(
    name: str, column: str, share: float
) -> None:
    kind = KINDS[name]
    path, unit = kind.told[column]
    part = part_of(kind.layout.number, path)
    step, (low, high) = part.lsb * unit, part.limits
    value = share * high * step
    back = one(name, **{column: value}).get(path)
    assert isinstance(back, float)
    if part.overflow is Overflow.WRAP:
        turn = (part.modulus or 1 << part.bits) * part.lsb
        assert 0 <= back < turn
        error = math.remainder(back - value, turn)
    else:
        error = back * unit - min(max(value, low * step), high * step)
    assert abs(error) <= step / 2 * (1 + 1e-6)


@EVERY_KIND
@given(t_utc_ns=st.integers(0, 2**62))
@example(t_utc_ns=DAY_NS - 3_906_251)
@example(t_utc_ns=DAY_NS - 3_906_250)
def test_times_come_back_within_the_day(name: str, t_utc_ns: int) -> None:
    if name == "205":  # whose time is that of sending
        (block,) = BearingEncoder205(*OURS, **SITE).blocks(plots(azimuth_deg=0.0), t_utc_ns)
    else:
        (block,) = KINDS[name].encode(t_utc_ns=np.array([t_utc_ns]))
    (record,) = decode(block)
    items = {"I048/140", "I015/145", "I062/070", "I129/070", "I205/030"}
    (back,) = (record.items[item] for item in items & set(record.items))
    assert isinstance(back, float)
    assert 0 <= back < 86_400
    assert abs(math.remainder(back - t_utc_ns % DAY_NS / 1e9, 86_400)) <= 0.5 / 128 + 1e-9


@EVERY_KIND
@given(data=st.data())
def test_what_is_not_measured_is_not_sent(name: str, data: st.DataObject) -> None:
    kind = KINDS[name]
    chosen = data.draw(st.sets(st.sampled_from(sorted(kind.told)), min_size=1))
    record = one(name, **dict.fromkeys(chosen, 1.0))
    assert {item[5:] for item in record.items} == {
        *kind.always.split(),
        *(kind.told[column][0].split("/")[1] for column in chosen),
    }
    if name == "048":
        told = {kind.told[column][0] for column in chosen}
        for path in ("I048/130/PRL", "I048/130/PAM"):
            assert (record.get(path) is not None) == (path in told)


@pytest.mark.parametrize(
    ("name", "column"),
    [
        *EVERY_COLUMN,
        *(("015", f"sigma_{of}") for of in
          ("range_m", "azimuth_deg", "elevation_deg", "range_rate_m_s")),
        *(("015", "snr"), ("205", "snr"), ("205", "amplitude_dbm")),
        *(("062", "sigma_east_m"), ("062", "sigma_north_m"), ("062", "longitude_deg")),
    ],
)  # fmt: skip
def test_what_is_measured_now_and_then_is_refused(name: str, column: str) -> None:
    both = {"sigma_east_m": 1.0, "sigma_north_m": 1.0} if name == "062" else {}
    of = {column.removeprefix("sigma_"): 1.0} if name == "015" else {}
    for rows in ([1.0, math.nan], [math.nan, 1.0], [1.0] * 90 + [math.nan]):
        with pytest.raises(EncodeError):
            KINDS[name].encode(**both | of | {column: np.array(rows)})


@EVERY_KIND
def test_no_rows_make_no_blocks(name: str) -> None:
    column = next(iter(KINDS[name].told))
    assert KINDS[name].encode(**{column: np.empty(0)}) == []


MAST = (40.45, -3.73, 700.0)
SYSTEM: dict[str, Any] = {
    "sac": [25], "sic": [3], "transmitters": [[MAST]], "receivers": [MAST], "reference": MAST,
    "period_s": 10,
}  # fmt: skip


def system(**changes: Any) -> SystemEncoder016:
    """Of one transmitter and one receiver, but for the changes."""
    return SystemEncoder016(**SYSTEM | changes)


MICROPHONES = PlotEncoder015(1, 1, classes={"bird": 512})


def radar_at(*place: float, period_s: float = 1.0) -> Reports:
    return north_markers(1, 1, antenna_period_s=period_s, place=place)


def status_at(
    latitude_deg: float, longitude_deg: float, height_m: float = 0.0, **more: Any
) -> Reports:
    return status_025(1, 1, (latitude_deg, longitude_deg, height_m), **more)


@pytest.mark.parametrize(
    ("encode", "said"),
    [
        *((lambda bad=bad: PlotEncoder048(*bad), "I048/010") for bad in ((256, 0), (0, -1))),
        (lambda: north_markers(0, 256, antenna_period_s=1, place=(0, 0, 0)), "I034/010"),
        *((lambda n=n: PlotEncoder048(1, 1, max_octets=n), "max_octets") for n in (20, 70_000)),
        (lambda: PlotEncoder015(1, 1, max_octets=30), "max_octets"),
        (lambda: PlotEncoder015(256, 1), "I015/010/SAC"),
        *((lambda place=place: radar_at(*place), "I034/120")
          for place in ((91.0, 0.0, 0.0), (0.0, 181.0, 0.0), (0.0, 0.0, 4e4), (math.nan,) * 3)),
        *((lambda s=s: radar_at(0.0, 0.0, 0.0, period_s=s), "I034/041")
          for s in (512.0, -1.0, math.nan)),
        *((lambda place=place: status_at(*place), "I025/600")
          for place in ((91.0, 0.0), (0.0, 181.0), (0.0, math.nan))),
        *((lambda to=to: BearingEncoder205(1, 1, latitude_deg=to[0], longitude_deg=to[1]),
           "I205/050") for to in ((90.1, 0.0), (0.0, -180.1), (math.nan, 0.0), (0, math.inf))),
        (lambda: system(period_s=math.nan), "I016/200"),
        (lambda: system(sic=[256]), "I016/010/SIC"),
        (lambda: system(transmitters=[[MAST] * 256]), "I016/300"),
        (lambda: system(transmitters=[[(90.1, 0.0, 0.0)]]), "I016/410/0/LAT"),
        (lambda: system(receivers=[(0.0, 0.0, math.nan)]), "I016/420"),
        (lambda: system(reference=(0.0, math.inf, 0.0)), "I016/400"),
        (lambda: system(transmitters=[[MAST] * 70]), "max_octets"),  # more than a datagram holds
        (lambda: TargetEncoder129(country="ESP"), "I129/050"),
        (lambda: one("015", sigma_elevation_deg=1.0), "I015/628/SDEL: a standard deviation of"),
        (lambda: one("062", latitude_deg=91.0), "I062/105"),
        (lambda: one("062", track=65_536), "I062/040"),
        (lambda: one("062", sigma_east_m=1.0), "I062/500/APC/Y: a column is missing"),
        *((lambda snr=snr: one("015", snr=snr), "I015/630/RPS") for snr in (0.0, -1.0, math.inf)),
        (lambda: MICROPHONES.blocks(plots(kind="jet")), "I015/300/0/CLS: no class for kind 'jet'"),
        (lambda: MICROPHONES.blocks(plots(kind="bird")), "I015/300/0/CLS"),
        *((lambda c=c: unmanned(altitude_m=1.0, **{c: [181.0]}), "I129/080")
          for c in ("latitude_deg", "longitude_deg")),
        (lambda: unmanned(t_utc_ns=np.array([1.5])), "I129/070"),
        *((lambda s=s: TargetEncoder129(country="ES").blocks([s], [1], [1.0], [1.0]), "I129/040")
          for s in ("1234567890123", "naïve", "a\nb")),
    ],
)  # fmt: skip
def test_what_cannot_be_sent_is_refused(encode: Callable[[], object], said: str) -> None:
    with pytest.raises(EncodeError, match=said):
        encode()


# Column, its LSB, that of its standard deviation, and the bits of the latter.
DEVIATIONS = {
    "I015/625/SDR": ("range_m", 0.1, 0.1, 24),
    "I015/626/SDDV": ("range_rate_m_s", 0.01, 1 / 64, 16),
    "I015/627/SDASZ": ("azimuth_deg", 360 / 2**16, 180 / 2**18, 16),
    "I015/628/SDEL": ("elevation_deg", 180 / 2**16, 180 / 2**18, 16),
    "I062/500/APC/X": ("east_m", 0.5, 0.5, 16),
}


@pytest.mark.parametrize("path", DEVIATIONS)
@given(sigma=st.floats(0, 1e9))
@example(sigma=0.0)
@example(sigma=1e-300)
@example(sigma=math.inf)
def test_deviations_hold_the_rounding_of_their_value_and_are_rounded_up(
    path: str, sigma: float
) -> None:
    """So none is 0, and none less than the error of what was read."""
    column, lsb, own_lsb, bits = DEVIATIONS[path]
    more = {"sigma_north_m": 1.0} if path.startswith("I062") else {}
    back = one(path[1:4], **{column: 9.0, f"sigma_{column}": sigma}, **more).get(path)
    most = (2**bits - 1) * own_lsb
    exactly = min(math.hypot(sigma, lsb / math.sqrt(12)), most)
    assert isinstance(back, float)
    assert back > 0
    assert exactly * (1 - 1e-12) <= back <= min(exactly + own_lsb, most) * (1 + 1e-12)


def test_heights_of_048_are_above_the_geoid() -> None:
    heights_m, levels_m = np.array([52.0 + 762.0, 0.0, -100.0]), np.array([52.0, 52.0, -100.0])
    for undulation_m, feet in ((levels_m, [2500, -175, 0]), (52.0, [2500, -175, -500])):
        (block,) = PlotEncoder048(1, 1).blocks(plots(height_m=heights_m), undulation_m)
        assert [record.get("I048/110") for record in decode(block)] == feet


def test_a_plot_of_015_says_how_it_was_scanned_and_how_sure_its_class_is() -> None:
    encoder = PlotEncoder015(25, 3, scanning=Scanning.FORWARD, classes={"bird": 3})
    for probability, percent in ((math.nan, 0), (0.25, 25)):
        (block,) = encoder.blocks(plots(kind="bird", kind_probability=probability))
        (record,) = decode(block)
        assert record.get("I015/020") == {"MOMU": 0, "TTAX": 3, "SCD": 1}
        assert record.get("I015/300") == [{"CLS": 3, "PRB": percent}]


@pytest.mark.parametrize("edition", [CAT025, CAT025_HALF_TURN])
def test_the_north_pole_is_as_near_as_the_item_can_say(edition: Category) -> None:
    pole = status_at(90.0, 0.0, category=edition)
    assert pole.one_each(FIRST, FIRST)[0].find(bytes.fromhex("7fffffff00000000")) > 0
    south = status_at(-90.0, 179.0, -1e6)
    (record,) = decode(south.one_each(FIRST, FIRST)[0])
    assert record.get("I025/600") == {"LAT": -90.0, "LON": pytest.approx(179.0, abs=5e-8)}
    assert record.get("I025/610") == -8192.0


def test_systems_and_sensors_say_each_for_itself() -> None:
    each = [{"sic": [3]}, {"sic": [4], "transmitters": [[(40.45, -3.73, 900.0)]]}]
    both = {name: [*of, *each[1].get(name, of)] for name, of in SYSTEM.items()
            if name not in ("reference", "period_s")}  # fmt: skip
    times, which = np.array([10**9, 10**9, 2 * 10**9]), np.array([1, 0, 1])
    assert system(**both).blocks(times, which) == [
        system(**each[i]).blocks([t], FIRST)[0]
        for i, t in zip(which.tolist(), times.tolist(), strict=True)
    ]
    sent = status_063([25, 26], [3, 4]).one_each(times, which)
    for block, source in zip(sent, which.tolist(), strict=True):
        (record,) = decode(block)
        expected = {"SAC": 25 + source, "SIC": 3 + source}
        assert record.get("I063/010") == record.get("I063/050") == expected
