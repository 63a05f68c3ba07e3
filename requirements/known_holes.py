"""Says which versions in the files beside this one have known holes; `make audit` runs it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ASK = ("--disable-pip", "--require-hashes", "--format", "json", "--progress-spinner", "off")


def main() -> int:
    """1 if there are any; where the database is not reached, says so and finds none."""
    asked = unasked = 0
    holes = []
    for list_ in ("run.txt", "fleet.txt", "test.txt", "test-page.txt"):
        pip_audit = [sys.executable, "-m", "pip_audit", *ASK, "--requirement", str(HERE / list_)]
        done = subprocess.run(pip_audit, capture_output=True, text=True, check=False)  # noqa: S603
        if not done.stdout:
            print(f"{list_}: {done.stderr.strip().rpartition(chr(10))[2]}")
            unasked += 1
            continue
        for package in json.loads(done.stdout)["dependencies"]:
            if "skip_reason" in package:
                unasked += 1
                continue
            asked += 1
            holes += [
                f"{list_}: {package['name']} {package['version']}: {hole['id']}, mended in "
                f"{', '.join(hole['fix_versions']) or 'no version'}"
                for hole in package["vulns"]
            ]
    print("\n".join(holes) or "no known holes in what was asked for")
    print(f"{asked} packages asked for; the database did not answer for {unasked}")
    return bool(holes)


if __name__ == "__main__":
    sys.exit(main())
