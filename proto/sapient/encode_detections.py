"""DetectionReports: one for each plot, with names of their own and where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sapient_msg.bsi_flex_335_v2_0.detection_report_pb2 import DetectionReport
from sapient_msg.bsi_flex_335_v2_0.location_pb2 import Location
from sapient_msg.bsi_flex_335_v2_0.range_bearing_pb2 import RangeBearing

from plotfeed.models.state import Columns, Floats, Plots
from plotfeed.proto.errors import EncodeError
from plotfeed.proto.sapient.encode_node import DEG_M, ELLIPSOID, LAT_LNG, TRUE_NORTH, Node
from plotfeed.proto.sapient.envelope import (
    MAX_IDS,
    Ulids,
    check_number,
    check_text,
    envelope,
    measured,
    set_stamp,
    stamp_ns,
)
from plotfeed.proto.units import with_rounding

MAX_RANGE_M = 1e9
MAX_ERROR_DEG = 360.0
JUST_BELOW_360 = 359.99999999999994  # the last float64 before it


@dataclass(frozen=True, kw_only=True)
class Positions(Columns):
    """Where plots are on the Earth, with the errors of that; NaN for those without a place.

    A plot that has none is told as range and bearing, as far as it has these.
    """

    longitude_deg: Floats
    latitude_deg: Floats
    height_m: Floats
    sigma_longitude_deg: Floats
    sigma_latitude_deg: Floats
    sigma_height_m: Floats


class Locations:
    """The places of some plots, ready to be written one after the other."""

    def __init__(self, plots: Plots, positions: Positions | None) -> None:
        """Raises `EncodeError`."""
        self._polar = _checked(
            ("azimuth", plots.azimuth_deg, 0.0, JUST_BELOW_360),
            ("elevation", plots.elevation_deg, -90.0, 90.0),
            ("range", plots.range_m, 0.0, MAX_RANGE_M),
            ("azimuth_error", plots.sigma_azimuth_deg, 0.0, MAX_ERROR_DEG),
            ("elevation_error", plots.sigma_elevation_deg, 0.0, MAX_ERROR_DEG),
            ("range_error", plots.sigma_range_m, 0.0, MAX_RANGE_M),
        )
        self._geodetic = positions and _checked(
            ("x", positions.longitude_deg, -180.0, 180.0),
            ("y", positions.latitude_deg, -90.0, 90.0),
            ("z", positions.height_m, -MAX_RANGE_M, MAX_RANGE_M),
            ("x_error", positions.sigma_longitude_deg, 0.0, MAX_ERROR_DEG),
            ("y_error", positions.sigma_latitude_deg, 0.0, MAX_ERROR_DEG),
            ("z_error", positions.sigma_height_m, 0.0, MAX_RANGE_M),
        )

    def write(self, i: int, report: DetectionReport) -> None:
        """Give a report the place of plot i, whatever it had before."""
        if self._geodetic and self._geodetic[0][1][i] is not None:
            location = report.location
            location.coordinate_system, location.datum = LAT_LNG, ELLIPSOID
            _write(location, self._geodetic, i)
        else:
            bearing = report.range_bearing
            bearing.coordinate_system, bearing.datum = DEG_M, TRUE_NORTH
            _write(bearing, self._polar, i)


_Values = list[tuple[str, list[float | None]]]


def _checked(*columns: tuple[str, Floats, float, float]) -> _Values:
    return [(column[0], measured(*column)) for column in columns]


def _write(place: Location | RangeBearing, columns: _Values, i: int) -> None:
    for name, values in columns:
        value = values[i]
        if value is None:
            place.ClearField(name)
        else:
            setattr(place, name, value)


SNR, AGE, BISTATIC_RANGE, TRANSMITTER = "SNR", "age", "bistatic range", "transmitter"
# Types of object_info; as track_info a consumer would take the plot for a track.
RANGE_RATE, BISTATIC_RANGE_RATE = "range rate", "bistatic range rate"

MAX_SNR = 1e30
MAX_RATE_M_S = 1e9
# Of metres and metres a second in texts of object_info, whose errors hold this rounding.
RANGE_DECIMALS, RATE_DECIMALS = 2, 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Manner:
    """What is said of every detection, and what of each."""

    detection_confidence: float | None = None
    # The class of what the sensor does not classify; of what it does, the class above.
    default_class: str | None = None
    class_confidence: float = 1.0
    # Band of a receiver: each detection is a signal, somewhere in it.
    band_hz: tuple[float, float] | None = None
    transmitters: tuple[str, ...] = ()  # Transmitters of a bistatic radar, by channel
    tells_age: bool = False  # Whether the time from measurement to timestamp is told


class DetectionEncoder:
    """Serialises the plots of a sensor. Numbers are checked, for the message classes check none."""

    def __init__(self, node: Node, manner: Manner) -> None:
        self._node = node
        self._classes = frozenset(node.classes)
        self._manner = manner
        self._message = envelope(node.node_id, 0)
        self._report = self._message.detection_report
        check_number("class confidence", manner.class_confidence, 0, 1)
        if manner.default_class is not None:
            check_text("class", manner.default_class)
        if manner.detection_confidence is not None:
            check_number("detection_confidence", manner.detection_confidence, 0, 1)
            self._report.detection_confidence = manner.detection_confidence
        if manner.band_hz is not None:
            low_hz, high_hz = manner.band_hz
            check_number("start_frequency", low_hz, 0, high_hz)
            check_number("stop_frequency", high_hz, low_hz, 1e15)
        self._kind: tuple[str, float] | None = None

    def messages(
        self,
        t_utc_ns: int,
        plots: Plots,
        positions: Positions | None = None,
        confidence: Floats | None = None,
    ) -> list[bytes]:
        """Serialised SapientMessages, one a plot, all stamped that time; raises `EncodeError`.

        `confidence` is that of each detection, where the manner has none for all.
        """
        if not len(plots):
            return []
        confidences = None
        if confidence is not None:
            confidences = measured("detection_confidence", confidence, 0, 1)
        if 2 * len(plots) > MAX_IDS:
            raise EncodeError(f"{len(plots)} plots at one time", field="report_id")
        set_stamp(self._message, t_utc_ns)
        ids = Ulids(self._node.seed, self._node.sensor, "detections", stamp_ns(t_utc_ns))
        locations = Locations(plots, positions)
        infos = self._infos(t_utc_ns, plots)
        amplitudes_dbm = self._amplitudes_dbm(plots)
        probabilities = self._class_confidences(plots)
        report = self._report
        encoded = []
        for i, (kind, identity) in enumerate(zip(plots.kind, plots.identity, strict=True)):
            report.report_id = ids[2 * i]
            report.object_id = ids[2 * i + 1]
            if confidences is not None and (found := confidences[i]) is not None:
                report.detection_confidence = found
            locations.write(i, report)
            self._classify(kind, probabilities[i])
            self._fill_infos(infos, i)
            if identity:
                report.id = identity
            else:
                report.ClearField("id")
            self._fill_signal(amplitudes_dbm[i])
            encoded.append(self._message.SerializeToString())
        return encoded

    def _amplitudes_dbm(self, plots: Plots) -> list[float | None]:
        if self._manner.band_hz is None:
            return [None] * len(plots)
        return measured("amplitude", plots.amplitude_dbm, -1000, 1000)

    def _class_confidences(self, plots: Plots) -> list[float]:
        """Confidences that the sensor states, and the scene's for what it states none of."""
        stated = plots.kind_probability
        if stated is None:
            return [self._manner.class_confidence] * len(plots)
        found = measured("class confidence", stated, 0, 1)
        return [self._manner.class_confidence if p is None else p for p in found]

    def _classify(self, kind: str, confidence: float) -> None:
        """The sensor's own class below the scene's, or either alone; only what is registered."""
        if kind not in self._classes:
            kind, confidence = "", self._manner.class_confidence
        if (kind, confidence) == self._kind:
            return
        self._kind = kind, confidence
        del self._report.classification[:]
        above = self._manner.default_class
        if not above and not kind:
            return
        sure = self._manner.class_confidence if above else confidence
        found = self._report.classification.add(type=above or kind, confidence=sure)
        if above and kind:
            found.sub_class.add(type=kind, confidence=confidence, level=1)

    def _infos(self, t_utc_ns: int, plots: Plots) -> list[_Info]:
        """The columns of object_info that have anything in them."""
        snr = measured(SNR, plots.snr, 0, MAX_SNR)
        bistatic_m = measured(BISTATIC_RANGE, plots.bistatic_range_m, 0, MAX_RANGE_M)
        sigma_m = with_rounding(plots.sigma_bistatic_range_m, 10.0**-RANGE_DECIMALS)
        sigmas_m = measured("bistatic range error", sigma_m, 0, MAX_RANGE_M)
        infos = [
            _Info(SNR, [f"{10 * math.log10(ratio):.2f}" if ratio else "" for ratio in snr]),
            _Info(BISTATIC_RANGE, _texts(bistatic_m, RANGE_DECIMALS), sigmas_m),
        ]
        if plots.range_rate_m_s is not None:
            rates_m_s = measured(RANGE_RATE, plots.range_rate_m_s, -MAX_RATE_M_S, MAX_RATE_M_S)
            texts = _texts(rates_m_s, RATE_DECIMALS)
            errors = None
            if plots.sigma_range_rate_m_s is not None:
                sigma_m_s = with_rounding(plots.sigma_range_rate_m_s, 10.0**-RATE_DECIMALS)
                errors = measured("range rate error", sigma_m_s, 0, MAX_RATE_M_S)
            rate = BISTATIC_RANGE_RATE if self._manner.transmitters else RANGE_RATE
            infos.append(_Info(rate, texts, errors))
        if self._manner.transmitters:
            names = [self._manner.transmitters[channel] for channel in plots.channel.tolist()]
            infos.append(_Info(TRANSMITTER, names))
        if self._manner.tells_age:
            stamp = stamp_ns(t_utc_ns)
            ages_s = [max(stamp - t_ns, 0) / 1e9 for t_ns in plots.t_utc_ns.tolist()]
            infos.append(_Info(AGE, [f"{age_s:.6f}" for age_s in ages_s]))
        return [info for info in infos if any(info.texts)]

    def _fill_infos(self, infos: list[_Info], i: int) -> None:
        told = self._report.object_info
        present = [info for info in infos if info.texts[i]]
        if len(told) != len(present):
            del told[:]
            for _ in present:
                told.add()
        for entry, info in zip(told, present, strict=True):
            entry.type, entry.value = info.type, info.texts[i]
            error = None if info.errors is None else info.errors[i]
            if error is None:
                entry.ClearField("error")
            else:
                entry.error = error

    def _fill_signal(self, amplitude_dbm: float | None) -> None:
        """Amplitude and frequency, which is known as well as the band is narrow."""
        if self._manner.band_hz is None:
            return
        del self._report.signal[:]
        if amplitude_dbm is None:
            return
        low_hz, high_hz = self._manner.band_hz
        self._report.signal.add(
            amplitude=amplitude_dbm,
            start_frequency=low_hz,
            centre_frequency=(low_hz + high_hz) / 2,
            stop_frequency=high_hz,
        )


def _texts(values: list[float | None], decimals: int) -> list[str]:
    return ["" if value is None else f"{value:.{decimals}f}" for value in values]


@dataclass(frozen=True, slots=True)
class _Info:
    """A type of object_info: its text for each plot, "" where there is none."""

    type: str
    texts: list[str]
    errors: list[float | None] | None = None
