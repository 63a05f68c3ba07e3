"""Whether `plotfeed needs` tells right what is known by hand: the table of docs/needs.md.

python docs/commands/needs_known.py
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from pages import between, table

from plotfeed.feeds.lab.needs import Needs, variants_of
from plotfeed.feeds.scene.scene import Scene
from plotfeed.testing import held, radar, scene, staring, waypoint

PAGE = Path(__file__).parents[1] / "needs.md"
START_NS = 1_767_268_800 * 10**9
SEEDS = 100
DRONES, RANGE_M, RCS_M2 = 20, 3000.0, 0.01
PFA, REFERENCES = 1e-8, 16


def pd_by_hand(power_w: float, loss_db: float = 0.0) -> float:
    """Pd of the radar's drones: the radar equation, and a CFAR of an echo of Swerling 1."""
    gains = 10 ** ((20.0 + 35.4 - 4.0 - 5.0 - loss_db) / 10)
    echo_w = power_w * gains * 0.0299792458**2 * RCS_M2 / ((4 * math.pi) ** 3 * RANGE_M**4)
    snr = echo_w * 0.06 / (1.380649e-23 * 290.0)
    multiplier = PFA ** (-1 / REFERENCES) - 1
    return (1 + multiplier / (1 + snr)) ** -REFERENCES


def drones(n: int = DRONES, **keys: Any) -> list[dict[str, Any]]:
    """Drones that stand about the site, each in another direction."""
    return [held(f"d{i}", 360.0 / n * i, 3.0, RANGE_M, rcs_m2=RCS_M2, **keys) for i in range(n)]


def seen_by_radar(power_w: float, folder: Path, keys: Any = None, **tables: Any) -> Scene:
    """A radar that stares at them; `keys` are others of its own."""
    sensor = radar(scan=staring(), report=["plots"], pfa=PFA, power_w=power_w, **(keys or {}))
    return scene([sensor], drones(), seed=1, folder=folder, **tables)


def behind_walls(folder: Path) -> Scene:
    """Two of each five drones stand behind a wall, 200 m high and a kilometre from the radar."""
    walls = []
    for i in (i for i in range(DRONES) if i % 5 < 2):
        about = [(i * 18.0 + off, range_m) for range_m in (1000, 1010) for off in (-4.0, 4.0)]
        ring = [waypoint(azimuth, 0.0, range_m) for azimuth, range_m in about]
        corners = [[each["longitude_deg"], each["latitude_deg"]] for each in ring]
        shape = {"type": "Polygon", "coordinates": [[corners[k] for k in (0, 1, 3, 2, 0)]]}
        walls.append({"type": "Feature", "properties": {"height": 200}, "geometry": shape})
    told = json.dumps({"type": "FeatureCollection", "features": walls})
    (folder / "walls.geojson").write_text(told)
    return seen_by_radar(100.0, folder, terrain={"buildings": ["walls.geojson"]})


def in_rain(folder: Path) -> Scene:
    """Rain of 12 dB there and back: 2 dB/km at 10 GHz, by k and alpha of ITU-R P.838-3, table 5."""
    rain_mm_h = (2.0 / 0.01217) ** (1 / 1.2571)
    return seen_by_radar(30.0, folder, {"weather": {"rain_mm_h": rain_mm_h}})


def without_use(folder: Path) -> Scene:
    """Errors that are once as large as they are."""
    return seen_by_radar(30.0, folder, {"degradation": {"error_factor": 1.0}})


def hardly_deaf(_folder: Path) -> Scene:
    """An RF sensor that would hear every drone, and misses one in a hundred."""
    sensor = {
        "id": "rf", "type": "rf", "scan": staring(), "frequency_min_hz": 2.4e9,
        "frequency_max_hz": 2.5e9, "channel_bandwidth_hz": 1e6, "integration_s": 1e-3,
        "range_max_m": 9000.0, "baseline_m": 0.2, "azimuth_floor_deg": 0.5, "report": ["plots"],
        "degradation": {"pd_factor": 0.99},
    }  # fmt: skip
    emitter = {"frequency_hz": 2.44e9, "bandwidth_hz": 1e6, "eirp_dbm": 20.0}
    return scene([sensor], drones(3 * DRONES, emitters=[emitter]), seed=1)


class Known(NamedTuple):
    """A scene, the effect that is left out, the verdict, and by how much Pd changes, by hand."""

    words: str
    made: Callable[[Path], Scene]
    without: str
    verdict: str
    change: float


KNOWN = (
    Known("terrain that hides 40 %", behind_walls, "[terrain]", "needed", 0.4 * pd_by_hand(100.0)),
    Known(
        *("rain that costs 12 dB", in_rain, "weather", "needed"),
        pd_by_hand(30.0) - pd_by_hand(30.0, 12.0),
    ),
    Known("an effect that changes nothing", without_use, "degradation", "can go", 0.0),
    Known("an effect of 1 %, of which 2 % matter", hardly_deaf, "degradation", "can go", 0.01),
)


class Told(NamedTuple):
    """What was told with one seed: verdict, change of Pd with its interval, and runs."""

    verdict: str
    low: float
    value: float
    high: float
    runs: int

    def is_right(self, known: Known) -> bool:
        """Whether the verdict is that, and the interval holds the change."""
        return self.verdict == known.verdict and self.low <= known.change <= self.high


def told_of(known: Known, seeds: int) -> list[Told]:
    """What is told with that many seeds, each of runs of its own."""
    with TemporaryDirectory() as folder:
        of = known.made(Path(folder))
        variants = [each for each in variants_of(of) if each.name == f"without {known.without}"]
        found = []
        for seed in range(1, 1000 * seeds, 1000):
            how = {"matters": 0.02, "runs": 16, "duration_s": 10.0, "seed": seed}
            needs = Needs(of, variants, start_utc_ns=START_NS, **how)
            (finding,) = needs.findings
            (pd,) = (change for change in finding.changes if change.metric == "pd")
            found.append(Told(finding.verdict, pd.low, pd.value, pd.high, finding.runs))
    return found


def main() -> None:
    """Tell of each, and write the table."""
    rows = []
    for known in KNOWN:
        told = told_of(known, SEEDS)
        right = sum(each.is_right(known) for each in told)
        mean = sum(each.value for each in told) / SEEDS
        runs = sum(each.runs for each in told) / SEEDS
        figures = f"{known.change:+.1%}", f"{mean:+.1%}", f"{right} of {SEEDS}", f"{runs:.1f}"
        rows.append((known.words, known.verdict, *figures))
        print(*rows[-1], sep="; ", flush=True)
    heads = ("what is left out", "the verdict", ">change of Pd by hand", ">mean of those told")
    between(PAGE, "known", "\n".join(table((*heads, ">told right", ">runs, on average"), rows)))


if __name__ == "__main__":
    main()
