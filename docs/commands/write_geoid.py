"""Make the geoid of the package, models/egm96-30.grid, from EGM96 every 15'.

    python docs/commands/write_geoid.py egm96-15.pgm

The file is that of GeographicLib (`geographiclib-get-geoids egm96-15`): big-endian uint16, rows
from 90 deg north, columns from 0 deg eastwards, height = 0.003 value - 108 m. Prints how far the
package is from it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from plotfeed.models.frames import COLUMNS, GRID_FILE, ROWS, geoid_undulation_m, packed
from plotfeed.models.state import Floats

OUT = Path(__file__).parents[2] / "models" / GRID_FILE
FINE_ROWS, FINE_COLUMNS = 2 * ROWS - 1, 2 * COLUMNS


def pgm_undulations_m(path: Path) -> Floats:
    """Undulations of the file, metres; (721, 1440)."""
    header, data = path.read_bytes().split(b"\n65535\n", 1)
    lines = header.decode("latin-1").splitlines()
    if lines[-1] != f"{FINE_COLUMNS} {FINE_ROWS}" or "# Origin 90N 0E" not in lines:
        sys.exit(f"{path}: expected a grid of 15' from 90N 0E, as egm96-15.pgm is")
    said = {line.split()[1]: line.split()[2] for line in lines if line.startswith("# ")}
    offset_m, scale_m = float(said["Offset"]), float(said["Scale"])
    values = np.frombuffer(data, ">u2", FINE_ROWS * FINE_COLUMNS).reshape(FINE_ROWS, FINE_COLUMNS)
    undulations_m: Floats = scale_m * values + offset_m
    return undulations_m


def errors_m(fine_m: Floats) -> tuple[Floats, Floats]:
    """What `geoid_undulation_m` is off at each node of the file, and the node's share of area."""
    latitude_deg = np.linspace(90, -90, FINE_ROWS)[:, None]
    longitude_deg = np.linspace(0, 360, FINE_COLUMNS, endpoint=False)[None]
    area = np.broadcast_to(np.cos(np.radians(latitude_deg)), fine_m.shape)
    return geoid_undulation_m(latitude_deg, longitude_deg) - fine_m, area / area.sum()


def main() -> None:
    fine_m = pgm_undulations_m(Path(sys.argv[1]))
    OUT.write_bytes(packed(np.rint(10 * fine_m[::2, ::2]).astype(np.int16)))
    error_m, area = errors_m(fine_m)
    off_m = np.abs(error_m)
    print(
        f"{OUT.stat().st_size} octets; rms {np.sqrt((error_m**2).mean()):.2f} m, 99.9 % within "
        f"{np.quantile(off_m, 0.999):.1f} m, most {off_m.max():.1f} m; by area rms "
        f"{np.sqrt((error_m**2 * area).sum()):.2f} m"
    )


if __name__ == "__main__":
    main()
