"""The categories that are read: a new one is a layout, an encoder, and a row here."""

from plotfeed.proto.asterix.codec.layout import Category
from plotfeed.proto.asterix.layout_015 import CAT015
from plotfeed.proto.asterix.layout_016 import CAT016
from plotfeed.proto.asterix.layout_025 import CAT025
from plotfeed.proto.asterix.layout_048 import CAT034, CAT048
from plotfeed.proto.asterix.layout_062 import CAT062
from plotfeed.proto.asterix.layout_063 import CAT063
from plotfeed.proto.asterix.layout_129 import CAT129
from plotfeed.proto.asterix.layout_205 import CAT205

CATEGORIES: dict[int, Category] = {
    category.number: category
    for category in (CAT015, CAT016, CAT025, CAT034, CAT048, CAT062, CAT063, CAT129, CAT205)
}
"""The newest edition of each. For another, give a reader `CATEGORIES | {62: CAT062_1_18}`."""
