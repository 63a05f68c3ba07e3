"""What a scene's sensors will do, before anything runs: Pd and errors against range, warnings."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np

from plotfeed.feeds.console.extras import check_picture, save_figure
from plotfeed.feeds.console.printed import say
from plotfeed.feeds.console.process import refuse_if_there
from plotfeed.feeds.engine.emulated_sensors import EmulatedSensors
from plotfeed.feeds.engine.scene_drones import (
    launch,
    signature_of,
    trajectories_of,
    usual_signature,
)
from plotfeed.feeds.engine.visibility import EMITS_NOTHING, SEEN_PD, Outlook, not_emitted
from plotfeed.feeds.engine.world import World
from plotfeed.feeds.scene.fields import Site, geodetic, site_frame
from plotfeed.feeds.scene.problems import Problem
from plotfeed.feeds.scene.scene import Scene, SceneError, load
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.feeds.scene.sensors.effect_keys import effects_named
from plotfeed.feeds.scene.sensors.mount_keys import mount_of
from plotfeed.models.frames import enu_to_aer, geodetic_to_ecef
from plotfeed.models.sensors.sensor_model import Prediction, SensorModel, Targets
from plotfeed.models.state import Floats, Signature, Signatures
from plotfeed.proto.errors import PlotfeedError
from plotfeed.proto.units import decibels

ROWS = 10
DEFAULT_HEIGHT_M = 50.0
DEFAULT_SPEED_M_S = 15.0
RANGES_SEARCHED = 2000
# Between the noise of receivers and their overload: an ideal converter of 16 bits has 98 dB.
LOUDEST_SNR_DB = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TestTarget:
    """The target that the tables are for: what of it can be sensed, on what line it comes."""

    signature: Signature
    azimuth_deg: float  # From the site; it comes straight in
    above_site_m: float
    speed_m_s: float = DEFAULT_SPEED_M_S


def print_check(
    path: Path,
    *,
    rcs_m2: float | None,
    as_json: bool,
    chart: Path | None = None,
    force: bool = False,
) -> None:
    """Print what `report` finds, as tables or as JSON, and draw it if there is a place to.

    Raises `PlotfeedError`, also where a picture is and nobody says to replace it; what is wrong
    with a scene is in the JSON, too.
    """
    if chart is not None:
        check_picture(chart)
        refuse_if_there(chart, force=force)
    try:
        scene = load(path)
        found = report(scene, rcs_m2)
    except PlotfeedError as error:
        if as_json:
            say(json.dumps({"file": str(path), "problems": _problems(error)}))
        raise
    if chart is not None:
        draw_predictions(curves(scene, rcs_m2), chart)
    if as_json:
        say(json.dumps({"file": str(path), "problems": [], **found}))
        return
    say(f"{found['scene']}: {len(scene.sensor)} sensor(s), {found['drones']} drone(s)")
    above_m = found["site"]
    say(
        f"the site is {above_m['height_m']:.1f} m above the ellipsoid, "
        f"{above_m['height_msl_m']:.1f} m above mean sea level"
    )
    lines = [f"  warning: {text}" for text in found["warnings"]]
    lines += visibility_lines(found["visibility"])
    for line in chain(lines, *map(table_lines, found["sensors"])):
        say(line)


def _problems(error: PlotfeedError) -> list[dict[str, Any]]:
    if isinstance(error, SceneError):
        return [problem._asdict() for problem in error.located]
    return [Problem(None, "", None, line)._asdict() for line in str(error).split("\n")]


def report(scene: Scene, rcs_m2: float | None = None) -> dict[str, Any]:
    """Tables and warnings of every sensor; raises `PlotfeedError` for a file without use."""
    scene.sea_level()
    trajectories = trajectories_of(scene)
    launch(scene, trajectories, 0)
    sensors = EmulatedSensors(scene, trajectories)  # what no session could encode is no scene
    target, site = scene_target(scene, rcs_m2), scene.scene.site
    outlook = Outlook(scene, sensors, trajectories)
    undulation_m = scene.sea_level().undulation_m(site.latitude_deg, site.longitude_deg)
    return {
        "scene": scene.scene.name,
        "site": {"height_m": site.height_m, "height_msl_m": site.height_m - float(undulation_m)},
        "drones": len(scene.fleet.names),
        "warnings": [*sensors.world.doubts, *outlook.doubts(outlook.drones)],
        "visibility": visibility(scene, outlook),
        "sensors": [_report_of(scene, sensors.world, s, target) for s in scene.sensor],
    }


def curves(scene: Scene, rcs_m2: float | None, points: int = 400) -> dict[str, Any]:
    """Ranges and predictions of every sensor, by its id."""
    target = scene_target(scene, rcs_m2)
    world = World(scene)
    return {s.id: _predicted(s, world.model_of(s), target, points) for s in scene.sensor}


def scene_target(scene: Scene, rcs_m2: float | None) -> TestTarget:
    """The scene's first drone, on the line from where it starts to the site."""
    drone = next(iter(scene.fleet.drones), None)
    azimuth_deg, above_site_m = 0.0, DEFAULT_HEIGHT_M
    if drone is not None and drone.path:
        place = geodetic(scene.scene.site, drone.path[0])
        start_enu_m = site_frame(scene.scene.site).from_ecef(geodetic_to_ecef(*place))
        azimuth_deg = float(np.nan_to_num(enu_to_aer(start_enu_m)[0]))
        above_site_m = float(place[2]) - scene.scene.site.height_m
    signature = usual_signature(scene) if drone is None else signature_of(scene, drone)
    return TestTarget(
        signature=signature if rcs_m2 is None else replace(signature, rcs_m2=rcs_m2),
        azimuth_deg=azimuth_deg,
        above_site_m=above_site_m,
        speed_m_s=drone.speed_m_s if drone and drone.speed_m_s else DEFAULT_SPEED_M_S,
    )


def _report_of(scene: Scene, world: World, sensor: Sensor, target: TestTarget) -> dict[str, Any]:
    """A sensor's table and warnings where it stands."""
    found = sensor_report(scene.scene.site, sensor, target, world.model_of(sensor))
    found["effects"] |= effects_named(scene)
    found["warnings"] += world.warnings(sensor)
    return found


def sensor_report(
    site: Site, sensor: Sensor, target: TestTarget, model: SensorModel | None = None
) -> dict[str, Any]:
    """One sensor's table and warnings, in free space unless its model says otherwise."""
    model = model or sensor.model(site)
    ranges_m, predicted = _predicted(sensor, model, target, ROWS)
    fine_m, fine = _predicted(sensor, model, target, RANGES_SEARCHED)
    reached = np.flatnonzero(fine.pd >= 0.8)
    lacking = not_emitted(sensor, Signatures.of_one(target.signature))
    hint = ": give drones [[drone.emitters]]; those of telemetry bring theirs"
    hint *= lacking == EMITS_NOTHING
    return {
        "id": sensor.id,
        "type": sensor.type,
        "sac": sensor.sac,
        "sic": sensor.sic,
        "target": _described(target.signature, sensor),
        "range_at_pd_80_percent_m": float(fine_m[reached[-1]]) if len(reached) else None,
        "false_alarms_per_scan": model.false_alarms_per_scan,
        "effects": effects_named(sensor),
        "events": [event.model_dump(exclude_none=True) for event in sensor.event],
        "table": _rows(ranges_m, predicted),
        "warnings": [
            *sensor.warnings(site),
            *([f"the target {lacking}, so it sees nothing{hint}"] if lacking else []),
            *_loud(ranges_m, predicted),
        ],
    }


def _loud(ranges_m: Floats, predicted: Prediction) -> list[str]:
    """A warning of signals that no receiver has."""
    snr_db = decibels(predicted.snr)
    if not (snr_db > LOUDEST_SNR_DB).any():
        return []
    worst = int(np.nanargmax(snr_db))
    return [
        f"the SNR is {snr_db[worst]:.0f} dB at {ranges_m[worst] / 1000:.3g} km, where receivers "
        f"have some {LOUDEST_SNR_DB:g} dB from noise to overload: is a power, gain, time or "
        "frequency in another unit?"
    ]


def _described(signature: Signature, sensor: Sensor) -> str:
    """What of the target sensors can sense, in words; its size is told of cameras."""
    parts = [f"{signature.size_m:g} m across"] if sensor.sapient_type == "CAMERA" else []
    if np.isfinite(signature.rcs_m2):
        parts.append(f"{signature.rcs_m2:g} m2")
    if np.isfinite(signature.sound_power_db):
        parts.append(f"{signature.sound_power_db:g} dB")
    parts.extend(f"{e.eirp_dbm:g} dBm at {e.frequency_hz / 1e6:g} MHz" for e in signature.emitters)
    return ", ".join(parts) or "nothing to sense"


def _predicted(
    sensor: Sensor, model: SensorModel, target: TestTarget, points: int
) -> tuple[Floats, Prediction]:
    """What to expect at equal steps of range from the sensor, up to its instrumented one."""
    ranges_m = np.linspace(0, sensor.range_max_m, points + 1)[1:]
    return ranges_m, model.predict(_targets_at(sensor, target, ranges_m))


def _targets_at(sensor: Sensor, target: TestTarget, ranges_m: Floats) -> Targets:
    """The target at these slant ranges, in the height that it flies at where that can be."""
    above_m = target.above_site_m - sensor.position_enu_m[2]
    up_m = np.clip(above_m, -ranges_m, ranges_m)
    ground_m = np.sqrt(ranges_m**2 - up_m**2)
    azimuth = np.radians(target.azimuth_deg)
    enu_m = np.stack([ground_m * np.sin(azimuth), ground_m * np.cos(azimuth), up_m], axis=-1)
    return Targets.of_one(target.signature, enu_m, -target.speed_m_s * enu_m / ranges_m[:, None])


def _rows(ranges_m: Floats, predicted: Prediction) -> list[dict[str, float | None]]:
    """The table; what a sensor does not measure is None."""
    columns = {"range_m": ranges_m, "snr_db": decibels(predicted.snr)}
    columns |= {f.name: getattr(predicted, f.name) for f in fields(predicted) if f.name != "snr"}
    columns = {name: column for name, column in columns.items() if column is not None}
    return [
        {
            name: float(column[i]) if np.isfinite(column[i]) else None
            for name, column in columns.items()
        }
        for i in range(len(ranges_m))
    ]


def table_lines(sensor: dict[str, Any]) -> list[str]:
    """One sensor's report as text."""
    furthest_m = sensor["range_at_pd_80_percent_m"]
    reach = "nowhere" if furthest_m is None else f"to {furthest_m / 1000:.2f} km"
    heading = (
        f"{sensor['id']} ({sensor['type']}, SAC {sensor['sac']} SIC {sensor['sic']}), "
        f"target of {sensor['target']}: "
        f"Pd 0.8 {reach}, {sensor['false_alarms_per_scan']:.3g} false alarms a scan"
    )
    named = [
        f"  with {name}: {_keys_in_words(keys) or 'by its cells and beams'}"
        for name, keys in sensor["effects"].items()
    ]
    for event in sensor["events"]:
        until = f" to {event['to_s']:g} s" if "to_s" in event else " on"
        keys = _keys_in_words(event["set"])
        named.append(f"  from {event['from_s']:g} s{until}, not in this table: {keys}")
    return ["", heading, *named, *row_lines(sensor, sensor["id"])]


def _keys_in_words(keys: dict[str, Any]) -> str:
    """Keys and values, those of tables after their own key."""
    parts = []
    for key, value in keys.items():
        match value:
            case dict():
                parts.append(f"{key} ({_keys_in_words(value)})")
            case list() | tuple():
                parts.append(f"{key} of {len(value)} values")
            case float() | int():
                parts.append(f"{key} {value:g}")
            case _:
                parts.append(f"{key} {value}")
    return ", ".join(parts)


def row_lines(sensor: dict[str, Any], name: str) -> list[str]:
    """The table of a report of the sensor of that name, and its warnings, as text."""
    heading = "  range km   SNR dB      Pd   rms range m   azimuth deg   elevation deg"
    measures_rates = "sigma_range_rate_m_s" in sensor["table"][0]
    lines = [heading + "   range rate m/s" * measures_rates]
    for row in sensor["table"]:
        cells = [
            _cell(row["range_m"] / 1000, 10, 2),
            _cell(row["snr_db"], 9, 1),
            _cell(row["pd"], 8, 3),
            _cell(row["sigma_range_m"], 14, 2),
            _cell(row["sigma_azimuth_deg"], 14, 3),
            _cell(row["sigma_elevation_deg"], 16, 3),
            _cell(row["sigma_range_rate_m_s"], 17, 3) if measures_rates else "",
        ]
        lines.append("".join(cells))
    return lines + [f"  warning: {name}: {text}" for text in sensor["warnings"]]


def _cell(value: float | None, width: int, digits: int) -> str:
    return "-".rjust(width) if value is None else f"{value:{width}.{digits}f}"


def draw_predictions(curves: dict[str, Any], path: Path) -> None:
    """Pd, and rms errors of range and azimuth, against range; PNG, SVG or PDF by the name."""
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(15, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for name, (ranges_m, predicted) in curves.items():
        ranges_km = ranges_m / 1000
        axes[0].plot(ranges_km, predicted.pd, label=name)
        for axis, sigma in zip(
            axes[1:], (predicted.sigma_range_m, predicted.sigma_azimuth_deg), strict=True
        ):
            if np.isfinite(sigma).any():
                axis.semilogy(ranges_km, sigma, label=name)
    for axis, title in zip(
        axes,
        ("probability of detection", "rms range error, m", "rms azimuth error, degrees"),
        strict=True,
    ):
        axis.set_title(title)
        axis.set_xlabel("range, km")
        axis.grid(visible=True, alpha=0.3)
        axis.legend()
    save_figure(figure, path, dpi=120)


MOST_DRONES = 12  # Told one by one, those first that nobody sees
MOST_SENSORS = 8  # Told one by one of a drone
MOST_SPANS = 3  # Told one by one of a sensor and a drone


def visibility(scene: Scene, outlook: Outlook) -> dict[str, Any]:
    """Who sees each drone that is looked at, from when to when and with what Pd, or why not."""
    names, repeats = outlook.drones, {each.id for each in scene.fleet.drones if each.repeat}
    views = {drone: list(of) for drone, of in groupby(outlook.sightlines(names), lambda v: v.drone)}
    turned = {s.id for s in scene.sensor if (m := mount_of(s)) is not None and m.look_at is None}
    found = []
    for drone in names:
        (from_s, to_s), mine = outlook.span_s(drone), views.get(drone, [])
        hindered = [(v.hindrance, v.sensor) for v in mine if v.hindrance is not None]
        told = {
            "drone": drone,
            "from_s": from_s,
            "to_s": to_s,
            "repeats": drone in repeats,
            "seen_by": [
                {
                    "sensor": v.sensor,
                    "spans_s": v.spans_s,
                    "pd_min": v.pd[0],
                    "pd_max": v.pd[1],
                    "if_turned": v.sensor in turned,
                }
                for v in mine
                if v.hindrance is None
            ],
            "not_seen_by": [
                {"sensor": sensor, "why": hindrance.kind, "text": hindrance.text}
                for hindrance, sensor in sorted(hindered, reverse=True)
            ],
        }
        found.append(told)
    times = outlook.times(len(names))
    return {"pd_at_least": SEEN_PD, "times": times, "of": len(scene.fleet.names), "drones": found}


def visibility_lines(found: dict[str, Any]) -> Iterator[str]:
    """Lines to read of what `visibility` has found."""
    drones, of = found["drones"], found["of"]
    if not drones:
        return
    which = "" if len(drones) == of else f", {len(drones)} of {of} drones"
    yield (
        f"\nwho sees the drones, with a Pd of {found['pd_at_least']:g} or more at some of "
        f"{found['times']} times of each flight{which}:"
    )
    shown = sorted(drones, key=lambda told: bool(told["seen_by"]))[:MOST_DRONES]
    for told in shown:
        again = ", and again" if told["repeats"] else ""
        yield f"  {told['drone']}, from {told['from_s']:.0f} to {told['to_s']:.0f} s{again}:" + (
            "" if told["seen_by"] else " no sensor sees it"
        )
        for view in told["seen_by"][:MOST_SENSORS]:
            spans = [f"{a:.0f} to {b:.0f} s" for a, b in view["spans_s"]]
            more = [f"{len(spans) - MOST_SPANS} more"] if spans[MOST_SPANS:] else []
            pds = dict.fromkeys(f"{view[name]:.2f}" for name in ("pd_min", "pd_max"))
            there = " if it is turned there" * view["if_turned"]
            when = ", ".join(spans[:MOST_SPANS] + more)
            yield f"    {view['sensor']}: {when}, Pd {' to '.join(pds)}{there}"
        if more := told["seen_by"][MOST_SENSORS:]:
            yield f"    and {len(more)} sensors more"
        for view in told["not_seen_by"][:MOST_SENSORS]:
            yield f"    {view['sensor']}: not, {view['why']}: {view['text']}"
        if more := told["not_seen_by"][MOST_SENSORS:]:
            whys = Counter(view["why"] for view in more).most_common()
            yield f"    not {len(more)} more: {', '.join(f'{why} {n}' for why, n in whys)}"
    if more := drones[len(shown) :]:
        yield f"  and {len(more)} more: --json has them"
