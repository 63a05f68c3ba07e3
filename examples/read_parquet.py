"""How often a radar detected each drone, and how wrong it was, by pandas and by DuckDB.

From a record of a session, as tables in Parquet:

    plotfeed run examples/scenes/radar-udp.toml --speed max --duration 60 --record radar.mcap
    for table in plots truths looks; do plotfeed convert radar.mcap radar-$table.parquet; done
    python examples/read_parquet.py radar

Needs pandas, pyarrow and duckdb.
"""

from __future__ import annotations

import sys

import duckdb
import pandas as pd


def detected_by_pandas(looks: str) -> pd.DataFrame:
    """Looks at each drone, how many detected it, and how many were to be expected."""
    found = (
        pd.read_parquet(looks)
        .groupby("drone")
        .agg(looks=("detected", "size"), detected=("detected", "sum"), expected=("pd", "sum"))
    )
    return found.reset_index()


def errors_by_duckdb(plots: str, truths: str) -> list[tuple[str, int, float]]:
    """Of each drone, its plots and the standard deviation of their errors of range in metres.

    Plots of a sector stand in the same order in both tables, by their times.
    """
    query = """
        SELECT drone, count(*), stddev_samp(plots.range_m - truths.range_m)
        FROM read_parquet(?) AS plots JOIN read_parquet(?) AS truths
          ON plots.sensor = truths.sensor AND plots.time_utc = truths.time_utc
        WHERE drone IS NOT NULL GROUP BY drone ORDER BY drone
    """
    return duckdb.execute(query, [plots, truths]).fetchall()


def main() -> None:
    """Print both tables."""
    name = sys.argv[1]
    for row in detected_by_pandas(f"{name}-looks.parquet").itertuples():
        print(f"{row.drone}: {row.detected} of {row.looks} looks, expected {row.expected:.1f}")
    for drone, plots, sigma_m in errors_by_duckdb(
        f"{name}-plots.parquet", f"{name}-truths.parquet"
    ):
        print(f"{drone}: {plots} plots, range errors {sigma_m:.2f} m")


if __name__ == "__main__":
    main()
