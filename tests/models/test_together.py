"""Columns of many sensors hold what each sensor has by itself, to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plotfeed.models.beam import Sector, Sectors, Timetable, Timetables
from plotfeed.models.chance import Chance, DrawsBySensor, Purpose, ScanDraws
from plotfeed.models.effects.readings import SkewFrame
from plotfeed.models.frames import Axes, LocalFrame, LocalFrames

S = 1_000_000_000
SPANS = st.tuples(
    st.integers(S // 10, 12 * S), st.sampled_from([1, 4, 7, 32, 256]), st.sampled_from([0.0, 1e6])
)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(SPANS, min_size=1, max_size=4),
    st.integers(100 * S, 1 << 60),
    st.lists(st.integers(1, 3 * S), max_size=6),
)
def test_sectors_of_all_are_those_of_each(
    spans: list[tuple[int, int, float]], start_ns: int, steps_ns: list[int]
) -> None:
    tables = [
        Timetable(period_ns, n, jitter_ns, Chance(1, f"s{i}"))
        for i, (period_ns, n, jitter_ns) in enumerate(spans)
    ]
    together = Timetables(tables)
    together.start(start_ns)
    t_ns, found = start_ns, list[tuple[int, Sector]]()
    for step_ns in steps_ns:
        t_ns += step_ns
        sectors = together.ending_before(t_ns)
        together.take(sectors)
        found += [(int(i), sectors.one(row)) for row, i in enumerate(sectors.sensor)]
        assert (np.diff(sectors.sensor) >= 0).all()
    for i, table in enumerate(tables):
        sector, expected = table.sector_at(start_ns), []
        if sector.start_ns < start_ns:
            sector = table.next_sector(sector)
        while sector.end_ns < t_ns:
            expected.append(sector)
            sector = table.next_sector(sector)
        assert [one for of, one in found if of == i] == expected
        assert together.sector(i) == sector
        assert together.next_end_ns[i] == sector.end_ns


def test_rows_belong_to_the_sector_in_which_they_are() -> None:
    tables = [Timetable(S, 8), Timetable(S // 2, 1), Timetable(S, 4)]
    together = Timetables(tables)
    together.start(0)
    sectors = together.ending_before(2 * S)
    rng = np.random.default_rng(1)
    row = np.sort(rng.integers(0, len(sectors), 500))
    share = rng.random(500)
    t_ns = sectors.start_ns[row] + (share * (sectors.end_ns - sectors.start_ns)[row]).astype(int)
    t_ns[sectors.stares[row]] = sectors.end_ns[row][sectors.stares[row]]
    places = sectors.places(sectors.sensor[row], t_ns)
    order = np.argsort(places, kind="stable")
    offsets = sectors.offsets(places[order])
    found = np.repeat(np.arange(len(sectors)), np.diff(offsets))
    assert (found == row[order]).all()
    assert offsets[0] == 0
    assert offsets[-1] == 500
    assert Sectors.of([]).sensor.shape == (0,)


def frames(seed: int) -> list[Axes]:
    rng = np.random.default_rng(seed)
    latitudes_deg = [-90.0, 0.0, 90.0, *rng.uniform(-90, 90, 5)]
    level = [LocalFrame(float(lat), float(rng.uniform(-180, 180)), 100.0) for lat in latitudes_deg]
    return [*level, SkewFrame.at(level[3], azimuth_offset_deg=2.0, tilt_deg=1.0)]


@pytest.mark.parametrize("n", [3, 50, 2000])
def test_frames_of_rows_are_those_of_each_to_the_last_bit(n: int) -> None:
    every = frames(n)
    rng = np.random.default_rng(n)
    which = rng.integers(0, len(every), n)
    enu_m = rng.normal(0, 5000, (n, 3))
    enu_m[0, :2] = 0.0
    ecef_m = np.array([every[i].to_ecef(place) for i, place in zip(which, enu_m, strict=True)])
    azimuth_deg, elevation_deg = rng.uniform(0, 360, n), rng.uniform(-5, 80, n)
    rows = LocalFrames.of(every).rows(which)

    def each(method: str, *columns: Any) -> Any:
        return np.array(
            [
                getattr(every[i], method)(*(column[row : row + 1] for column in columns))[0]
                for row, i in enumerate(which)
            ]
        )

    for method, columns in {
        "from_ecef": (ecef_m,),
        "azimuths_deg": (ecef_m,),
        "rotate_from_ecef": (ecef_m,),
        "rotate_to_ecef": (enu_m,),
        "to_ecef": (enu_m,),
        "heights_m": (azimuth_deg, elevation_deg, np.abs(enu_m[:, 0])),
    }.items():
        np.testing.assert_array_equal(getattr(rows, method)(*columns), each(method, *columns))


@pytest.mark.parametrize("scans_at_once", [1, 2, 5])
def test_draws_of_sensors_together_are_those_of_each_alone(scans_at_once: int) -> None:
    chances = [Chance(3, f"s{i}") for i in range(4)]
    together = ScanDraws(chances, Purpose.DETECTION)
    rng = np.random.default_rng(scans_at_once)
    for first in (10, 11, 1000, 11):
        n = 60
        sensor, drone = np.sort(rng.integers(0, 4, n)), rng.integers(0, 25, n)
        scan = first + rng.integers(0, scans_at_once, n)
        found = drawn(together.of(sensor, scan, drone), n)
        for row in range(n):
            alone = ScanDraws([Chance(3, f"s{sensor[row]}")], Purpose.DETECTION)
            one = alone.of(np.zeros(1, np.int64), scan[row : row + 1], drone[row : row + 1])
            for all_of_them, own in zip(found, drawn(one, 1), strict=True):
                np.testing.assert_array_equal(all_of_them[..., row], own[..., 0])


def drawn(rng: Any, n: int) -> list[Any]:
    half = rng.random((n,))
    return [
        half, rng.standard_exponential((n,)), rng.standard_gamma(16, (n,)),
        rng.standard_normal((3, n)),
    ]  # fmt: skip


def test_draws_of_sensors_that_stare_are_those_of_each_alone() -> None:
    counts = [5, 0, 1, 12]
    sensor = np.repeat(np.arange(4), counts)
    orders = np.random.default_rng(1).uniform(1, 9, len(sensor))

    def generators() -> list[np.random.Generator]:
        return [Chance(3, f"s{i}").rng(Purpose.DETECTION, 9) for i in range(4)]

    together = DrawsBySensor(generators(), sensor)
    odd = np.arange(len(sensor)) % 2 == 1
    found = [*drawn(together, len(sensor)), together.standard_gamma(orders)]
    found.append(together.rows(odd).standard_normal((2, int(odd.sum()))))
    for i, alone in enumerate(generators()):
        mine = sensor == i
        own = [*drawn(alone, counts[i]), alone.standard_gamma(orders[mine])]
        own.append(alone.standard_normal((2, int((mine & odd).sum()))))
        for all_of_them, of_one in zip(found[:-1], own[:-1], strict=True):
            np.testing.assert_array_equal(all_of_them[..., mine], of_one)
        np.testing.assert_array_equal(found[-1][..., mine[odd]], own[-1])
