"""Whether two revisions do the same, byte for byte, as far as a terminal and the network see it.

    python tools/digests/digests.py record           # writes feeds.txt and said.txt, beside this
    python tools/digests/digests.py compare          # what differs from them, by name
    python tools/digests/digests.py against REVISION # what differs from it, and the first lines

Commands are run in this process, with other names for nothing inside the package but its face;
what they print, write and send is digested: a digest a line, beside the number of lines or
messages and what they are. feeds.txt has what a tracker is sent, live, recorded or replayed, and
the ledger, decoded; it does not change. said.txt has what people are told by commands, which may
change: by a commit that says so and writes it anew.

With other versions of Python or of libraries digests may differ. What is left out, since it does
not repeat: sessions and replays by the clock on the wall, `record`, the live page, pictures,
metrics, HTTP, and SAPIENT over TCP; the order of messages of different sensors on a broker; where
the recorder of a session cuts chunks; times and what is chosen by times in `chart` and `replay`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FILES = {"feeds.txt": False, "said.txt": True}  # Records, and whether they hold what is said
ENVIRONMENT = {"COLUMNS": "100", "LC_ALL": "C.UTF-8", "TZ": "UTC", "NO_COLOR": "1"}


def taken(root: Path, keep: Path | None, only: str) -> dict[str, list[str]]:
    """The lines of each record, of the jobs that have `only` in their name.

    `keep` is a folder for what they are digests of.
    """
    from digest_bench import Bench
    from digest_jobs import jobs

    found: dict[str, list[str]] = {name: [] for name in FILES}
    with TemporaryDirectory(prefix="digests-") as folder:
        bench = Bench(Path(folder).resolve())
        os.chdir(folder)
        for job in jobs(bench, root):
            if only in str(job):
                job(bench)
        os.chdir(root)
    for name, item in sorted(bench.items.items()):
        record = "said.txt" if item.is_said else "feeds.txt"
        found[record].append(f"{item.digest} {len(item.lines)} {name}")
        if keep is not None:
            (keep / _file_of(name)).write_text("\n".join(item.lines))
    return found


def _file_of(name: str) -> str:
    return name.replace("/", "%")[:200]


def differing(then: list[str], now: list[str]) -> dict[str, str]:
    """By its name, how an item differs."""
    one, other = (
        {name: [digest, n] for digest, n, name in (line.split(" ", 2) for line in lines)}
        for lines in (then, now)
    )
    found = dict.fromkeys(one.keys() - other.keys(), "is gone")
    found |= dict.fromkeys(other.keys() - one.keys(), "is new")
    for name in one.keys() & other.keys():
        if one[name] != other[name]:
            found[name] = f"differs: {one[name][1]} lines then, {other[name][1]} now"
    return dict(sorted(found.items()))


def say(then: dict[str, list[str]], now: dict[str, list[str]], folders: list[Path]) -> int:
    """Print what differs, with the first lines of it where folders have them."""
    found = {}
    for record in FILES:
        for name, how in differing(then[record], now[record]).items():
            found[name] = how
            print(f"{record}: {name} {how}")
            files = [folder / _file_of(name) for folder in folders]
            if files and all(file.exists() for file in files):
                lines = [file.read_text().split("\n") for file in files]
                n = next((i for i, (a, b) in enumerate(zip(*lines, strict=False)) if a != b), -1)
                print("".join(f"    {n + 1}: {each[n][:300]}\n" for each in lines), end="")
    n = sum(map(len, now.values()))
    print(f"{len(found)} of {n} items differ" if found else f"all {n} items are the same")
    return 1 if found else 0


def against(revision: str) -> int:
    """Compare with a revision, in a worktree of its own, by what is here to compare with."""
    with TemporaryDirectory(prefix="digests-") as folder:
        worktree = Path(folder) / "worktree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", str(worktree), revision], check=True)
        try:
            subprocess.run(["/usr/bin/env", "make", ".venv/.ready-test"], cwd=worktree, check=True)
            found = []
            for name, root in (("then", worktree), ("now", ROOT)):
                out = Path(folder) / name
                out.mkdir()
                python = root / ".venv/bin/python"
                words = [python, __file__, "record", "--root", root, "--out", out, "--keep", out]
                subprocess.run([*map(str, words)], check=True)
                found.append(out)
            return say(*map(_read, found), folders=found)
        finally:
            subprocess.run([*git, "remove", "--force", str(worktree)], check=True)


def _read(folder: Path) -> dict[str, list[str]]:
    return {record: (folder / record).read_text().splitlines() for record in FILES}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("record", "compare"):
        command = commands.add_parser(name)
        command.add_argument("--root", type=Path, default=ROOT, help="A clone, for its scenes.")
        command.add_argument("--only", default="", help="Of what, such as the name of a scene.")
        command.add_argument("--keep", type=Path, help="A folder for what was digested.")
        command.add_argument("--out", type=Path, default=HERE, help="Where the records are.")
    commands.add_parser("against").add_argument("revision")
    asked = parser.parse_args()
    if asked.command == "against":
        return against(asked.revision)
    asked.out.mkdir(parents=True, exist_ok=True)
    begin_s = time.process_time()
    out, keep = asked.out.resolve(), asked.keep and asked.keep.resolve()
    now = taken(asked.root.resolve(), keep, asked.only)
    spent_s = time.process_time() - begin_s
    print(f"{spent_s:.0f} s of the processor", file=sys.stderr)
    if asked.command == "compare":
        then = _read(out)
        if asked.only:
            names = {line.split(" ", 2)[2] for lines in now.values() for line in lines}
            then = {k: [x for x in v if x.split(" ", 2)[2] in names] for k, v in then.items()}
        return say(then, now, [])
    for record, lines in now.items():
        (out / record).write_text("\n".join(lines) + "\n")
        print(f"{record}: {len(lines)} items")
    return 0


if __name__ == "__main__":
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PLOTFEED_", "PYTHON"))}
    if any(os.environ.get(key) != value for key, value in ENVIRONMENT.items()) or len(kept) < len(
        [k for k in os.environ if k != "PYTHONHASHSEED"]
    ):
        # What would change what is printed has to be set before Python starts.
        seed = {k: v for k, v in os.environ.items() if k == "PYTHONHASHSEED"}
        os.execve(sys.executable, [sys.executable, *sys.argv], kept | seed | ENVIRONMENT)  # noqa: S606
    sys.exit(main())
