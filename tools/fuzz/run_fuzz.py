"""Fuzzes what takes octets from outside, led by coverage; `make fuzz` runs it for an hour.

What breaks a target is kept beside this file and tried by every run of the tests from then on.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

TOOLS = Path(__file__).parents[1]
sys.path[:0] = [str(TOOLS), str(TOOLS.parent / "tests")]
MOST_OCTETS = 65_536
SLOWEST_S, MOST_MIB = 1, 256  # Of one input


def fuzz_one(name: str, corpus: Path, findings: Path, seconds: float) -> None:
    """Fuzz a target in this process, which ends with it."""
    import atheris  # type: ignore[import-not-found]

    with atheris.instrument_imports(include=["plotfeed"]):
        from fuzz.first_seeds import seeds_of
        from fuzz.mutate import mutated
        from fuzz.targets import attempt

    def changed(data: bytes, most: int, seed: int) -> bytes:
        """What it is changed by its structure, or what its octets are, by turns."""
        rng = Random(seed)  # noqa: S311
        return mutated(data, rng)[:most] if rng.random() < 0.5 else atheris.Mutate(data, most)

    for seed in seeds_of(name):
        (corpus / sha256(seed).hexdigest()[:16]).write_bytes(seed)
    options = [
        f"-max_total_time={seconds:.0f}",
        f"-max_len={MOST_OCTETS}",
        f"-timeout={SLOWEST_S}",
        f"-malloc_limit_mb={MOST_MIB}",
        f"-artifact_prefix={findings}/",
        "-print_final_stats=1",
    ]
    words = [sys.argv[0], *options, str(corpus)]
    atheris.Setup(words, lambda data: attempt(name, data), custom_mutator=changed)
    atheris.Fuzz()


def main() -> None:
    """Every target in turn, each in a process of its own."""
    from fuzz.first_seeds import KEPT
    from fuzz.targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS))
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--one", nargs=4, metavar=("NAME", "CORPUS", "FINDINGS", "SECONDS"))
    asked = parser.parse_args()
    if asked.one:
        name, corpus, findings, seconds = asked.one
        return fuzz_one(name, Path(corpus), Path(findings), float(seconds))
    seconds, broken = 60 * asked.minutes / len(asked.targets), []
    for name in asked.targets:
        with TemporaryDirectory() as corpus, TemporaryDirectory() as findings:
            words = [sys.executable, __file__, "--one", name, corpus, findings, str(seconds)]
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            runs = [line for line in done.stderr.splitlines() if "number_of_executed" in line]
            print(name, *(line.split()[-1] for line in runs), "inputs", flush=True)
            for found in Path(findings).iterdir():
                (KEPT / name).mkdir(parents=True, exist_ok=True)
                found.rename(KEPT / name / found.name)
                broken.append(f"{name}: {found.name}")
            if done.returncode and not any(line.startswith(name) for line in broken):
                broken.append(f"{name}: {done.stderr[-2000:]}")
    sys.exit("\n".join(broken))


if __name__ == "__main__":
    main()
