"""Changes a sign, a number or a comparison in lines that are new, and says what no test notices.

    make mutants ARGS='--since REVISION --most 40 --seed 2 --also tests/road'

Cosmic Ray makes the changes, each alone and in a copy of the tree; as many as wanted are drawn
from all that it could make. The tests asked are those of the module's room, and `--also` others.
It knows nothing of meaning: some of what survives changes nothing that anybody could see.
"""

from __future__ import annotations

import argparse
import random
import re
import subprocess
import sys
import time
from contextlib import chdir
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import WorkItem
from plant_faults import ROOMS, ROOT, copied

PYTHON = ROOT / ".venv/bin/python"
PATIENCE_S = 300.0
HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", re.MULTILINE)
# Changes that mean nothing: unions of types in annotations, and decorators of the library's own.
MEANINGLESS = ("ReplaceBinaryOperator_BitOr", "RemoveDecorator")


def new_lines(revision: str) -> dict[str, set[int]]:
    """Numbers of the lines of each module of the product that are new since then."""
    git = ["git", "diff", "--unified=0", "--diff-filter=d", "--no-color", revision, "--", *ROOMS]
    said = subprocess.run(git, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    found = {}
    for part in said.split("\ndiff --git "):
        name = re.search(r"^\+\+\+ b/(.+\.py)$", part, re.MULTILINE)
        if name and not name[1].endswith("_pb2.py"):
            hunks = [(int(at), int(n or 1)) for at, n in HUNK.findall(part)]
            found[name[1]] = {line for at, n in hunks for line in range(at, at + n)}
    return found


def changes_of(module: str, lines: set[int]) -> list[WorkItem]:
    """All changes that could be made in those lines of a module of this folder."""
    with use_db(":memory:") as work:
        init([Path(module)], work, {})
        return [
            item
            for item in work.work_items
            for mutation in item.mutations
            if lines.intersection(range(mutation.start_pos[0], mutation.end_pos[0] + 1))
            and not any(word in mutation.operator_name for word in MEANINGLESS)
        ]


def tests_of(module: str) -> str:
    """The folder of the tests of a module's room."""
    room = Path("tests", module).parent
    while not (ROOT / room).is_dir():
        room = room.parent
    return str(room)


def main() -> None:
    """Prints each change that no test notices, and how many were."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--since", default="HEAD~1", help="revision whose lines are not new")
    parser.add_argument("--most", type=int, default=50, help="how many changes are drawn")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument("--also", default="", help="more arguments for pytest")
    asked = parser.parse_args()
    noticed = 0
    with copied() as copy, chdir(copy):
        every = [
            (module, item)
            for module, lines in sorted(new_lines(asked.since).items())
            for item in changes_of(module, lines)
        ]
        draw = random.Random(asked.seed)  # noqa: S311 - nobody need not guess it
        chosen = draw.sample(every, min(asked.most, len(every)))
        for module, item in chosen:
            tests = f"{tests_of(module)} {asked.also}"
            command = f"{PYTHON} -m pytest -x -q -p no:cacheprovider {tests}"
            site = f"env PYTHONPATH={copy.parent / 'site'} CI= "
            began_s = time.monotonic()
            result = mutate_and_test(item.mutations, site + command, PATIENCE_S)
            verdict = "noticed"
            if result.output == "timeout":  # which notices an endless loop, and slow tests too
                verdict = "TOO LONG"
            elif not result.is_killed:
                verdict = "SURVIVES"
            noticed += verdict == "noticed"
            took, at = f"{time.monotonic() - began_s:.0f} s", item.mutations[0]
            print(f"{verdict:8} {took:>5}  {module}:{at.start_pos[0]} {at.definition_name}")
            if verdict == "SURVIVES":
                print(result.diff)
            sys.stdout.flush()
    print(f"{noticed} of {len(chosen)} changes are noticed, of {len(every)} that could be made")


if __name__ == "__main__":
    main()
