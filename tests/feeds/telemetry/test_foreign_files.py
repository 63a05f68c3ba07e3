"""Files that would use a machine up, or have it ask others, are refused in a line."""

from __future__ import annotations

import os
import runpy
import struct
from itertools import pairwise
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from golden.make_flights import ulog
from support.read_here import found_here

from plotfeed.feeds.engine.terrain_files import _tile
from plotfeed.feeds.telemetry import foreign_files
from plotfeed.feeds.telemetry.flights import read
from plotfeed.feeds.telemetry.foreign_files import FILE_LIMITS, FileLimits, read_apart
from plotfeed.proto.errors import PlotfeedError

CONFINED = """
import json, os, resource
from plotfeed.feeds.telemetry.foreign_files import confine_process
confine_process(1 << 30, 7)
limits = [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_CPU)]
print(json.dumps({"found": [limits, dict(os.environ), os.listdir("/proc/self/fd")]}))
"""


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def nested_ulog(levels: int, width: int = 2) -> bytes:
    """A log whose topic has types in types, each `width` times in the one about it."""
    names = ["vehicle_global_position", *(f"t{n}" for n in range(1, levels)), "uint8_t"]
    data = bytes.fromhex("554c6f6701123501") + bytes(8)
    for outer, inner in pairwise(names):
        fields = "".join(f"{inner} f{n};" for n in range(width))
        data += _message("F", f"{outer}:{fields}".encode())
    return data + _message("A", bytes(3) + b"vehicle_global_position")


@pytest.mark.parametrize(
    ("kind", "data", "why"),
    [
        ("ULog", nested_ulog(22), "1000 fields, in 8 types"),
        ("ULog", nested_ulog(12, 1), "1000 fields, in 8 types"),
        ("ULog", nested_ulog(3, 30), "1000 fields, in 8 types"),
        ("GPX or KML", b"<kml>" + b"<Placemark>" * 65, "64 elements in each other"),
        ("GPX or KML", b"<!DOCTYPE a><kml/>", "document type"),
        ("GPX or KML", b"", "not a GPX or KML file"),
        ("ULog", b"ULog", "not a ULog file"),
    ],
)
def test_what_grows_without_end_is_refused(kind: str, data: bytes, why: str) -> None:
    if kind == "ULog":
        pytest.importorskip("pyulog")
    with pytest.raises(PlotfeedError, match=why):
        found_here(kind, data)


def test_another_process_finds_what_this_one_would() -> None:
    pytest.importorskip("pyulog")
    here, apart = found_here("ULog", ulog()), read_apart("ULog", ulog())
    assert here["end"] == apart["end"]
    assert here["topics"].keys() == apart["topics"].keys()
    for name, rows in here["topics"].items():
        for column, values in rows.items():
            np.testing.assert_array_equal(values, apart["topics"][name][column])


def test_a_process_that_breaks_or_takes_too_long_is_a_refusal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for start in ("import os; os.abort()", "print('[[')", "print('{}')"):
        monkeypatch.setattr(foreign_files, "_START", start)
        with pytest.raises(PlotfeedError, match="reading it takes more than"):
            read_apart("ULog", b"ULog")
    limits = FileLimits(10, 10, seconds=0)
    monkeypatch.setattr(foreign_files, "FILE_LIMITS", {**FILE_LIMITS, "ULog": limits})
    with pytest.raises(PlotfeedError, match="more than 0 s"):
        read_apart("ULog", b"ULog")
    with pytest.raises(PlotfeedError, match="larger than 10 octets"):
        read_apart("ULog", b"ULog" * 3)


def test_it_has_limits_and_neither_our_secrets_nor_our_files(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("resource")
    monkeypatch.setenv("PLOTFEED_REMOTE_ID_TOKEN", "secret")
    monkeypatch.setattr(foreign_files, "_START", CONFINED)
    with Path(os.devnull).open("rb") as held:
        os.set_inheritable(held.fileno(), True)
        limits, environment, files = read_apart("ULog", b"")
    assert limits == [1 << 30, 7]
    assert "secret" not in environment.values()
    assert len(files) == 4  # its own three, and the folder


VRT = """<VRTDataset rasterXSize="9" rasterYSize="9"><SRS>EPSG:4326</SRS>
<GeoTransform>-4,1,0,41,0,-1</GeoTransform><VRTRasterBand dataType="Int16" band="1"><SimpleSource>
<SourceFilename>{}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>
</VRTDataset>"""
WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:9/${z}/${x}/${y}.png</ServerUrl>
</Service></GDAL_WMS>"""


def test_rasters_are_what_their_suffix_says_and_no_larger_than_they_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import Affine

    monkeypatch.setattr("plotfeed.feeds.engine.terrain_files.read_apart", found_here)
    how = {"driver": "GTiff", "count": 1, "crs": "EPSG:4326"}
    whole = tmp_path / "whole.tif"
    place = Affine(0.1, 0.0, -4.0, 0.0, -0.1, 41.0)
    with rasterio.open(
        whole, "w", width=10, height=10, dtype="int16", nodata=-32768, transform=place, **how
    ) as file:
        heights = np.full((10, 10), 700, np.int16)
        heights[0, 0] = -32768
        file.write(heights, 1)
    tile = _tile(whole, whole.name)
    assert np.isnan(tile.heights_m[0, 0])
    assert (tile.heights_m[1:] == 700).all()
    bad = tmp_path / "bad.tif"
    octets = whole.read_bytes()
    for data in (
        *(octets[: len(octets) * n // 10] for n in range(10)),
        VRT.format(whole).encode(),
        WMS.encode(),
    ):
        bad.write_bytes(data)
        with pytest.raises(PlotfeedError) as refused:
            _tile(bad, bad.name)
        assert str(refused.value).startswith(f"{bad}: ")
        assert "\n" not in str(refused.value)
    sparse = {"width": 12_000, "height": 12_000, "dtype": "float32", "sparse_ok": True}
    fine, bad = Affine(1e-4, 0.0, -4.0, 0.0, -1e-4, 41.0), tmp_path / "sparse.tif"
    with rasterio.open(bad, "w", transform=fine, **sparse, **how):
        pass
    with pytest.raises(PlotfeedError, match="more than 256 times its octets"):
        _tile(bad, bad.name)
    with (tmp_path / "N40W004.hgt").open("wb") as file:
        file.truncate(7 << 30)
    with pytest.raises(PlotfeedError, match="larger than"):
        _tile(tmp_path / "N40W004.hgt", "N40W004.hgt")


def test_an_error_that_no_reader_foresaw_is_a_line_with_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    breaks = Mock(side_effect=RecursionError("deep\ndown"))
    monkeypatch.setattr("plotfeed.feeds.telemetry.flights._reader", lambda *_: breaks)
    path = tmp_path / "a.csv"
    path.write_bytes(b"time")
    with pytest.raises(PlotfeedError) as refused:
        read(path)
    assert str(refused.value) == f"{path}: no reader foresaw what is in it: RecursionError"


def test_the_page_has_the_limits_that_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(__file__).parents[3]
    monkeypatch.syspath_prepend(root / "docs" / "commands")
    written = runpy.run_path(str(root / "docs" / "commands" / "write_limits.py"))["text"]()
    assert written in (root / "SECURITY.md").read_text()
