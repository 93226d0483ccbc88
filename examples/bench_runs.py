"""Healthy runs of the real bench, on profiles made of any three runs of the other session.

    python examples/bench_runs.py RECORDINGS [--draws 6] [--seed 1]

RECORDINGS holds session_17oct and session_18oct of the bench's public recordings. Their columns have neither
names nor units: the map is proposed from one of the runs, and the authors' calibration sheet gives the scales
that no recording tells. For each draw three runs
of one session make the profile, and all runs of the other session are diagnosed: they are healthy, so
every fault that is answered is a false one.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from fdd.campaign.scores import rate, wilson
from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.identify import identify_unit
from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import open_log
from fdd.logs.mapping import given_of, propose
from fdd.unit import Unit

EXAMPLES = Path(__file__).parent
SESSIONS = ("session_17oct", "session_18oct")
SCALES = (
    "position=ADC1_Channel_14*0.025:mm",
    "pressure_1=ADC1_Channel_2*0.0625-0.625:bar",
    "pressure_2=ADC1_Channel_3*0.07576-18.333:bar",
)
"""As after --set of fdd map."""


def bench_map(recordings: Path) -> ChannelMap:
    """The bench's map as `fdd map` proposes it from one healthy run."""
    run = recordings / "session_18oct" / "exp_data_3_3.csv"
    return propose(open_log(run), given=given_of(SCALES)).channel_map("laboratory EHA bench", "bench")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--draws", type=int, default=6, help="profiles made of each session")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    base = Unit.load(EXAMPLES / "bench.base.yaml")
    channels = bench_map(options.recordings)
    runs = {
        s: {p.name: read_log(p, channels).samples for p in sorted((options.recordings / s).glob("*.csv"))}
        for s in SESSIONS
    }
    rng = np.random.default_rng(options.seed)
    verdicts: Counter[str] = Counter()
    alarms, seconds = 0, 0.0
    for mine, other in (SESSIONS, SESSIONS[::-1]):
        for _ in range(options.draws):
            names = sorted(rng.choice(sorted(runs[mine]), 3, replace=False).tolist())
            three = [runs[mine][n] for n in names]
            try:
                unit = add_baseline(identify_unit(three, base, "bench").unit, three)
            except InputError as error:
                print(f"{mine} {' '.join(names)}: not identified: {error}")
                continue
            said = []
            for name, samples in runs[other].items():
                pipeline = Pipeline(unit, keep_trajectories=False)
                pipeline.push(samples)
                found = pipeline.finish()
                verdicts[found.verdict] += 1
                alarms += len(found.faults)
                seconds += found.duration_s
                if found.faults:
                    said.append(f"{name} {found.faults[0].fault} {found.faults[0].confidence:.2f}")
            print(f"{mine} {' '.join(names)}: {', '.join(said) or 'all quiet'}", flush=True)
    total = sum(verdicts.values())
    print(f"healthy: {wilson(verdicts['healthy'], total)}; faulty {verdicts['faulty']}, "
          f"inconclusive {verdicts['inconclusive']}; {rate(alarms, seconds / 3600.0)}")  # fmt: skip


if __name__ == "__main__":
    main()
