"""`plotfeed needs` and `plotfeed chart`: a scene with each effect off or on, by the engine itself.

Every variant of a scene runs with the seeds of the scene as it is, so that both draw the same
random numbers: their difference is that of the effect. Differences are given with intervals by
Student's t over seeds, which hold all figures of a variant, however often it is looked at, in 95 of
100 such experiments (Bonferroni). More seeds are run until all is decided, or as many as are asked
for, or as the time allows.
"""

from __future__ import annotations

import contextlib
import math
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import count
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from plotfeed.feeds.console.extras import need_extra
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import keep_freed, processor, refuse_if_there
from plotfeed.feeds.engine.engine import Engine
from plotfeed.feeds.engine.ordinary_world import (
    START_UTC_NS,
    TREES,
    WORLD_KEYS,
    ordinary_world,
    trees_about,
)
from plotfeed.feeds.formats import FORMATS
from plotfeed.feeds.formats.sensor_tracks import PlainTracks
from plotfeed.feeds.lab.lab_settings import ChartSettings, NeedsSettings, tell
from plotfeed.feeds.lab.pictures import INK, QUIET, figure_of, place_labels, save_picture
from plotfeed.feeds.lab.tables import Table, TextColumn, of_cells
from plotfeed.feeds.messages.batch import Batch
from plotfeed.feeds.messages.message import HELD_NS
from plotfeed.feeds.scene.changes import ChangeError, changed
from plotfeed.feeds.scene.fields import frame_at, site_frame
from plotfeed.feeds.scene.scene import Scene, parsed
from plotfeed.feeds.scene.scene_text import with_key, with_table, without
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.frames import enu_to_aer, wrap_180
from plotfeed.models.sensors.sensor_model import NO_PLOTS
from plotfeed.models.state import Bools, Floats, Ints, Plots
from plotfeed.models.track_metrics import set_score
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.utc import NS

FIRST_RUNS = 4  # Looked at after so many runs, after twice as many, and so on
BUDGET_S = 90.0  # Of processor, after which there are no more runs where nobody says how many
RISK = 0.05  # Share of experiments in which an interval of a variant does not hold what it should
CUTOFF_M = 100.0
FEWEST_PLOTS = 10  # Fewer plots give no errors that can be compared
STRETCH_NS = 5 * NS  # What is worked out at once


class Metric(NamedTuple):
    """What is told of each sensor, and what a change of it is a share of.

    That is itself in the scene as it is, all chances, the plots of a scan, or the scan's period.
    """

    share_of: str
    head: str  # Of a column
    words: str
    unit: str = ""


METRICS: Mapping[str, Metric] = {
    "pd": Metric("chances", "Pd", "share of scans in which a drone in range is plotted"),
    "alarms": Metric("plots", "false plots", "false plots a scan"),
    "range_m": Metric("itself", "range", "range error, rms", " m"),
    "azimuth_deg": Metric("itself", "azimuth", "azimuth error, rms", "°"),
    "elevation_deg": Metric("itself", "elevation", "elevation error, rms", "°"),
    "gospa_m": Metric("itself", "GOSPA", "GOSPA of a plain tracker", " m"),
    "completeness": Metric("chances", "followed", "share of drones that a plain tracker follows"),
    "delay_s": Metric("period", "delay", "delay", " s"),
    "lost": Metric("chances", "lost", "share of messages lost"),
}
OF_TRACKS = ("gospa_m", "completeness")


class Effect(NamedTuple):
    """A key of sensors that models something: how it is off, and usually on."""

    name: str
    off: Any = None
    on: Any = None  # An ordinary value; None where there is none


# Of sensors. What a kind of sensor has not is no effect of it; what refuses a value has none there.
# No value is ordinary of pulses and microphones, which are a design, nor of jammers, faults, events
# and classes, which no figure is of.
SENSOR_EFFECTS = (
    Effect("multipath", on={"antenna_height_m": 3.0}),
    Effect("antenna", on={"receive": {"elevation": {"kind": "gaussian"}}}),
    Effect("straddling", on={"range": "triangle"}),
    Effect("decorrelation_s", on=2.0),
    Effect("doppler", on={"notch_m_s": 2.0}),
    Effect("pulses"),
    Effect("merging", on={}),
    Effect("layout"),
    Effect("path_loss", on={"kind": "log-distance", "exponent": 2.7}),
    Effect("day_contrast", on=0.3),
    Effect("visibility_m", on=20_000.0),
    Effect("weather", on={"rain_mm_h": 5.0, "wind_m_s": 4.0}),
    Effect("jamming"),
    Effect("bias", on={"azimuth_offset_deg": 0.3}),
    Effect("drift", on={"time_constant_s": 60.0, "sigma_azimuth_deg": 0.2}),
    Effect("degradation"),
    Effect("classifier"),
    Effect("link", on={"latency_ms": 100.0, "jitter_ms": 20.0}),
    Effect("event", off=()),
)
# Of the whole scene: keys, and how they are off.
SCENE_EFFECTS: Mapping[str, Any] = {
    "terrain": None,
    **dict.fromkeys(("weather", "jammer", "birds", "road", "turbine", "clutter", "target"), ()),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A scene otherwise than it is: one effect off or on, or several."""

    name: str
    scene: Scene
    sensors: frozenset[int]  # Sensors, by index, of which it tells
    adds: bool = False  # Whether it adds what the scene does not name
    effects: tuple[str, ...] = ()
    # Formats of plots that are read back, by which errors are told; without, those of sensors.
    read_back: str = ""
    # Whether Pd is that of looks, in closed form, in place of the share of chances with a plot; it
    # tells of nothing else.
    closed_form: bool = False


class Change(NamedTuple):
    """A figure of a sensor in a variant less that of the scene as it is, with its interval."""

    sensor: str
    metric: str
    before: float
    value: float
    low: float
    high: float
    error: float  # Standard error of the value
    # The same as shares of what the metric is compared with.
    share: float
    share_low: float
    share_high: float
    share_error: float


def variants_of(scene: Scene, folder: Path | None = None) -> list[Variant]:
    """Each effect that the scene names off, all of those off, and each that it could name on.

    A terrain is among the latter where there is a folder for its file; raises `PlotfeedError`.
    """
    every = range(len(scene.sensor))
    found: list[Variant] = []
    for effect in SENSOR_EFFECTS:
        for on, value in ((False, effect.off), (True, effect.on)):
            if on and value is None:
                continue
            others = {i: s for i in every if (s := _with(scene.sensor[i], effect, value, on=on))}
            if others:
                name = f"{'with' if on else 'without'} {effect.name}"
                found.append(_variant(scene, name, others, adds=on, effects=(effect.name,)))
    for key, value in SCENE_EFFECTS.items():
        if getattr(scene, key) != value:
            name = f"[{key}]"
            found.append(_variant(scene, f"without {name}", {}, {key: value}, effects=(name,)))
    found += _with_world(scene, folder)
    off = [each for each in found if not each.adds]
    return [*found, together(scene, off, "without all of these")] if len(off) > 1 else found


def _with_world(scene: Scene, folder: Path | None) -> Iterator[Variant]:
    """The scene with each of an ordinary world that it does not name."""
    if not scene.fleet.names:
        return
    for key, table in ordinary_world(scene).items():
        if getattr(scene, key) or (key == "terrain" and folder is None):
            continue
        kind: Any = WORLD_KEYS[key]
        keys = kind.model_validate(table)
        if key == "terrain" and folder is not None:
            trees = folder / TREES
            trees.write_text(trees_about(scene), encoding="utf-8")
            keys = keys.model_copy(update={"buildings": (str(trees),)})
        told = {key: keys if key == "terrain" else (keys,)}
        yield _variant(scene, f"with [{key}]", {}, told, adds=True, effects=(f"[{key}]",))


def _variant(
    scene: Scene,
    name: str,
    sensors: Mapping[int, Sensor],
    keys: Mapping[str, Any] | None = None,
    **more: Any,
) -> Variant:
    """The scene with other sensors, by index, and other keys; of keys all sensors are told."""
    own = tuple(sensors.get(i, sensor) for i, sensor in enumerate(scene.sensor))
    return Variant(
        name=name,
        scene=scene.model_copy(update={"sensor": own, **(keys or {})}),
        sensors=frozenset(range(len(own)) if keys else sensors),
        **more,
    )


def _with(sensor: Sensor, effect: Effect, value: Any, *, on: bool) -> Sensor | None:
    """A sensor with an effect off or on; None where it is so already, or cannot be."""
    key = type(sensor).model_fields.get(effect.name)
    if key is None:
        return None
    off = effect.off if effect.off is not None else key.default
    if (getattr(sensor, effect.name) == off) != on:
        return None
    asked: list[Any] = [value if on else None]
    if isinstance(value, Mapping):  # of which each kind of sensor takes what concerns it
        asked += [{name: each} for name, each in value.items()]
    for each in asked:
        with contextlib.suppress(ChangeError):
            return changed(sensor, {effect.name: each})
    return None if on else sensor.model_copy(update={effect.name: off})


def together(scene: Scene, variants: Sequence[Variant], name: str) -> Variant:
    """All of those variants of a scene, each of one effect, at once."""
    sensors, keys = dict(enumerate(scene.sensor)), dict[str, Any]()
    for each in variants:
        (effect,) = each.effects
        if effect.startswith("["):
            keys[effect[1:-1]] = getattr(each.scene, effect[1:-1])
            continue
        for i in each.sensors:
            value = getattr(each.scene.sensor[i], effect)
            sensors[i] = sensors[i].model_copy(update={effect: value})
    effects = tuple(each.effects[0] for each in variants)
    found = _variant(scene, name, sensors, keys, effects=effects)
    return replace(found, sensors=frozenset().union(*(each.sensors for each in variants)))


def choices_of(scene: Scene) -> list[Variant]:
    """What a scene can choose besides effects: formats, sectors, periods, tracks on board."""
    sensors = dict(enumerate(scene.sensor))

    def scanned(which: Mapping[int, Sensor], **keys: Any) -> dict[int, Sensor]:
        """Sensors whose scans have other keys."""
        scans = {i: s.scan.model_copy(update=keys) for i, s in which.items()}
        return {i: s.model_copy(update={"scan": scans[i]}) for i, s in which.items()}

    choices: dict[str, dict[int, Sensor]] = {}
    names = {name for sensor in scene.sensor for name in sensor.formats} & FORMATS.keys()
    read_back = {f"{n} alone": n for n in sorted(names) if not FORMATS[n].facts.tells_tracks}
    for choice, name in read_back.items():
        has = {i: s for i, s in sensors.items() if name in s.formats}
        choices[choice] = {i: s.model_copy(update={"report": (name,)}) for i, s in has.items()}
    for many in (8, 32, 128):
        turning = {i: s for i, s in sensors.items() if s.scan.rotates and s.scan.sectors != many}
        choices[f"{many} sectors"] = scanned(turning, sectors=many)
    for factor in (0.5, 2.0):
        staring = choices[f"staring periods times {factor:g}"] = {}
        for i, s in sensors.items():
            if s.scan.kind == "staring":
                staring |= scanned({i: s}, period_s=max(s.scan.period_s * factor, 0.02))
    choices["tracks on board"] = {
        i: s.model_copy(update={"report": (*s.report, "tracks")})
        for i, s in sensors.items()
        if "tracks" in s.formats and "tracks" not in s.report
    }
    every = frozenset(sensors)
    return [
        Variant(name=CLOSED_FORM, scene=scene, sensors=every, closed_form=True),
        *(
            _variant(scene, name, others, read_back=read_back.get(name, ""))
            for name, others in choices.items()
            if others
        ),
    ]


CLOSED_FORM = "Pd of looks, in closed form"
COVER_NS = 5 * NS
NOTHING_READ = MeasuredPlots.of(())


class Run:
    """One run of a variant through the engine."""

    def __init__(self, variant: Variant, seed: int, start_utc_ns: int, duration_s: float) -> None:
        """Run it; raises `PlotfeedError`."""
        scene = variant.scene
        general = scene.scene.model_copy(update={"seed": seed})
        engine = Engine(scene.model_copy(update={"scene": general}), start_utc_ns)
        batches: list[Batch] = []
        spent_s, end_ns = 0.0, start_utc_ns + round(duration_s * NS)
        for t_ns in (*range(start_utc_ns + STRETCH_NS, end_ns, STRETCH_NS), end_ns):
            began_s = time.process_time()
            batches += engine.until(t_ns, messages=not variant.closed_form)
            spent_s += time.process_time() - began_s
        self.cost_s = spent_s / duration_s  # Processor seconds a second
        messages = (m for b in batches for some in b.messages for m in some)
        self.octets = sum(len(m.handed.payload) for m in messages)  # Of all messages
        names = frozenset(scene.fleet.names)
        rows = np.array([i for i, name in enumerate(engine.trajectories.names) if name in names])
        sensed = [_Sensed(engine, batches, i, rows) for i in range(len(scene.sensor))]
        figures = []
        for i, own in enumerate(sensed):
            read_back = variant.read_back if i in variant.sensors else ""
            found = own.pd_of_looks() if variant.closed_form else own.figures(read_back)
            figures.append([found.get(name, np.nan) for name in METRICS])
        self.figures = np.array(figures)  # By sensor, (sensors, metrics); NaN for what it has not
        # Of each sensor the (drone, stretch of 5 s) in which it plotted, and those in which its
        # plain tracker followed; and how often it could plot a drone within its range.
        self.seen, self.followed = [own.seen() for own in sensed], [own.followed for own in sensed]
        self.chances_of = [own.chances for own in sensed]
        # At the middles of stretches, where drones are: by them it is known what was to be seen.
        stretches = np.arange(-(-(end_ns - start_utc_ns) // COVER_NS))
        middles_ns = np.minimum(start_utc_ns + COVER_NS * stretches + COVER_NS // 2, end_ns)
        there = np.isfinite(engine.trajectories.positions_at(middles_ns)[:, rows, 0])
        k, d = np.nonzero(there)
        self.chances = _pairs(rows[d], k)


Pairs = frozenset[tuple[int, int]]


def _pairs(drone: Ints, number: Ints) -> Pairs:
    return frozenset(zip(drone.tolist(), number.tolist(), strict=True))


class _Sensed:
    """What one sensor, by its index, did in a run; figures are by the names of `METRICS`."""

    def __init__(self, engine: Engine, batches: Sequence[Batch], index: int, drones: Ints) -> None:
        self.engine, self.drones, self.start_ns = engine, drones, engine.start_utc_ns
        self.sensor = engine.scene.sensor[index]
        self.period_ns = self.sensor.scan.period_ns
        self.here = frame_at(engine.scene.scene.site, self.sensor.position_enu_m)
        # Batches with their rows that are sectors of it, in the order of time.
        self.sectors = [
            (batch, row)
            for batch in batches
            if batch.claims is None
            for row in np.flatnonzero(batch.sectors.sensor == index).tolist()
        ]
        parts = [b.plots.between(b.plots_by[row], b.plots_by[row + 1]) for b, row in self.sectors]
        self.plots = Plots.joined(parts or [NO_PLOTS])
        self.of_drones = self.plots.rows(np.isin(self.plots.drone, drones))
        # Drones that its plain tracker followed, with the stretches of 5 s.
        self.followed: Pairs = frozenset()
        # How often a drone was within its range at the middle of a scan.
        self.scans = len({int(b.sectors.scan[row]) for b, row in self.sectors})
        t_ns = self.start_ns + self.period_ns // 2 + self.period_ns * np.arange(self.scans)
        there = (
            engine.trajectories.positions_at(t_ns)[:, drones] if self.scans else np.zeros((0, 3))
        )
        self.chances = int(np.count_nonzero(self._within(there.reshape(-1, 3))))

    def _within(self, place_ecef_m: Floats) -> Bools:
        """Which places are within its range; not those that are none."""
        range_m = np.linalg.norm(self.here.from_ecef(place_ecef_m), axis=-1)
        return np.asarray(range_m <= getattr(self.sensor, "range_max_m", np.inf))

    def seen(self) -> Pairs:
        """Drones that it plotted, with the stretches of 5 s."""
        return _pairs(self.of_drones.drone, (self.of_drones.t_utc_ns - self.start_ns) // COVER_NS)

    def pd_of_looks(self) -> dict[str, float]:
        """Pd by its looks' own, in closed form."""
        missed: dict[tuple[int, int], float] = {}
        for batch, row in self.sectors:
            looks = batch.looks.between(batch.looks_by[row], batch.looks_by[row + 1])
            scan = int(batch.sectors.scan[row])
            for drone, pd in zip(looks.drone.tolist(), looks.pd.tolist(), strict=True):
                missed[drone, scan] = missed.get((drone, scan), 1.0) * (1.0 - pd)
        own = frozenset(self.drones.tolist())
        detected = sum(1.0 - q for (drone, _), q in missed.items() if drone in own)
        return {"pd": detected / self.chances} if self.chances else {}

    def figures(self, read_back: str) -> dict[str, float]:
        """What is compared, but for what the sensor has not; errors by a format, if one is told."""
        if not self.sectors:
            return {}
        of_drones, found = self.of_drones, dict[str, float]()
        if self.chances:
            scan = (of_drones.t_utc_ns - self.start_ns) // self.period_ns
            found["pd"] = len(_pairs(of_drones.drone, scan)) / self.chances
        found["alarms"] = (len(self.plots) - len(of_drones)) / self.scans
        found |= self._errors(self._read_back(read_back) if read_back else of_drones)
        outgoing = [one for batch, row in self.sectors for one in batch.messages[row]]
        gone = [one for one in outgoing if not one.fate and one.leaves_utc_ns != HELD_NS]
        if outgoing:
            found["lost"] = 1 - len(gone) / len(outgoing)
        if gone:
            delays_ns = [one.leaves_utc_ns - one.due_utc_ns for one in gone]
            found["delay_s"] = float(np.mean(delays_ns)) / NS
        return found | self._tracks()

    def _read_back(self, name: str) -> Any:
        """Plots of drones as whoever decodes the messages of a format has them."""
        parts, plots_in = [], FORMATS[name].plots_in
        if plots_in is None:
            return self.of_drones
        for batch, row in self.sectors:
            end_ns = int(batch.sectors.end_ns[row])
            read = [plots_in(one.handed.payload, end_ns) for one in batch.messages[row]]
            found = MeasuredPlots.joined([each for each in read if len(each)] or [NOTHING_READ])
            sent = batch.plots.between(batch.plots_by[row], batch.plots_by[row + 1])
            if len(found) != len(sent):
                return self.of_drones  # it leaves some out: whose is whose is not known
            parts.append(found.rows(np.isin(sent.drone, self.drones)))
        return MeasuredPlots.joined(parts or [NOTHING_READ])

    def _errors(self, read: Any) -> dict[str, float]:
        """Rms errors of what is measured, over plots of drones, at the times that are read."""
        if len(self.of_drones) < FEWEST_PLOTS:
            return {}
        t_ns, found = read.t_utc_ns.astype(np.int64), {}
        there = self.engine.trajectories.position_at(t_ns, self.of_drones.drone)
        true = enu_to_aer(self.here.from_ecef(there))
        for name, column in zip(("azimuth_deg", "elevation_deg", "range_m"), true, strict=True):
            difference = getattr(read, name) - column
            if name == "azimuth_deg":
                difference = wrap_180(difference)
            difference = difference[np.isfinite(difference)]
            if len(difference) >= FEWEST_PLOTS:
                found[name] = float(np.sqrt(np.mean(difference**2)))
        return found

    def _tracks(self) -> dict[str, float]:
        """GOSPA and completeness of a plain tracker that is given the plots, scan by scan."""
        if not np.isfinite(self.plots.range_m).any():
            return {}
        site = site_frame(self.engine.scene.scene.site)
        tracker = PlainTracks(self.engine.scene, self.sensor, site, by_sector=False)
        last_ns = max(int(batch.sectors.end_ns[row]) for batch, row in self.sectors)
        held: dict[int, tuple[int, Floats, Floats, bool]] = {}
        gospa, followed, drones = [], list[tuple[int, int]](), 0
        for begin_ns in range(self.start_ns, last_ns - self.period_ns + 1, self.period_ns):
            end_ns = begin_ns + self.period_ns
            in_scan = (self.plots.t_utc_ns >= begin_ns) & (self.plots.t_utc_ns < end_ns)
            told = tracker.take_plots(self.plots.rows(in_scan), begin_ns, end_ns)
            for j, track in enumerate(told.track.tolist()):
                place = told.position_enu_m[j], told.velocity_enu_m_s[j]
                held[track] = (end_ns, *place, bool(told.has_height[j]))
                if told.last[j]:
                    del held[track]
            ecef_m = self.engine.trajectories.positions_at(np.array([end_ns]))[0][self.drones]
            near = self._within(ecef_m)
            true_m = site.from_ecef(ecef_m[near])
            places = [at + v * ((end_ns - t_ns) / NS) for t_ns, at, v, _ in held.values()]
            axes = 3 if all(has_height for *_, has_height in held.values()) else 2
            tracks_m = np.array(places).reshape(-1, 3)
            apart = tracks_m[None, :, :axes] - true_m[:, None, :axes]
            score = set_score(np.linalg.norm(apart, axis=-1), CUTOFF_M)
            gospa.append(score.gospa_m())
            drones += len(true_m)
            stretch = (end_ns - 1 - self.start_ns) // COVER_NS
            followed += [(drone, stretch) for drone in self.drones[near][score.rows].tolist()]
        self.followed = frozenset(followed)
        found = {"gospa_m": float(np.mean(gospa))} if gospa else {}
        return found | ({"completeness": len(followed) / drones} if drones else {})


class Needs:
    """What was found of a scene: each variant compared with the scene as it is."""

    def __init__(
        self,
        scene: Scene,
        variants: Sequence[Variant],
        *,
        matters: float,
        runs: int | None,
        duration_s: float,
        seed: int,
        start_utc_ns: int,
        progress: Callable[[int, int], object] = lambda *_: None,
    ) -> None:
        """Compare each variant; raises `PlotfeedError`.

        `matters` is the share from which a change does. There are at most so many `runs` of each,
        or as many as `BUDGET_S` allows, with seeds from `seed` on; what is decided is not run
        again. `progress` is told how many runs were done, and how many variants are undecided.
        """
        if not scene.fleet.names:
            raise PlotfeedError(
                "the scene flies no drones, of which there would be something to say"
            )
        self.scene, self.matters, self.duration_s = scene.scene.name, matters, duration_s
        every = frozenset(range(len(scene.sensor)))
        base = Variant(name="as it is", scene=scene, sensors=every)
        as_it_is: list[Run] = []
        others: dict[str, list[Run]] = {each.name: [] for each in variants}
        open_, findings = list(variants), dict[str, Finding]()
        looks = [many for k in range(20) if (many := FIRST_RUNS * 2**k) < (runs or math.inf)]
        began_s, risk = time.process_time(), RISK
        if runs is not None:  # each look has as large a part of it, else half of what is left
            risk /= len(looks) + 1
        for k in count():
            as_it_is.append(Run(base, seed + k, start_utc_ns, duration_s))
            for each in open_:
                others[each.name].append(Run(each, seed + k, start_utc_ns, duration_s))
            progress(k + 1, len(open_))
            is_over = k + 1 >= FIRST_RUNS and time.process_time() - began_s > BUDGET_S
            is_last = is_over if runs is None else k + 1 == runs
            if k + 1 not in looks and not is_last:
                continue
            risk /= 2 if runs is None else 1
            for each in open_:
                pairs = list(zip(as_it_is, others[each.name], strict=True))
                findings[each.name] = Finding(each, scene, pairs, matters, risk)
            open_ = [each for each in open_ if findings[each.name].verdict == "undecided"]
            if is_last or not open_:
                break
        self.runs = len(as_it_is)
        # Seconds of processor a second of the scene.
        self.cost_s = float(np.median([run.cost_s for run in as_it_is]))
        self.findings = [findings[each.name] for each in variants]
        ids = [sensor.id for sensor in scene.sensor]
        # What is lost without each sensor, by its id.
        self.losses = {
            name: [Taken.of(as_it_is, kind, i) for kind in KINDS] for i, name in enumerate(ids)
        }
        # Runs of that duration after which all would probably be decided.
        self.runs_needed = max((each.runs_needed for each in self.findings), default=FIRST_RUNS)
        of_runs = np.array([run.figures for run in as_it_is])
        counted = of_runs[:, :, 0].std(axis=0, ddof=1)
        # Standard error of a Pd that is counted in one run, of the sensor where it is largest.
        self.counted_error = float(np.nan_to_num(counted).max())
        undecided = sum(each.cost[0] for each in self.findings if each.verdict == "undecided")
        # Minutes of processor in which that many runs would be done.
        self.minutes_needed = self.runs_needed * duration_s * self.cost_s * (1 + undecided) / 60
        figures = of_runs.mean(axis=0).tolist()
        self.as_it_is = {
            name: dict(zip(METRICS, of, strict=True)) for name, of in zip(ids, figures, strict=True)
        }

    @property
    def front(self) -> list[Finding]:
        """Findings than which none is both cheaper and smaller, the cheapest first."""
        costs = np.array([each.cost[0] for each in self.findings])
        sizes = np.array([each.size for each in self.findings])
        return [self.findings[i] for i in on_front(costs, sizes).tolist()]

    @property
    def head(self) -> str:
        """What was run, in a line."""
        return (
            f"{self.scene}: {self.runs} runs of {self.duration_s:g} s, each variant with the seeds "
            f"of the scene as it is; a change of {self.matters:.3g} matters"
        )


class Taken(NamedTuple):
    """A share of all (drone, stretch of 5 s): with all sensors, without one, the error of the loss.

    `error` is the standard error of the difference.
    """

    before: float
    after: float
    error: float

    @classmethod
    def of(cls, runs: Sequence[Run], kind: str, i: int) -> Taken:
        """What is lost without sensor i of what any sensor has `seen` or `followed`."""
        shares = []
        for run in runs:
            sets: list[frozenset[tuple[int, int]]] = getattr(run, kind)
            for some in (sets, sets[:i] + sets[i + 1 :]):
                union = frozenset[tuple[int, int]]().union(*some)
                shares.append(len(run.chances & union) / (len(run.chances) or 1))
        before, after = np.array(shares).reshape(-1, 2).T
        error = float((after - before).std(ddof=1)) / math.sqrt(len(runs))
        return cls(float(before.mean()), float(after.mean()), error)

    @property
    def texts(self) -> tuple[str, str, str]:
        """The shares, and the change with its standard error."""
        change = self.after - self.before
        told = f"{change:+.1%} ±{self.error:.1%}" if change else "0"
        return f"{self.before:.1%}", f"{self.after:.1%}", told


KINDS = ("seen", "followed")  # Of losses: by any sensor's plots, and by the tracker of any


class Finding:
    """What a variant changes by pairs of runs of one seed, the scene as it is first."""

    def __init__(
        self,
        variant: Variant,
        scene: Scene,
        pairs: Sequence[tuple[Run, Run]],
        matters: float,
        risk: float,
    ) -> None:
        before = np.array([run.figures for run, _ in pairs])
        after = np.array([run.figures for _, run in pairs])
        told = [
            (i, k, name)
            for i in sorted(variant.sensors)
            for k, name in enumerate(METRICS)
            if np.isfinite(before[:, i, k] + after[:, i, k]).all()
        ]
        self.variant, self.changes = variant, list[Change]()
        for i, k, name in told:
            sensor, one = scene.sensor[i], before[:, i, k]
            wholes = {
                "itself": abs(float(one.mean())),
                "plots": float(np.nansum(before[:, i, :2].mean(axis=0))),
                "period": sensor.scan.period_s,
            }
            differences = after[:, i, k] - one
            error = float(differences.std(ddof=1)) / math.sqrt(len(pairs))
            of = METRICS[name].share_of
            # A share that changes alike in all runs may do so by chance, unless it does not change:
            # then the same numbers were drawn, and nothing came of the effect.
            chances = sum(run.chances_of[i] for run, _ in pairs) if of == "chances" else 0
            least = -math.log(risk / len(told)) / chances if chances and differences.any() else 0.0
            figures = (*_interval(differences, risk / len(told), least), error)
            shares = np.array(figures) / (wholes.get(of, 1.0) or 1.0)
            change = Change(sensor.id, name, float(one.mean()), *figures, *shares.tolist())
            self.changes.append(change)
        furthest = [max(-c.share_low, c.share_high) for c in self.changes]
        words = ("missing", "no need") if variant.adds else ("needed", "can go")
        self.verdict = "undecided"
        if any(c.share_low > matters or c.share_high < -matters for c in self.changes):
            self.verdict = words[0]
        elif furthest and max(furthest) < matters:
            self.verdict = words[1]
        # Processor time beside that of the scene as it is, with its interval; 1 is the same.
        self.cost = _interval(np.array([other.cost_s / run.cost_s for run, other in pairs]), RISK)
        # Octets of all messages, likewise; they cost what sends and reads them.
        octets = [other.octets / run.octets if run.octets else 1.0 for run, other in pairs]
        self.octets = _interval(np.array(octets), RISK)
        self.runs = len(pairs)
        widest = max(((c.share_high - c.share_low) / 2 for c in self.changes), default=0.0)
        # Runs after which it is decided, or where it is not, would be by all likelihood: when the
        # widest interval is as narrow as the share that matters.
        self.runs_needed = len(pairs)
        if self.verdict == "undecided":
            self.runs_needed = max(len(pairs) + 1, math.ceil(len(pairs) * (widest / matters) ** 2))

    @property
    def largest(self) -> Change | None:
        """The change that a tracker would notice most, or where it is not known, might."""
        if self.verdict == "undecided":
            return max(self.changes, key=lambda c: max(-c.share_low, c.share_high), default=None)
        return self.most(*METRICS)

    def most(self, *metrics: str) -> Change | None:
        """The largest change of those figures, of all sensors; None where none has them."""
        of_these = (change for change in self.changes if change.metric in metrics)
        return max(of_these, key=lambda c: abs(c.share), default=None)

    @property
    def size(self) -> float:
        """The share of the largest change."""
        return abs(self.largest.share) if self.largest else 0.0


def _interval(values: Floats, risk: float, least: float = 0.0) -> tuple[float, float, float]:
    """The mean of independent values, and the interval that holds it but for that risk.

    It reaches that far to either side at least.
    """
    n, mean = len(values), float(values.mean())
    spread = float(values.std(ddof=1)) if np.ptp(values) else 0.0
    half = max(float(stdtrit(n - 1, 1 - risk / 2)) * spread / math.sqrt(n), least)
    return mean, mean - half, mean + half


def on_front(costs: Floats, sizes: Floats) -> Ints:
    """Rows of those than which none is both cheaper and smaller, the cheapest first."""
    order = np.lexsort((sizes, costs))
    best_before = np.minimum.accumulate(np.concatenate([[np.inf], sizes[order]]))[:-1]
    return order[sizes[order] < best_before]


GROUPS = {
    "needed": "Needed: without it, a tracker would notice",
    "can go": "Can go: without it, a tracker would notice nothing",
    "missing": "Missing: with it, a tracker would notice",
    "no need": "No need: with it, a tracker would notice nothing",
    "undecided": "Undecided: more runs, or longer ones, would tell",
}
SEED = 1


def print_needs(scene: Scene, settings: NeedsSettings) -> None:
    """Say what a scene needs and what it can leave out; raises `PlotfeedError`."""
    matters, asked = _share(settings.matters), {path: _rewriting(path) for path in settings.write}
    trees = [path.with_name(TREES) for path, verdict in asked.items() if verdict == "missing"]
    _check_files(settings, *asked, *trees)
    with TemporaryDirectory() as folder:
        found = _found(scene, variants_of(scene, Path(folder)), settings, matters)
    texts = {path: rewritten(scene, found, verdict) for path, verdict in asked.items()}
    if any((f.verdict, f.variant.name) == ("missing", "with [terrain]") for f in found.findings):
        texts |= dict.fromkeys(trees, trees_about(scene))
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    _tell(found, settings, _lines(found), [*texts], on_tracks=True)


def _rewriting(path: Path) -> str:
    """The verdict on what changes in a scene that is written there, by the end of the name."""
    for end, verdict in (("lean.toml", "can go"), ("full.toml", "missing")):
        if path.name.endswith(end):
            return verdict
    raise PlotfeedError(f"--write {path}: expected a name that ends in lean.toml or full.toml")


def print_chart(scene: Scene, settings: ChartSettings) -> None:
    """Chart the choices that a scene has, accuracy against speed; raises `PlotfeedError`."""
    _check_files(settings)
    variants = [*choices_of(scene), *(each for each in variants_of(scene) if not each.adds)]
    found = _found(scene, variants, settings, 0.02)
    _tell(found, settings, _choice_lines(found), [], on_tracks=False)


def _tell(
    found: Needs,
    settings: ChartSettings,
    lines: Iterator[str],
    written: list[Path],
    *,
    on_tracks: bool,
) -> None:
    if settings.chart is not None:
        draw(found, settings.chart, on_tracks=on_tracks)
        written.append(settings.chart)
    tell(as_values(found), lines, written, as_json=settings.as_json)


def _check_files(settings: ChartSettings, *others: Path) -> None:
    if settings.chart is not None:
        need_extra("matplotlib.figure", "a picture", "charts")
        others = settings.chart, *others
    for path in others:
        refuse_if_there(path, force=settings.force)


def _found(scene: Scene, variants: Sequence[Any], settings: ChartSettings, matters: float) -> Needs:
    keep_freed()  # as a session does
    began_s = time.monotonic()

    def progress(done: int, undecided: int) -> None:
        took_s = time.monotonic() - began_s
        most = "" if settings.runs is None else f" of {settings.runs}"
        runs = f"{done}{most} runs{' at most' if most else ''}"
        say(f"{runs}, {undecided} undecided, {took_s:.0f} s", err=True)

    return Needs(
        scene,
        variants,
        matters=matters,
        runs=settings.runs,
        duration_s=settings.duration,
        seed=SEED,
        start_utc_ns=scene.scene.start_utc_ns or START_UTC_NS,
        progress=progress,
    )


def _share(text: str) -> float:
    """A share such as 2% or 0.02."""
    plain, percent = text.removesuffix("%"), text.endswith("%")
    try:
        share = float(plain) / (100 if percent else 1)
    except ValueError:
        share = np.nan
    if not 0 < share < 1:
        raise PlotfeedError(f"--matters: expected a share such as 2% or 0.02, not {text!r}")
    return share


def as_values(found: Needs) -> dict[str, Any]:
    """Findings for JSON."""
    return {
        "scene": found.scene,
        "machine": {  # Where the times are from
            "processor": processor(),
            "cores": os.cpu_count(),
            "system": platform.system(),
            "python": platform.python_version(),
            "numpy": version("numpy"),
        },
        "matters": found.matters,
        "duration_s": found.duration_s,
        "runs": found.runs,
        "runs_needed": found.runs_needed,
        "processor_s_per_s": found.cost_s,
        "as_it_is": {name: dict(figures) for name, figures in found.as_it_is.items()},
        "findings": [
            {
                "variant": each.variant.name,
                "effects": list(each.variant.effects),
                "verdict": each.verdict,
                "processor": dict(zip(("ratio", "low", "high"), each.cost, strict=True)),
                "octets": dict(zip(("ratio", "low", "high"), each.octets, strict=True)),
                "runs": each.runs,
                "runs_needed": each.runs_needed,
                "changes": [change._asdict() for change in each.changes],
            }
            for each in found.findings
        ],
        "without_sensor": {
            name: {kind: loss._asdict() for kind, loss in zip(KINDS, of, strict=True)}
            for name, of in found.losses.items()
        },
    }


def change_text(change: Change | None) -> str:
    """A change in words, with its interval."""
    if change is None:
        return "nothing that could be compared"
    if not change.value and change.low == change.high:
        return "nothing at all"
    _, _, what, unit = METRICS[change.metric]
    after = change.before + change.value
    return (
        f"{change.sensor}: {what} {change.before:.3g}{unit} becomes {after:.3g}{unit}, "
        f"{change.share:+.1%} ({change.share_low:+.1%} to {change.share_high:+.1%})"
    )


def more_text(ratio: tuple[float, float, float]) -> str:
    """How much more than in the scene as it is, with its interval."""
    value, low, high = ratio
    if value == low == high:
        return f"{value - 1:+.0%}" if value != 1 else "the same"
    return f"{value - 1:+.0%} ({low - 1:+.0%} to {high - 1:+.0%})"


def _error_of(metric: str, found: Finding) -> str:
    """The largest change of a figure in per cent, with its standard error; a dash for none."""
    change = found.most(metric)
    if change is None:
        return "-"
    if not change.value and not change.error:
        return "0"
    return f"{100 * change.share:+.3g} ±{100 * change.share_error:.2g}"


VARIANT = TextColumn("", "variant.name")
CHANGE = TextColumn("what changes most (interval of 95 %)", lambda f: change_text(f.largest))
COST = TextColumn("processor time", lambda f: more_text(f.cost))
OCTETS = TextColumn("octets", lambda f: more_text(f.octets))
RUNS = TextColumn(
    "runs",
    lambda f: f"{f.runs}" if f.runs == f.runs_needed else f"{f.runs} of some {f.runs_needed:,}",
)


def _lines(found: Needs) -> Iterator[str]:
    """The groups, each with its largest changes first; what is lost without each sensor."""
    yield found.head
    for verdict, title in GROUPS.items():
        of = [each for each in found.findings if each.verdict == verdict]
        if of:
            rows = sorted(of, key=attrgetter("size"), reverse=True)
            yield from Table(title, (VARIANT, CHANGE, COST, RUNS), rows).lines()
    title = "All changes, per cent and standard error, of the sensor that changes most"
    columns = [
        TextColumn(each.head, partial(_error_of, name), "s") for name, each in METRICS.items()
    ]
    yield from Table(title, (VARIANT, *columns), found.findings).lines()
    losses = [
        (name, *(text for loss in of for text in loss.texts)) for name, of in found.losses.items()
    ]
    heads = ("without the sensor", "plotted", "after", "change", "tracked", "after", "change")
    title = "Sensors: the share of stretches of 5 s in which any plots a drone, or tracks it"
    yield from Table(title, of_cells(heads, "<>>>>>>"), losses).lines()
    yield ""
    runs = found.runs_needed
    yield (
        f"A second of the scene takes {1e3 * found.cost_s:.3g} ms of processor. All of this would "
        f"be decided by some {runs:,} runs of {found.duration_s:g} s, "
        f"{runs * found.duration_s / 60:,.0f} minutes of the scene: {found.minutes_needed:,.3g} "
        "minutes of processor."
    )


def _choice_lines(found: Needs) -> Iterator[str]:
    """All choices, the cheapest first; the front is marked."""
    front = {each.variant.name for each in found.front}
    columns = (
        TextColumn("", lambda each: "*" if each.variant.name in front else ""),
        VARIANT._replace(head="the scene"),
        COST,
        OCTETS,
        CHANGE,
    )
    yield found.head
    title = "Choices; * is on the front: none is both cheaper and nearer to the scene as it is"
    rows = sorted(found.findings, key=lambda each: each.cost[0])
    yield from Table(title, columns, rows).lines()
    yield ""
    yield f"As it is, a second of the scene takes {1e3 * found.cost_s:.3g} ms of processor."
    counted = found.counted_error
    yield (
        f"Pd by counting plots has a standard error of {counted:.2%} after one run, and of "
        f"{counted / math.sqrt(found.runs):.2%} after {found.runs}."
    )


def draw(found: Needs, path: Path, *, on_tracks: bool) -> None:
    """Draw what each variant changes against what it costs, with intervals, and the front.

    Of what a plain tracker makes, if asked for, or of what changes most. Beside choices stands how
    the error of a Pd that is counted falls with runs: they cost so many times one.
    """
    colours = {"needed": "#c2410c", "missing": "#1d4ed8", "undecided": QUIET}
    title = f"What it changes against what it costs: scene {found.scene}"
    with figure_of((9.0, 6.0), title) as figure:
        axes, labels = figure.subplots(), []
        for each in found.findings:
            change, (x, low, high) = (
                (each.most(*OF_TRACKS) if on_tracks else each.largest),
                each.cost,
            )
            if change is None:
                continue
            y = max(abs(change.share), 1e-4)
            half = (change.share_high - change.share_low) / 2
            spans = [[max(x - low, 0)], [max(high - x, 0)]], [[min(half, y * 0.9)], [half]]
            x_span, y_span = (np.nan_to_num(s, posinf=0.0) for s in spans)
            axes.errorbar([x], [y], xerr=x_span, yerr=y_span, color=QUIET, lw=0.8, zorder=1)
            axes.scatter([x], [y], s=36, color=colours.get(each.verdict, "#15803d"), zorder=3)
            labels.append((x, y, each.variant.name))
        if not on_tracks:
            front = [each for each in found.front if each.largest is not None]
            costs, sizes = (
                [each.cost[0] for each in front],
                [max(each.size, 1e-4) for each in front],
            )
            axes.step(costs, sizes, where="post", color="#1d4ed8", lw=1, alpha=0.6)
            times = np.arange(1, found.runs + 1)
            counted = np.maximum(found.counted_error / np.sqrt(times), 1e-4)
            axes.plot(
                times, counted, "o:", color=INK, ms=3, lw=1, label="Pd counted in so many runs"
            )
            axes.set_xscale("log")
            axes.legend(loc="upper right")
        axes.axhline(found.matters, color="#15803d", ls="--", lw=1)
        axes.set_yscale("log")
        axes.set_xlabel("processor time, times that of the scene as it is")
        what = "of tracks (GOSPA, drones followed)" if on_tracks else "of what a tracker sees"
        axes.set_ylabel(f"largest change {what}, as a share")
        axes.grid(visible=True, alpha=0.3)
        axes.margins(x=0.15)
        place_labels(figure, axes, labels, INK)
        save_picture(figure, path)


def rewritten(scene: Scene, found: Needs, verdict: str) -> str:
    """The scene's text without what can go, or with what is missing; raises `PlotfeedError`.

    What goes stays as a comment, below one that says what that changes; of what has no lines of its
    own, the comment says that.
    """
    if not scene.text:
        raise PlotfeedError("the scene has no text of its own, which could be written otherwise")
    lines = scene.text.splitlines()
    for each in found.findings:
        if each.verdict != verdict or len(each.variant.effects) != 1:
            continue
        (effect,), why = each.variant.effects, f"# {each.variant.name}: {change_text(each.largest)}"
        is_table, key = effect.startswith("["), effect.strip("[]")
        if verdict == "missing" and is_table:
            head = effect if key == "terrain" else f"[{effect}]"
            lines = with_table(lines, head, ordinary_world(scene)[key], why)
        elif verdict == "missing":
            sensors = each.variant.scene.sensor
            lines = with_key(
                lines, key, {i: _told(sensors[i], key) for i in each.variant.sensors}, why
            )
        else:
            left = without(lines, key, None if is_table else each.variant.sensors, why)
            stays = f"{why}; it stays, in a preset or in a line with other keys"
            lines = left if left != lines else [*lines, stays]
    text = "\n".join(lines) + "\n"
    parsed(text.encode(), scene.folder / "scene.toml")  # what does not load is not written
    return text


def _told(sensor: Sensor, effect: str) -> Any:
    """An effect that a sensor has by its usual value, as a scene tells it."""
    value = getattr(sensor, effect)
    if hasattr(value, "model_dump"):
        return value.model_dump(exclude_unset=True)
    return next(each.on for each in SENSOR_EFFECTS if each.name == effect)
