"""Whether two revisions do the same, byte for byte, as far as a terminal and the network see it.

    python tests/digests/digests.py make OUT.json [--plotfeed PATH] [--root FOLDER]
    python tests/digests/digests.py compare A.json B.json
    python tests/digests/digests.py against REVISION [--out FOLDER]

Nothing of the package is imported: commands are run, and what they print, write and send is
digested. With other versions of Python or of libraries digests may differ. What is left out, since
it does not repeat: sessions and replays by the clock on the wall, `record`, the live page,
pictures, metrics, and SAPIENT over TCP; the order of messages of different sensors on a broker;
where the recorder of a session cuts chunks; times and what is chosen by times in `chart` and
`replay`; free ports. The number of the version stands in many outputs: revisions with two of them
differ.

Scenes are in scenes/. Recordings and flights of the folder PLOTFEED_TEST_INPUT are used too.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from digest_bench import Bench
from digest_items import Item, difference
from digest_jobs import Job, jobs

ROOT = Path(__file__).resolve().parents[2]
AT_A_TIME = 2
SHIPPED = "section-4.toml"
"""An example scene, wherever it lies; all TOML files beside it are examples too."""
NOT_SEARCHED = {".venv", ".git", ".node", "build", "tests", ".typing"}


def make(plotfeed: Path, root: Path) -> dict[str, Item]:
    """The items of one revision: its command, and the folder that has its examples."""
    with TemporaryDirectory(prefix="digests-") as folder:
        bench = Bench(plotfeed, Path(folder).resolve())

        def work(job: Job) -> None:
            job(bench)

        with ThreadPoolExecutor(AT_A_TIME) as pool:
            list(pool.map(work, jobs(bench, _examples(root))))
        return dict(sorted(bench.items.items()))


def _examples(root: Path) -> list[Path]:
    found = [p for p in root.rglob(SHIPPED) if not NOT_SEARCHED & {*p.relative_to(root).parts}]
    if len(found) != 1:
        raise SystemExit(f"{root}: expected one {SHIPPED}, found {len(found)}")
    return sorted(found[0].parent.glob("*.toml"))


def compare(one: dict[str, Item], other: dict[str, Item]) -> list[str]:
    """A line for each item that differs."""
    lines = []
    for name in sorted({*one, *other}):
        if name not in one or name not in other:
            lines.append(f"{name}: only in the {'first' if name in one else 'second'}")
        elif what := difference(one[name], other[name]):
            lines.append(f"{name}: {what}")
    return lines


def against(revision: str) -> tuple[dict[str, Item], dict[str, Item]]:
    """The items of a revision, in a worktree of its own, and of what lies here."""
    with TemporaryDirectory(prefix="digests-") as folder:
        worktree = Path(folder) / "worktree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", str(worktree), revision], check=True)
        try:
            set_up = ["make", ".venv/.ready-test"]
            subprocess.run(set_up, cwd=worktree, check=True)
            then = make(worktree / ".venv/bin/plotfeed", worktree)
        finally:
            subprocess.run([*git, "remove", "--force", str(worktree)], check=True)
    return then, make(_beside_python(), ROOT)


def _beside_python() -> Path:
    return Path(sys.executable).with_name("plotfeed")


def _write(path: Path, items: dict[str, Item]) -> None:
    path.write_text(json.dumps(items, indent=0) + "\n")


def _say(one: dict[str, Item], other: dict[str, Item]) -> int:
    lines, n = compare(one, other), len({*one, *other})
    for line in lines:
        print(line)
    print(f"{len(lines)} of {n} items differ" if lines else f"all {n} items are the same")
    return 1 if lines else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("out", type=Path)
    making.add_argument("--plotfeed", type=Path, default=_beside_python())
    making.add_argument("--root", type=Path, help="Of the revision; else by the command's .venv.")
    comparing = commands.add_parser("compare")
    comparing.add_argument("one", type=Path)
    comparing.add_argument("other", type=Path)
    checking = commands.add_parser("against")
    checking.add_argument("revision")
    checking.add_argument("--out", type=Path, help="A folder for the digests of both.")
    asked = parser.parse_args()
    if asked.command == "make":
        begin_s = time.monotonic()
        plotfeed = Path(os.path.abspath(asked.plotfeed))  # noqa: PTH100 - links stay as they are
        items = make(plotfeed, (asked.root or plotfeed.parents[2]).resolve())
        _write(asked.out, items)
        print(f"{len(items)} items in {time.monotonic() - begin_s:.0f} s: {asked.out}")
        return 0
    if asked.command == "compare":
        one, other = (json.loads(path.read_text()) for path in (asked.one, asked.other))
        return _say(one, other)
    then, now = against(asked.revision)
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        _write(asked.out / "then.json", then)
        _write(asked.out / "now.json", now)
    return _say(then, now)


if __name__ == "__main__":
    sys.exit(main())
