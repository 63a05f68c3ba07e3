"""The one file: category 250, plots of a radar that does not exist, as sensors report in it."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import ArrayLike

from plotfeed.feeds.formats import Batch, Format, SectorFormat, asterix_address, max_block_octets
from plotfeed.feeds.messages.message import Message, numbered
from plotfeed.feeds.scene.scene import Scene
from plotfeed.feeds.scene.sensors import Sensor
from plotfeed.models.state import Plots
from plotfeed.proto.asterix.codec.encode import Parts, Reports, measured
from plotfeed.proto.asterix.codec.layout import category
from plotfeed.proto.asterix.decode_plots import plots_in_asterix
from plotfeed.proto.report_format import PlotItems, SentCategory, asterix

CAT250 = category(
    250,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I250/010  2       SAC 8, SIC 8
2    I250/020  3       TOD 24: 1/128 s modulo 86400
3    I250/030  4       R 16: 1 m, AZ 16: 360/2^16 deg wraps
4    I250/040  2       EL ±16: 180/2^15 deg
""",
)


class PlotEncoder250(Reports):
    """Plots as I250/010, 020, 030, and 040 if they have elevations, and nothing besides."""

    def _columns(self, plots: Plots, _parts: Parts) -> Mapping[str, ArrayLike]:
        return {
            "I250/020": plots.t_utc_ns,
            "I250/030/R": plots.range_m,
            "I250/030/AZ": plots.azimuth_deg,
            **measured(plots, {"I250/040": "elevation_deg"}),
        }


class Asterix250(SectorFormat):
    """Blocks of category 250."""

    def __init__(self, scene: Scene, sensor: Sensor) -> None:
        self._address = asterix_address(scene, sensor, 250)
        self._plots = PlotEncoder250(
            CAT250,
            ("I250/010", "I250/020", "I250/030"),
            ("I250/040",),
            constants={"I250/010/SAC": sensor.sac, "I250/010/SIC": sensor.sic},
            max_octets=max_block_octets(scene, sensor),
        )

    def messages_of(self, batch: Batch) -> list[Message]:
        """One for each block."""
        return numbered(self._address, self._plots.blocks(batch.plots), batch.stamp)


FORMAT = Format(
    facts=asterix(
        {250: SentCategory("plots of a radar that does not exist")},
        layouts=(CAT250,),
        plot_items=PlotItems(
            columns={
                "range_m": "I250/030/R",
                "azimuth_deg": "I250/030/AZ",
                "elevation_deg": "I250/040",
            }
        ),
        range_step_m=1.0,
    ),
    maker=Asterix250.of_sensors,
    plots_in=plots_in_asterix,
)
