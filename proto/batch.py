"""plotfeed's own messages from structures of arrays, and plots from them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from google.protobuf.message import DecodeError as ProtobufDecodeError
from numpy.typing import NDArray

from plotfeed.models.state import FALSE_ALARM, Looks, Plots
from plotfeed.proto import plotfeed_pb2 as pb
from plotfeed.proto.errors import DecodeError
from plotfeed.proto.measured_plots import MeasuredPlots
from plotfeed.proto.units import decibels

_PLOT_COLUMNS = (
    "range_m",
    "azimuth_deg",
    "elevation_deg",
    "height_m",
    "bistatic_range_m",
    "amplitude_dbm",
    "sigma_range_m",
    "sigma_azimuth_deg",
    "sigma_elevation_deg",
    "sigma_bistatic_range_m",
    "covariance_east_m2",
    "covariance_north_m2",
    "covariance_east_north_m2",
)
_RATE_COLUMNS = ("range_rate_m_s", "sigma_range_rate_m_s")


def plot_batch(sensor: str, scan: int, sector: int, plots: Plots) -> bytes:
    """A serialised PlotBatch; what is NaN is left out."""
    batch = pb.PlotBatch(sensor=sensor, scan=scan, sector=sector)
    names = _PLOT_COLUMNS if plots.range_rate_m_s is None else _PLOT_COLUMNS + _RATE_COLUMNS
    columns = [(name, getattr(plots, name).tolist()) for name in names]
    columns.append(("snr_db", decibels(plots.snr).tolist()))
    for i, t_utc_ns in enumerate(plots.t_utc_ns.tolist()):
        known = {name: values[i] for name, values in columns if not math.isnan(values[i])}
        batch.plots.add(
            time_utc_ns=t_utc_ns,
            channel=int(plots.channel[i]),
            kind=plots.kind[i],
            identity=plots.identity[i],
            **known,
        )
    return batch.SerializeToString()


def ledger(
    sensor: str,
    scan: int,
    sector: int,
    *,
    looks: Looks,
    plots: Plots,
    drones: Sequence[str],
    sent: Sequence[pb.Sent],
    link: str = "",
) -> bytes:
    """A serialised Ledger; `drones` names the drones by index, `link` is its keys in JSON."""
    entry = pb.Ledger(sensor=sensor, scan=scan, sector=sector, messages=sent, link=link)
    if len(looks):
        entry.looks.extend(_looks(looks, drones))
    if len(plots):
        entry.plots.extend(_plot_truths(plots, drones))
        _add_range_rates(entry, plots)
        _add_merged_drones(entry, plots, drones)
    return entry.SerializeToString()


def _looks(looks: Looks, drones: Sequence[str]) -> Iterator[pb.Look]:
    columns = (
        looks.drone,
        looks.channel,
        looks.t_utc_ns,
        looks.range_m,
        looks.azimuth_deg,
        looks.elevation_deg,
        decibels(looks.snr),
        looks.pd,
        looks.detected,
    )
    for (
        drone,
        channel,
        t_utc_ns,
        range_m,
        azimuth_deg,
        elevation_deg,
        snr_db,
        pd,
        detected,
    ) in _rows(columns):
        yield pb.Look(
            drone=drones[drone],
            time_utc_ns=t_utc_ns,
            range_m=range_m,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            snr_db=snr_db,
            pd=pd,
            detected=detected,
            channel=channel,
        )


def _plot_truths(plots: Plots, drones: Sequence[str]) -> Iterator[pb.PlotTruth]:
    columns = (
        plots.drone,
        plots.t_utc_ns,
        plots.true_range_m,
        plots.true_azimuth_deg,
        plots.true_elevation_deg,
    )
    for drone, t_utc_ns, range_m, azimuth_deg, elevation_deg in _rows(columns):
        if drone == FALSE_ALARM:
            yield pb.PlotTruth(time_utc_ns=t_utc_ns)
            continue
        yield pb.PlotTruth(
            drone=drones[drone],
            time_utc_ns=t_utc_ns,
            range_m=range_m,
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
        )


def _add_range_rates(entry: pb.Ledger, plots: Plots) -> None:
    if plots.true_range_rate_m_s is None:
        return
    for truth, rate_m_s in zip(entry.plots, plots.true_range_rate_m_s.tolist(), strict=True):
        if not math.isnan(rate_m_s):
            truth.range_rate_m_s = rate_m_s


def _add_merged_drones(entry: pb.Ledger, plots: Plots, drones: Sequence[str]) -> None:
    if plots.merged_drones is None:
        return
    for truth, merged in zip(entry.plots, plots.merged_drones, strict=True):
        truth.merged_drones.extend(drones[drone] for drone in merged)


def _rows(columns: Sequence[NDArray[Any]]) -> Iterator[tuple[Any, ...]]:
    """Row by row, as numbers of Python's own, which protobuf takes faster than NumPy's."""
    return zip(*(column.tolist() for column in columns), strict=True)


def batch_in(payload: bytes) -> pb.PlotBatch:
    """Batch of plots of our own format; raises `DecodeError`."""
    try:
        return pb.PlotBatch.FromString(payload)
    except ProtobufDecodeError:
        raise DecodeError(f"{len(payload)} octets that are not a PlotBatch") from None


def plots_in_batch(payload: bytes, _near_utc_ns: int = 0) -> MeasuredPlots:
    """Plots of an encoded batch, whose times need none that is near; raises `DecodeError`."""
    return plots_of_batch(batch_in(payload))


def plots_of_batch(batch: pb.PlotBatch) -> MeasuredPlots:
    """Plots of a batch."""
    return MeasuredPlots.of(
        {
            "t_utc_ns": plot.time_utc_ns,
            "sensor": batch.sensor,
            "channel": plot.channel,
            **{field.name: value for field, value in plot.ListFields()},
        }
        for plot in batch.plots
    )
