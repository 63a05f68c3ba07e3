"""Category 063, status of the sensors of a tracker: its layout.

EUROCONTROL-SPEC-0149-10, edition 1.7; `codec.layout` explains the table. Earlier editions have
fewer groups of I063/060.
"""

from __future__ import annotations

from plotfeed.proto.asterix.codec.layout import category

CAT063 = category(
    63,
    """
FRN  item      octets  parts: bits, LSB and unit
1    I063/010  2       SAC 8, SIC 8
2    I063/015  1       SID 8
3    I063/030  3       TOD 24: 1/128 s modulo 86400
4    I063/050  2       SAC 8, SIC 8
5    I063/060  1+FX    CON 2, PSR, SSR, MDS, ADS, MLT | OPS, ODP, OXT, MSC, TSV, NPW, _1 | TTFEP,
                       TTFVAL, SPOEP, SPOVAL, _3
6    I063/070  2       BIAS ±16: 1 ms
7    I063/080  4       SRG ±16: 1e-05, SRB ±16: 1/128 NM
8    I063/081  2       BIAS ±16: 180/2^15 deg
9    I063/090  4       PRG ±16: 1e-05, PRB ±16: 1/128 NM
10   I063/091  2       BIAS ±16: 180/2^15 deg
11   I063/092  2       BIAS ±16: 180/2^15 deg
13   I063/RE   1+n     octets behind their count
14   I063/SP   1+n     octets behind their count
""",
)
