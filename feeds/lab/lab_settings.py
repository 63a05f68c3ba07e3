"""What `score` and `sweep` are asked; read when the command line begins, so without NumPy."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.option_fields import MAX_SEED, option

PARQUET, CSV = ".parquet", ".csv"


def usual_suffix() -> str:
    """The suffix of tables in a folder: Parquet where it can be written here."""
    return PARQUET if find_spec("pyarrow") else CSV


@dataclass(frozen=True, slots=True, kw_only=True)
class RunsAsked:
    """What is asked of many runs: of which, how they are spread, and how they are told of."""

    vary: tuple[str, ...] = option(
        (),
        "Give this key of SCENE each of these values, as A,B,C or START:STOP:STEP; may be "
        "repeated for all combinations.",
        metavar="KEY=VALUES",
    )
    runs: int = option(
        20,
        "Make so many runs of each combination, each with a seed of its own, the same at all; "
        "with --profile at most so many, until its limits are decided.",
        low=1,
        high=1_000_000,
    )
    seed: int = option(
        1,
        "Take this seed for the first run, and the next whole numbers for the others.",
        low=0,
        high=MAX_SEED,
    )
    duration: float | None = option(
        None,
        "End each run after so many seconds of its time; else as the scene says, or after 60.",
        over=0,
        metavar="SECONDS",
    )
    processes: int | None = option(
        None,
        "Spread runs over so many processes of this machine; else over one for each processor, "
        "with --tracker over one.",
        low=1,
        high=1024,
    )
    ray: str | None = option(
        None, "Spread runs over the Ray cluster whose head is there.", metavar="HOST:PORT"
    )

    def processes_of(self, jobs: int) -> int | None:
        """Processes to be started here; None where a cluster has them."""
        if self.ray is not None:
            return None
        return min(self.processes or os.cpu_count() or 1, max(jobs, 1))


def tell(
    told: Mapping[str, Any], lines: Iterable[str], written: Sequence[Path], *, as_json: bool
) -> None:
    """Print what came of runs, in lines or as one JSON object, and the files."""
    from plotfeed.feeds.console.printed import finite, say

    if as_json:
        say(json.dumps(finite({**told, "files": [str(path) for path in written]})))
        return
    for line in (*lines, *(f"written: {path}" for path in written)):
        say(line)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreOptions:
    """What `score` is asked."""

    tracks: Path | None = option(
        None,
        "Read tracks from this file, MCAP, pcap, raw ASTERIX (.ast), CSV or GeoJSON; without it "
        "from RECORDING.",
        path="existing",
        metavar="FILE",
    )
    truth: tuple[Path, ...] = option(
        (),
        "Score against the flights in this file, in place of the ledger: a log or table of a "
        "drone's, as inject takes, or a record of tracks; may be repeated.",
        path="existing",
        metavar="FILE",
    )
    topics: tuple[str, ...] = option(
        (),
        "Take tracks only from topics that fit this filter, as of MQTT with + and #; may be "
        "repeated.",
        metavar="FILTER",
        name="--topic",
    )
    out: Path | None = option(
        None, "Write tables and charts to this HTML file too.", path="file", metavar="HTML"
    )
    profile: str | None = option(
        None,
        "Judge by the limits of this profile: a TOML file, or one that comes with plotfeed, such "
        "as example-f3411.",
        metavar="NAME|FILE",
    )
    junit: Path | None = option(
        None,
        "Write the verdict on each limit to this file too, as JUnit's XML.",
        path="file",
        metavar="XML",
    )
    changes: tuple[str, ...] = option(
        (),
        "Score by this setting of profiles in place of the profile's, such as cutoff_m=30, "
        'sector_deg=[0,90] or leave_out=["c"]; may be repeated.',
        metavar="KEY=VALUE",
        name="--set",
    )
    feed: bool = option(
        False,
        "Check the plots of each sensor beside what the sensor claims, in place of a tracker.",
    )
    force: bool = option(
        False, "Replace the files of --out and --junit, and begin anew in --folder."
    )
    as_json: bool = option(False, "Print everything as one JSON object.")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings(RunsAsked):
    """What `score` is asked of trackers that it runs; some follow from its other options."""

    trackers: tuple[str, ...] = option(
        (),
        "Start this tracker beside a session of SCENE, in each run anew; may be repeated to "
        "compare several, each by its name.",
        metavar="[NAME=]COMMAND",
        name="--tracker",
    )
    speed: float = option(
        1.0,
        "Run so many times as fast as real time: for trackers that go by times in messages.",
        low=0.1,
        high=100,
    )
    patience: float = option(
        10.0,
        "Wait so long for the first line that the tracker prints, and begin then.",
        over=0,
        metavar="SECONDS",
    )
    folder: Path = option(
        Path("score"),
        "Keep runs, table (Parquet or CSV) and curve of --tracker in this folder.",
        path="folder",
        metavar="DIR",
    )

    def processes_of(self, jobs: int) -> int | None:
        """Processes to be started here: as a rule one, for trackers run in real time."""
        return None if self.ray is not None else min(self.processes or 1, max(jobs, 1))

    def files(self) -> list[Path]:
        """The table, and the picture where it can be drawn."""
        picture = [self.folder / "curve.png"] if find_spec("matplotlib") else []
        return [self.folder / f"scores{usual_suffix()}", *picture]


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepSettings(RunsAsked):
    """What a sweep is asked to do."""

    out: Path = option(
        Path("sweep"),
        "Keep runs, tables and chart in this folder, or write the table of runs alone to this "
        "file, .parquet or .csv.",
        metavar="DIR-or-FILE",
    )
    chart: Path | None = option(
        None,
        "Draw the chart to this file, .png, .svg or .pdf, instead of sweep.png in the folder.",
        path="file",
        metavar="FILE",
    )
    protect: str | None = option(
        None,
        "Count distances of alerts to this place, metres from the site; else to the site.",
        metavar="EAST,NORTH[,UP]",
    )
    alert_plots: int = option(
        3, "Take so many plots of a drone that have arrived for an alert.", low=1, high=1000
    )
    alert_within: float = option(
        10.0, "Let the plots of an alert arrive within so many seconds.", over=0, metavar="SECONDS"
    )
    force: bool = option(False, "Begin anew, and replace what is there.")
    as_json: bool = option(False, "Print the figures as one JSON object.")

    @property
    def is_one_table(self) -> bool:
        """Whether one file is asked for, and not a folder."""
        return self.out.suffix in (PARQUET, CSV)

    @property
    def folder(self) -> Path:
        """Where the journal is; of one file it is hidden, and goes when that is written."""
        return self.out.with_name(f".{self.out.name}.sweep") if self.is_one_table else self.out

    def tables(self, names: Iterable[str]) -> dict[str, Path]:
        """Files of the tables of these names; of runs alone where one file is asked for."""
        if self.is_one_table:
            return {"runs": self.out}
        return {name: self.out / f"{name}{usual_suffix()}" for name in names}

    def picture(self) -> Path | None:
        """The file of the chart, if there is one."""
        if self.chart is None and not self.is_one_table and find_spec("matplotlib"):
            return self.out / "sweep.png"
        return self.chart


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartSettings:
    """What `chart` is asked."""

    runs: int | None = option(
        None,
        "Run each variant with so many seeds at most, fewer where it is decided before; else with "
        "as many as decide all, or as 90 seconds of processor allow.",
        low=2,
        high=10_000,
    )
    duration: float = option(
        30.0, "Let each run last so many seconds of the scene.", over=0, metavar="SECONDS"
    )
    chart: Path | None = option(
        None,
        "Draw a picture to this file too, .png, .svg or .pdf: what changes against what it costs.",
        path="file",
        metavar="FILE",
    )
    force: bool = option(False, "Replace files that are there already.")
    as_json: bool = option(False, "Print the figures as one JSON object.", name="--json")


@dataclass(frozen=True, slots=True, kw_only=True)
class NeedsSettings(ChartSettings):
    """What `needs` is asked."""

    matters: str = option(
        "2%",
        "Take a change for one that matters from this share on, such as 0.5% or 0.02.",
        metavar="SHARE",
        tells_default=True,
    )
    write: tuple[Path, ...] = option(
        (),
        "Write the scene without what can go, with comments that say what changes, to a file "
        "whose name ends in lean.toml, or with what is missing to full.toml; may be repeated.",
        path="file",
        metavar="FILE",
    )
