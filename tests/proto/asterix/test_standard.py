"""Records of categories that libasterix knows; without it, what is said of them."""

from __future__ import annotations

import json

import pytest
from support.recordings import block

from plotfeed.feeds.recording.decoded_text import message_lines
from plotfeed.feeds.recording.record_text import Style, categories_of
from plotfeed.proto.asterix import standard
from plotfeed.proto.content_types import ASTERIX
from plotfeed.replay.asterix_files import record_counts


def shown(data: bytes, style: Style = Style.LINE) -> list[str]:
    categories = categories_of((), verbose=style is Style.TREE)
    return list(message_lines("r/asterix", data, ASTERIX, style, categories))


# A single plot of primary radar, 2 NM away, with a Mode 3/A code.
PLOT_001 = ("f0", "190d", "20", "01000200", "0fff")
TRACK_001 = ("f0", "190d", "a0", "0102", "02000400")  # A track, whose third item is its number


NORTH_002 = ("f4", "190d", "02", "40", "0c8000", "1f00")


def test_a_category_of_others_is_decoded_by_libasterix() -> None:
    data = block(1, *PLOT_001, *TRACK_001)
    plot, track, north = shown(data + block(2, *NORTH_002))
    assert plot.split("  ")[-3:] == [
        "020 TYP=0 SIM=0 SSRPSR=2 ANT=0 SPI=0 RAB=0",
        "040 RHO=2 THETA=2.8125",
        "070 V=0 G=0 L=0 MODE3A=7777",
    ]
    assert "161 258  " in track
    assert "CAT002  01:46:40.000  010 SAC=25 SIC=13  000 2  020 90" in north
    assert record_counts(data, categories_of(())) == {1: 2}


def test_a_tree_has_names_units_and_words() -> None:
    (tree,) = shown(block(48, "f0", "190d", "0c8000", "20", "80004000"), Style.TREE)
    lines = tree.splitlines()
    assert "CAT048  record of 11 octets, edition " in lines[0]
    assert lines[1:] == [
        "  I048/010  Data Source Identifier",
        "    SAC  System Area Code: 25",
        "    SIC  System Identification Code: 13",
        "  I048/140  Time of Day: 6400 s, 01:46:40.000",
        "  I048/020  Target Report Descriptor",
        "    TYP: 1, Single PSR detection",
        "    SIM: 0, Actual target report",
        "    RDP: 0, Report from RDP Chain 1",
        "    SPI: 0, Absence of SPI",
        "    RAB: 0, Report from aircraft transponder",
        "  I048/040  Measured Position in Polar Co-ordinates",
        "    RHO: 128 NM",
        "    THETA: 90 °",
    ]


def test_the_reserved_expansion_field_has_its_parts() -> None:
    # I062/RE with the velocity relative to the system's reference point, 16 and -16 m/s.
    track = block(62, "8101010104", "190d", "06", "20", "0040ffc0")
    (line,), (tree,) = shown(track), shown(track, Style.TREE)
    assert line.endswith("RE TVS=(VX=16 VY=-16)")
    assert "      VX: 16 m/s" in tree.splitlines()


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standard, "tables", lambda: None)
    monkeypatch.setattr("plotfeed.feeds.recording.record_text.standard", lambda _: None)
    standard.standard.cache_clear()


CROSSING_002 = ("f0", "190d", "01", "20", "0c8040")
INSTALL = "octets are not decoded; for names and values: pip install 'plotfeed[asterix]'"
SOURCE = "  010 SAC=25 SIC=13  "


@pytest.mark.usefixtures("nothing_installed")
def test_without_libasterix_blocks_are_cut_into_records_with_sources_and_times() -> None:
    data = block(2, *NORTH_002, *CROSSING_002)
    north, crossing = shown(data)
    assert north == (
        f"r/asterix  CAT002  01:46:40.000{SOURCE}000 0x02  020 0x40  050 0x1f00  ({INSTALL})"
    )
    assert f"CAT002  01:46:40.500{SOURCE}000 0x01  020 0x20  (" in crossing
    first, _ = (json.loads(line)["message"]["items"] for line in shown(data, Style.JSON))
    assert first["I002/010"] == {"SAC": 25, "SIC": 13}
    assert (first["I002/030"], first["I002/020"]) == (6400.0, "40")
    (tree,) = shown(block(2, *NORTH_002), Style.TREE)
    assert tree.splitlines()[0].endswith(INSTALL)
    assert "  I002/050: 2 octets 1f00" in tree.splitlines()
    # Tracks of 001 are told from its plots.
    plot, track = shown(block(1, *PLOT_001, *TRACK_001))
    assert f"{SOURCE}020 0x20  040 0x01000200  070 0x0fff  (" in plot
    assert f"{SOURCE}020 0xa0  161 0x0102  040 0x02000400  (" in track


@pytest.mark.usefixtures("nothing_installed")
@pytest.mark.parametrize("number", [1, 2, 19, 20, 21, 23, 65, 240, 247])
def test_without_libasterix_every_category_says_whose_its_records_are(number: int) -> None:
    data = block(number, "80", "190d", "80", "190e")
    assert record_counts(data, categories_of(())) == {number: 2}
    for sic, line in zip((13, 14), shown(data), strict=True):
        assert f"010 SAC=25 SIC={sic}  (octets are not" in line


def test_of_a_category_of_nobody_a_block_says_that_nothing_is_known() -> None:
    (line,) = shown(block(99, "f4", "190d"))
    assert line.endswith("a block of 3 octets, of which no layout is known: f4190d")


@pytest.mark.usefixtures("nothing_installed")
def test_without_libasterix_a_tree_has_units() -> None:
    for number, octets, units in (
        (48, ("f0", "190d", "0c8000", "20", "80004000"), ("    RHO: 128 NM", "  I048/140: 6400 s")),
        (62, ("8110", "190d", "08", "0040"), ("    TAS: 64 kt",)),
    ):
        (tree,) = shown(block(number, *octets), Style.TREE)
        assert set(units) <= set(tree.splitlines())
