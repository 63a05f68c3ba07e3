"""The categories that are read, each of which stands in a file of its own, and formats of them."""

from plotfeed.proto.asterix import cat015, cat048, cat062, cat129, cat205
from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.report_format import PlotItems, ReportFormat

ASTERIX_FORMATS = (cat015.FORMAT, cat048.FORMAT, cat062.FORMAT, cat205.FORMAT)
# The newest edition of each. For another, give a reader `CATEGORIES | {62: CAT062_1_18}`.
CATEGORIES: dict[int, Category] = {129: cat129.CAT129}
PLOT_ITEMS: dict[int, PlotItems] = {}  # What tells of plots, by category
TRACK_ITEMS: dict[int, PlotItems] = {}  # What tells of tracks


def know(format_: ReportFormat) -> None:
    """Read the categories of a format."""
    CATEGORIES.update({layout.number: layout for layout in format_.layouts})
    if format_.plot_items is not None:
        read = TRACK_ITEMS if format_.tells_tracks else PLOT_ITEMS
        read[next(iter(format_.categories))] = format_.plot_items


for each in ASTERIX_FORMATS:
    know(each)
