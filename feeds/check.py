"""What a scene's sensors will do, before anything runs: Pd and errors against range, warnings."""

from __future__ import annotations

import json
from typing import Any

import click
import numpy as np

from plotfeed.feeds.fleet import launch
from plotfeed.feeds.scene import RotatingScan, Scene, Sensor
from plotfeed.feeds.sensors import active_radar
from plotfeed.models.active_radar import ActiveRadar
from plotfeed.models.prediction import pd_at, range_of_pd_m, rms_errors
from plotfeed.models.truth import Trajectories
from plotfeed.proto.asterix.plots import RHO_LSB_M
from plotfeed.proto.batch import decibels

ROWS = 10


def print_check(scene: Scene, rcs_m2: float | None, *, as_json: bool) -> None:
    """Print what `report` finds, as tables or as JSON."""
    found = report(scene, rcs_m2)
    if as_json:
        click.echo(json.dumps(found))
        return
    click.echo(f"{found['scene']}: {len(scene.sensor)} sensor(s), {found['drones']} drone(s)")
    for sensor in found["sensors"]:
        for line in _table(sensor):
            click.echo(line)


def report(scene: Scene, rcs_m2: float | None = None) -> dict[str, Any]:
    """Tables and warnings of every sensor; raises `PlotfeedError` if a flight cannot be flown."""
    launch(scene, Trajectories(stale_after_s=scene.telemetry.stale_after_s), 0)
    if rcs_m2 is None:
        stated = [d.rcs_m2 for d in scene.drone if d.rcs_m2 is not None]
        rcs_m2 = min(stated, default=scene.telemetry.rcs_m2)
    return {
        "scene": scene.scene.name,
        "drones": len(scene.drone),
        "sensors": [_sensor(sensor, rcs_m2) for sensor in scene.sensor],
    }


def _sensor(sensor: Sensor, rcs_m2: float) -> dict[str, Any]:
    radar = active_radar(sensor)
    ranges_m = _ranges(radar)
    snr = radar.mean_snr(ranges_m, np.full(len(ranges_m), rcs_m2))
    sigmas = rms_errors(radar, snr)
    columns = {
        "range_m": ranges_m,
        "snr_db": decibels(snr),
        "pd": pd_at(radar, ranges_m, rcs_m2),
        "sigma_range_m": sigmas[0],
        "sigma_azimuth_deg": sigmas[1],
        "sigma_elevation_deg": sigmas[2],
    }
    return {
        "id": sensor.id,
        "type": sensor.type,
        "rcs_m2": rcs_m2,
        "gain_rx_dbi": radar.gain_rx_dbi,
        "range_at_pd_80_percent_m": range_of_pd_m(radar, 0.8, rcs_m2),
        "resolution_cells": radar.resolution_cells,
        "false_alarms_per_scan": radar.resolution_cells * radar.pfa,
        "table": [dict(zip(columns, row, strict=True)) for row in _rows(columns)],
        "warnings": _warnings(sensor, radar, float(sigmas[0].min())),
    }


def _ranges(radar: ActiveRadar) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Equal steps up to the instrumented range, from beyond the blind one."""
    steps = np.linspace(0, radar.range_max_m, ROWS + 1)[1:]
    return steps[steps >= radar.range_min_m]


def _rows(columns: dict[str, Any]) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack(list(columns.values())).tolist()
    return rows


def _warnings(sensor: Sensor, radar: ActiveRadar, best_sigma_range_m: float) -> list[str]:
    warnings = []
    if isinstance(sensor.scan, RotatingScan):
        beam_deg = min(sensor.receive_beams * sensor.azimuth_beamwidth_deg, 360.0)
        on_target_s = sensor.scan.period_s * beam_deg / 360
        if radar.integration_s > on_target_s:
            warnings.append(
                f"integration_s is {radar.integration_s:g}, but the beam is on a target for "
                f"{on_target_s:.3g} s of a turn: integrate less, turn slower, or add receive_beams"
            )
    added_m = RHO_LSB_M / np.sqrt(12)
    if "asterix-048" in sensor.report and added_m > best_sigma_range_m / 2:
        warnings.append(
            f"asterix-048 counts range in steps of {RHO_LSB_M:.3g} m, an error of {added_m:.2g} m "
            f"beside the radar's own of {best_sigma_range_m:.2g} m where it is best"
        )
    return warnings


def _table(sensor: dict[str, Any]) -> list[str]:
    lines = [
        "",
        f"{sensor['id']} ({sensor['type']}), target of {sensor['rcs_m2']:g} m2: "
        f"Pd 0.8 at {sensor['range_at_pd_80_percent_m'] / 1000:.2f} km, "
        f"{sensor['false_alarms_per_scan']:.3g} false alarms a scan",
        "  range km   SNR dB      Pd   rms range m   azimuth deg   elevation deg",
    ]
    lines.extend(
        f"{row['range_m'] / 1000:10.2f}{row['snr_db']:9.1f}{row['pd']:8.3f}"
        f"{row['sigma_range_m']:14.2f}{row['sigma_azimuth_deg']:14.3f}"
        f"{row['sigma_elevation_deg']:16.3f}"
        for row in sensor["table"]
    )
    lines.extend(f"  warning: {text}" for text in sensor["warnings"])
    return lines
