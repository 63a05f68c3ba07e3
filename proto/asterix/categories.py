"""The categories that are read: a new one is a file of layout and encoder, and a row here."""

from plotfeed.proto.asterix.cat015 import CAT015
from plotfeed.proto.asterix.cat016 import CAT016
from plotfeed.proto.asterix.cat025 import CAT025
from plotfeed.proto.asterix.cat048 import CAT034, CAT048
from plotfeed.proto.asterix.cat062 import CAT062
from plotfeed.proto.asterix.cat063 import CAT063
from plotfeed.proto.asterix.cat129 import CAT129
from plotfeed.proto.asterix.cat205 import CAT205
from plotfeed.proto.asterix.codec.layout import Category

CATEGORIES: dict[int, Category] = {
    category.number: category
    for category in (CAT015, CAT016, CAT025, CAT034, CAT048, CAT062, CAT063, CAT129, CAT205)
}
"""The newest edition of each. For another, give a reader `CATEGORIES | {62: CAT062_1_18}`."""
