"""``python -m tests.fuzz --count 100000 --seed 1 --kind mcap,csv``: finds go to the folder ``fuzz-finds``."""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.fuzz.cases import KINDS, Task, fuzz


def main() -> int:
    """Run the cases, print what came of them and keep the finds; 1 where there are any."""
    options = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    options.add_argument("--count", type=int, default=10_000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--kind", default=",".join(KINDS))
    given = options.parse_args()
    kinds = given.kind.split(",")
    if unknown := [k for k in kinds if k not in KINDS]:
        options.error(f"no such kind: {', '.join(unknown)}; there are: {', '.join(KINDS)}")
    tasks = [[Task(k, given.seed, n) for n in range(given.count // len(kinds))] for k in kinds]
    finds = []
    with ThreadPoolExecutor(2) as pool:
        for kind, out in zip(kinds, pool.map(fuzz, tasks), strict=True):
            print(kind, *(f"{what} {out.counts[kind, what]}" for what in ("read", "refused", "find")))
            finds += out.finds
    for task, what in finds:
        suffix, raw = task.content()
        kept = Path("fuzz-finds") / f"{task.kind}-{task.seed}-{task.number}{suffix}"
        kept.parent.mkdir(exist_ok=True)
        kept.write_bytes(raw)
        print(f"{kept}: {what}")
    return 1 if finds else 0


if __name__ == "__main__":
    sys.exit(main())
