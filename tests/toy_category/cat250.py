"""Category 250, plots of a radar that does not exist: the first of its three files, the layout."""

from plotfeed.proto.asterix.codec.layout import category

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
