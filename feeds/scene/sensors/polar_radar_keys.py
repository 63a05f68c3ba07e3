"""The keys of radars that measure range, azimuth and elevation: active, MIMO; their pulses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from plotfeed.feeds.scene.fields import (
    Beamwidth,
    Decibels,
    Frequency,
    Location,
    Loss,
    NotNegative,
    Positive,
    Probability,
    Resolution,
    SceneTable,
    Site,
)
from plotfeed.feeds.scene.report_formats import REPORT_FORMATS, TRACK_FORMATS
from plotfeed.feeds.scene.sensors.echo_radar_keys import EchoRadarKeys
from plotfeed.feeds.scene.sensors.effect_keys import (
    ANGLE_SHARE,
    RANGE_SHARE,
    ClassifierKeys,
    MergingKeys,
    MultipathKeys,
    PulsedDopplerKeys,
    odd_floor,
    odd_frequency,
    stated_or,
)
from plotfeed.feeds.scene.sensors.mount_keys import MountKeys
from plotfeed.feeds.scene.sensors.scan_keys import AnyScan, ElectronicScan, StaringScan
from plotfeed.feeds.scene.sensors.sensor_keys import Reports, SensorGeometry, long_integration
from plotfeed.models.propagation import C_M_S
from plotfeed.models.sensors.active_radar import ActiveRadar, MimoRadar, MimoTransmitter

if TYPE_CHECKING:
    from plotfeed.models.effects.doppler import Doppler
    from plotfeed.models.effects.pulse_intervals import PulseIntervals
    from plotfeed.models.sensors.electronic_radar import ElectronicRadar


class PulsesKeys(SceneTable):
    """Pulses, and the intervals of coherent integration, of `integration_s` each, in one look."""

    prf_hz: Annotated[tuple[Positive, ...], Field(strict=False, min_length=1, max_length=64)]
    """Pulse frequencies, in turn by interval. One alone folds ranges at c/2PRF and rates at
    wavelength times PRF/2; several resolve both."""
    intervals: Annotated[int, Field(ge=1, le=64)] | None = None
    """In one look; without it, one a frequency. Echoes fluctuate anew in each."""
    needed: Annotated[int, Field(ge=1, le=64)] = 1
    """Intervals that must detect, each with `pfa`; the first of them measures."""
    pulse_s: NotNegative = 0.0
    """Length of a pulse, during which nothing is heard; 0 eclipses nothing."""
    stc_range_m: NotNegative = 0.0
    """Sensitivity-time control: nearer than this, from the latest pulse, echoes are weakened; 0 for
    none."""
    stc_exponent: Annotated[float, Field(ge=0, le=4)] = 4.0
    """Power of range by which they are; 4 makes echoes equal at all ranges below."""
    canceller: Literal["single", "double"] | None = None
    """Of pulses: single of two, double of three; blind at whole wavelengths times PRF/2."""
    notch_m_s: NotNegative = 0.0
    """Width of a notch about those speeds: 1 - exp(-(rate/notch)^2) of power is left."""
    beam_passes: bool = False
    """Of a radar that turns: each interval has the echo that the Gaussian receive beam leaves;
    loss_db then holds no loss of beam shape."""

    def _refusals(self) -> Iterator[str]:
        if self.intervals is not None and self.intervals < len(self.prf_hz):
            yield "intervals: at least one for each of prf_hz"
        if self.needed > self.count:
            yield f"needed: must not exceed the {self.count} intervals"
        if self.pulse_s * max(self.prf_hz) > 0.5:
            yield "pulse_s: must not exceed half of the time between pulses"

    @property
    def count(self) -> int:
        """Intervals of a look."""
        return self.intervals or len(self.prf_hz)

    @property
    def folding_prf_hz(self) -> float | None:
        """The only pulse frequency; None where several tell ranges and rates apart."""
        return self.prf_hz[0] if len(set(self.prf_hz)) == 1 else None

    def warnings(self, range_max_m: float) -> Iterator[str]:
        """Ranges that fold within the instrumented one."""
        if self.folding_prf_hz is None:
            return
        folds_at_m = C_M_S / (2 * self.folding_prf_hz)
        if folds_at_m < range_max_m:
            yield (
                f"pulses.prf_hz is {self.folding_prf_hz:g}: drones beyond {folds_at_m:.0f} m are "
                "told nearer by as much; two frequencies tell them apart"
            )


class PolarRadarKeys(EchoRadarKeys):
    """Everything but what makes the echoes. The defaults are the paper's typical values."""

    geometry = SensorGeometry.MONOSTATIC
    sapient_type = "RADAR"
    formats = ("asterix-015", "asterix-048", *TRACK_FORMATS, "plots", "sapient")

    report: Reports = ()
    """Without it, plots, and asterix-048 (with 034) for a rotating scan, else asterix-015 (with
    025); asterix-062 brings 063."""
    scan: AnyScan
    frequency_hz: Frequency
    """Of the carrier."""
    gain_tx_dbi: Decibels
    """Of the transmitting antenna."""
    gain_rx_dbi: Decibels | None = None
    """Without it, 41253 times efficiency over both beamwidths in degrees."""
    antenna_efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Of the receiving antenna: its gain over that of a lossless one."""
    integration_s: Positive
    """Coherent."""
    loss_db: Loss = 4.0
    """Of the system; the CFAR loss is in the detector already."""
    noise_figure_db: Loss = 5.0
    """Of the receiver."""
    pfa: Probability = 1e-6
    """Probability of a false alarm in one resolution cell."""
    n_reference: Annotated[int, Field(ge=1, le=1_000_000)] = 16
    """Reference cells of the CA-CFAR."""
    range_resolution_m: Resolution
    """Width of a range cell."""
    azimuth_beamwidth_deg: Beamwidth
    """Of the receive beam, at 3 dB."""
    elevation_beamwidth_deg: Beamwidth
    """Of the receive beam, at 3 dB."""
    doppler_cells: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Cells of velocity for each of range: each can give a false alarm."""
    range_floor_m: NotNegative | None = None
    """Error that remains however strong the echo; without it, a twentieth of the range cell."""
    azimuth_floor_deg: NotNegative | None = None
    """The same in azimuth; without it, a tenth of the beam."""
    elevation_floor_deg: NotNegative | None = None
    """The same in elevation; without it, a tenth of the beam."""
    measures_elevation: bool = True
    """False for a two-dimensional radar, whose plots have neither elevation nor height."""
    multipath: MultipathKeys | None = None
    """The ground's reflection; without it, space is free."""
    doppler: PulsedDopplerKeys | None = None
    """Without it, no range rates."""
    pulses: PulsesKeys | None = None
    """Without it, nothing is ambiguous or blind, and a look is one interval."""
    merging: MergingKeys | None = None
    """Without it, every drone is seen by itself, however close to others."""
    classifier: ClassifierKeys | None = None
    """What plots are called for each `target_class`, rightly or wrongly; without it, nothing."""

    @classmethod
    def usual_report(cls, keys: dict[str, Any], /) -> tuple[str, ...]:
        """What every tracker reads, where a beam turns; where none does, the finer category."""
        scan = keys.get("scan")
        rotates = isinstance(scan, dict) and scan.get("kind") == "rotating"
        return ("asterix-048" if rotates else "asterix-015", "plots")

    def warnings(self, site: Site, /) -> Iterator[str]:
        """Odd accuracies, cells without false alarms, and a format coarser than the radar."""
        if self.pulses is not None:
            yield from self.pulses.warnings(self.range_max_m)
        yield from self._odd_values()
        yield from self._few_cells()
        yield from self._coarse_format(site)

    @property
    def signals_hz(self) -> Sequence[tuple[float, float]]:
        """Carrier, and the bandwidth that its range cells take."""
        return [(self.frequency_hz, C_M_S / (2 * self.range_resolution_m))]

    @property
    def range_cells_m(self) -> Sequence[float]:
        """The one range cell."""
        return [self.range_resolution_m]

    def _usual_floors(self) -> dict[str, float]:
        """Error floors of such a radar, by their keys."""
        return {
            "range_floor_m": RANGE_SHARE * self.range_resolution_m,
            "azimuth_floor_deg": ANGLE_SHARE * self.azimuth_beamwidth_deg,
            "elevation_floor_deg": ANGLE_SHARE * self.elevation_beamwidth_deg,
        }

    def _odd_values(self) -> Iterator[str]:
        """Floors that no radar has, and a carrier that none has."""
        yield from odd_frequency("frequency_hz", self.frequency_hz)
        for key, usual in self._usual_floors().items():
            if self.measures_elevation or key != "elevation_floor_deg":
                yield from odd_floor(key, getattr(self, key), usual)
        if self.doppler is not None:
            cell_m_s = C_M_S / self.frequency_hz / (2 * self.integration_s)
            yield from self.doppler.odd_floor(cell_m_s)

    def _few_cells(self) -> Iterator[str]:
        """Fewer Doppler cells for false alarms than rates are told apart in."""
        doppler = self._doppler()
        if doppler is None:
            return
        cells = doppler.spans_m_s[0] / doppler.cells_m_s[0]
        if self.doppler_cells <= cells / 2:
            yield (
                f"doppler_cells is {self.doppler_cells}, and the range rates that are told apart "
                f"make {cells:.0f} cells: each could give a false alarm"
            )

    def _coarse_format(self, site: Site) -> Iterator[str]:
        strongest_snr = 1e6  # 60 dB: what remains there is the floor and the resolution
        best_m = self.model(site).stated_sigmas(strongest_snr)["sigma_range_m"]
        for row in (REPORT_FORMATS[name] for name in dict.fromkeys(self.report)):
            error_m = row.range_step_m / 12**0.5
            if error_m > best_m:
                yield (
                    f"{row.name} counts range in steps of {row.range_step_m:.3g} m, an error of "
                    f"{error_m:.2g} m beside the radar's own of {best_m:.2g} m for a strong echo"
                )

    def following(self, site: Site, /) -> dict[str, Any]:
        """Error floors that are not stated, the intervals of pulses, and what of any radar."""
        floors = {
            k: stated_or(getattr(self, k), usual) for k, usual in self._usual_floors().items()
        }
        return super().following(site) | floors | {"intervals": self._intervals()}

    @property
    def measures_run_length(self) -> bool:
        """Whether any of its formats tells run lengths."""
        return any(REPORT_FORMATS[name].tells_run_lengths for name in self.report)

    def _refusals(self) -> Iterator[str]:
        if self.pulses is not None and self.doppler is not None and self.doppler.prf_hz is not None:
            yield "doppler.prf_hz: leave it out: pulses say it"
        if self.pulses is not None and self.pulses.beam_passes and not self.scan.rotates:
            yield "pulses.beam_passes: is of a radar that turns"

    def _intervals(self) -> PulseIntervals | None:
        pulses, beam = self.pulses, None
        if pulses is None:
            return None
        from plotfeed.models.effects.pulse_intervals import PassingBeam, PulseIntervals

        if pulses.beam_passes and self.scan.rotates:
            step_deg = 360 * self.integration_s / self.scan.period_s
            beam = PassingBeam(beamwidth_deg=self.azimuth_beamwidth_deg, step_deg=step_deg)
        return pulses.made(
            PulseIntervals,
            prfs_hz=tuple(islice(cycle(pulses.prf_hz), pulses.count)),
            interval_s=self.integration_s,
            wavelength_m=C_M_S / self.frequency_hz,
            beam=beam,
        )

    def _doppler(self) -> Doppler | None:
        if self.doppler is None or self.pulses is None:
            return super()._doppler()
        keys = self.doppler.model_copy(update={"prf_hz": self.pulses.folding_prf_hz})
        return keys.model([C_M_S / self.frequency_hz], self.integration_s, self.legs)


class ActiveRadarKeys(PolarRadarKeys):
    """A quasi-monostatic active radar. The defaults are the paper's typical values."""

    label = "radar"
    makes = ActiveRadar

    type: Literal["active_radar"]
    power_w: Positive
    """Average."""
    decorrelation_s: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    """Time in which a target's amplitude falls to 1/e, so that hits come in runs; without it, each
    scan is independent. For Swerling 1 and 3."""
    receive_beams: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Side by side in azimuth, which lengthens a rotating radar's time on target."""
    mount: MountKeys | None = None
    """Motors that turn a staring radar, and its cover, to cues."""

    def _refusals(self) -> Iterator[str]:
        if isinstance(self.scan, ElectronicScan):
            yield from self.scan.refusals_of(self)
        if self.pulses is not None and self.pulses.count > 1 and self.decorrelation_s is not None:
            yield "decorrelation_s: echoes of several pulses.intervals fluctuate anew"

    def model(self, site: Site, /) -> ActiveRadar | ElectronicRadar:
        """The radar, or what steers its beam."""
        model: ActiveRadar = super().model(site)
        if not isinstance(self.scan, ElectronicScan):
            return model
        from plotfeed.models.dwell_agenda import Steering
        from plotfeed.models.sensors.electronic_radar import ElectronicRadar

        steering = self.scan.made(Steering)
        return ElectronicRadar(range_max_m=self.range_max_m, radar=model, steering=steering)

    def warnings(self, site: Site, /) -> Iterator[str]:
        """A beam that is too fast for its integration, and a format coarser than the radar."""
        yield from self._short_dwell()
        if isinstance(self.scan, ElectronicScan):
            yield from self.scan.warnings()
        yield from super().warnings(site)

    def _short_dwell(self) -> Iterator[str]:
        if not self.scan.rotates or (self.pulses is not None and self.pulses.beam_passes):
            return
        beam_deg = min(self.receive_beams * self.azimuth_beamwidth_deg, 360.0)
        on_target_s = self.scan.period_s * beam_deg / 360
        intervals = 1 if self.pulses is None else self.pulses.count
        if intervals * self.integration_s > on_target_s:
            times = f" times {intervals} intervals" if intervals > 1 else ""
            yield (
                f"integration_s is {self.integration_s:g}{times}, but the beam is on a target for "
                f"{on_target_s:.3g} s of a turn: integrate less, turn slower, or add receive_beams"
            )


class MimoTransmitterKeys(Location):
    """One of the radar's transmitters, and the place of its antenna."""

    power_w: Positive
    """Average."""
    gain_tx_dbi: Decibels | None = None
    """In place of the radar's."""


class MimoRadarKeys(PolarRadarKeys):
    """A radar of several transmitters far apart and one receiver, looking everywhere at once."""

    label = "MIMO radar"
    makes = MimoRadar

    type: Literal["mimo_radar"]
    scan: StaringScan
    transmitters: Annotated[
        tuple[MimoTransmitterKeys, ...], Field(strict=False, min_length=1, max_length=32)
    ]
    """The radar's own."""
    loss_db: Loss = 1.1
    """Of the system: the paper's 2 dB; the CFAR loss is in the detector."""
    n_reference: Annotated[int, Field(ge=1, le=256)] = 16
    """Reference cells of the CA-CFAR in the signal of each transmitter."""

    def following(self, site: Site, /) -> dict[str, Any]:
        """What of any such radar, and the transmitters as the receiver sees them."""
        transmitters = tuple(
            part.made(
                MimoTransmitter,
                position_enu_m=self.offset_enu_m(site, part),
                gain_dbi=self.gain_tx_dbi if part.gain_tx_dbi is None else part.gain_tx_dbi,
            )
            for part in self.transmitters
        )
        return super().following(site) | {"transmitters": transmitters}

    def warnings(self, site: Site, /) -> Iterator[str]:
        """An integration longer than a scan, and a format coarser than the radar."""
        yield from long_integration(self.integration_s, self.scan)
        yield from super().warnings(site)
