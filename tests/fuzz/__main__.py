"""``python -m tests.fuzz --count 100000 --seed 1 --kind mcap,csv --workers 2``: finds go to ``--keep``."""

import argparse
import sys
from pathlib import Path

from tests.fuzz.targets import KINDS
from tests.fuzz.workers import fuzz, tasks_of


def main() -> int:
    """Run the cases, print what came of them and keep the finds; 1 where there are any."""
    options = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    options.add_argument("--count", type=int, default=10_000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--kind", default=",".join(KINDS))
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--keep", type=Path, default=Path("fuzz-finds"), help="folder for failing cases")
    given = options.parse_args()
    kinds = given.kind.split(",")
    if unknown := [k for k in kinds if k not in KINDS]:
        options.error(f"no such kind: {', '.join(unknown)}; there are: {', '.join(KINDS)}")
    out = fuzz(tasks_of(kinds, given.count, given.seed), given.workers)
    print(f"{'kind':10s} {'read':>8s} {'refused':>8s} {'finds':>6s}   slowest")
    for kind in kinds:
        counts = [out.counts[kind, what] for what in ("read", "refused", "find")]
        print(f"{kind:10s} {counts[0]:8d} {counts[1]:8d} {counts[2]:6d}   {out.slowest.get(kind, 0.0):.2f} s")
    for task, what in out.finds:
        suffix, raw = task.content()
        given.keep.mkdir(parents=True, exist_ok=True)
        kept = given.keep / f"{task.kind}-{task.seed}-{task.number}{suffix}"
        kept.write_bytes(raw)
        print(f"{kept}: {what}")
    return 1 if out.finds else 0


if __name__ == "__main__":
    sys.exit(main())
