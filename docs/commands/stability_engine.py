"""Extremes through the engine beside exact values: the second table of docs/stability.md."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import mpmath as mp
import numpy as np
from stability_forms import error

from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.scene.scene import Scene
from plotfeed.models.state import FALSE_ALARM, Looks, Plots
from plotfeed.proto.asterix.codec.decode import decode
from plotfeed.testing import radar, scene, staring

NS = 10**9
START_NS = 1_767_268_800 * NS
RCS_M2, POWER_W, RANGE_M = 0.01, 500.0, 3000.0


def stage(
    *drones: dict[str, Any], latitude_deg: float = 40.0, longitude_deg: float = 9.0, **tables: Any
) -> Scene:
    """A radar that stares at the whole sky from that site, and what it sees."""
    site = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": 100.0}
    keys = {"name": "extreme", "seed": 1, "site": site}
    sky = {"elevation_min_deg": -90.0, "elevation_max_deg": 90.0}
    sensor = radar(scan=staring(), pfa=1e-15, power_w=POWER_W, **sky)
    return scene([sensor], drones, seed=1, scene=keys, **tables)


def east(*ranges_m: float) -> list[dict[str, Any]]:
    """Drones that stand so far east of the site, 50 m up."""
    place, keys = {"north_m": 0.0, "above_site_m": 50.0}, {"rcs_m2": RCS_M2, "repeat": True}
    paths = [[{"east_m": far + step, **place} for step in (0.0, 0.01)] for far in ranges_m]
    return [{"id": f"d{i}", "speed_m_s": 0.01, "path": p, **keys} for i, p in enumerate(paths)]


def sensed(of: Scene, start_ns: int = START_NS, scans: int = 3) -> tuple[Looks, Plots, list[bytes]]:
    """Looks, plots and the messages of category 048 of some scans."""
    batches = list(Engine(of, start_ns).until(start_ns + scans * NS))
    said = [m for b in batches for some in b.messages for m in some]
    looks, plots = Looks.joined([b.looks for b in batches]), [b.plots for b in batches]
    return looks, Plots.joined(plots), [m.payload for m in said if m.topic.endswith("048")]


def exact_pd(range_m: float) -> mp.mpf:
    """Pd by the radar equation and a CFAR of 16 cells, in sixty digits."""
    gains = mp.mpf(10) ** (mp.mpf("4.64"))  # 20 + 35.4 dB less losses of 4 and noise of 5
    wavelength_m, noise_j = mp.mpf(299_792_458) / 10**10, mp.mpf("1.380649e-23") * 290
    energy_j = POWER_W * mp.mpf("0.06") * gains * wavelength_m**2 * mp.mpf(RCS_M2)
    snr = energy_j / ((4 * mp.pi) ** 3 * mp.mpf(range_m) ** 4 * noise_j)
    return (1 + (mp.mpf("1e-15") ** (-mp.mpf(1) / 16) - 1) / (1 + snr)) ** -16


def worst_pd(looks: Looks) -> float:
    return max(error(pd, exact_pd(r)) for r, pd in zip(looks.range_m, looks.pd, strict=True))


def unlike(looks: Looks, latitude_deg: float = 40.0) -> float:
    """By how many metres, or degrees, a drone 3 km east is not where it is at that latitude."""
    usual, _, _ = sensed(stage(*east(RANGE_M), latitude_deg=latitude_deg))
    columns = ("range_m", "azimuth_deg", "elevation_deg")
    return max(float(np.abs(getattr(looks, c) - getattr(usual, c)).max()) for c in columns)


def at(year: int) -> float:
    start_ns = int(datetime(year, 1, 1, tzinfo=UTC).timestamp()) * NS
    return unlike(sensed(stage(*east(RANGE_M)), start_ns)[0])


def leap_second() -> float:
    """By how many seconds times of day are off, over the end of 2016."""
    start_ns = int(datetime(2016, 12, 31, 23, 59, 58, tzinfo=UTC).timestamp()) * NS
    _, plots, payloads = sensed(stage(*east(RANGE_M)), start_ns, scans=4)
    records = [record for payload in payloads for record in decode(payload)]
    told_s = [s for record in records if (s := record.get("I048/140")) is not None]
    true_s = plots.t_utc_ns % (86_400 * NS) / NS
    return float(np.abs(np.array(told_s) - true_s).max()) if len(told_s) == 4 else np.nan


def counted(of: Scene) -> str:
    looks, plots, _ = sensed(of)
    return f"{len(looks)} looks, {np.count_nonzero(plots.drone != FALSE_ALARM)} plots of drones"


def not_a_number() -> str:
    engine = Engine(stage(), START_NS)
    told = {"latitude_deg": float("nan"), "longitude_deg": 9.0, "altitude_m": 150.0}
    refused = engine.receive("plotfeed/telemetry/d", json.dumps(told).encode(), START_NS)
    return "refused" if refused and not engine.trajectories.names else "taken"


def one_place() -> float:
    drones = {"id": "d", "number": 10_000, "formation": {"kind": "random", "radius_m": 1e-9}}
    (one,) = east(RANGE_M)
    looks, _, _ = sensed(stage(swarm=[{**one, **drones}]), scans=2)
    return worst_pd(looks.rows(np.arange(0, 20_000, 1000))) if len(looks) == 20_000 else np.nan


def far_poles() -> float:
    stages = (stage(*east(RANGE_M), latitude_deg=x, longitude_deg=0.0) for x in (-90.0, 90.0))
    return max(unlike(sensed(each)[0], 89.999) for each in stages)


def one_at(place: str, *values: float) -> str:
    """What is counted of a drone right at the antenna but for that."""
    here = {"east_m": 0.0, "north_m": 0.0, "above_site_m": 0.0}
    (drone,) = east(0.0)
    return counted(stage({**drone, "path": [{**here, place: value} for value in values]}))


# By the first cell of a row: errors, relative or in the unit that the page has, or words.
EXTREMES: dict[str, Callable[[], float | str]] = {
    "a Pfa of 10⁻¹⁵, 1 to 6 km": lambda: worst_pd(sensed(stage(*east(1e3, 2e3, 4e3, 6e3)))[0]),
    "a drone at the antenna": lambda: one_at("east_m", 0.0, 1e-9),
    "a drone straight above": lambda: one_at("above_site_m", 3000.0, 3000.01),
    "the site at either pole": far_poles,
    "the antimeridian between site and drone": lambda: unlike(
        sensed(stage(*east(RANGE_M), longitude_deg=179.999))[0]
    ),
    "telemetry with a NaN": not_a_number,
    "the year 1970": lambda: at(1970),
    "the year 2100": lambda: at(2100),
    "the leap second at the end of 2016": leap_second,
    "a scene of nothing": lambda: counted(stage()),
    "10,000 drones at one place": one_place,
}
