"""A unit's own effects, from its healthy logs."""
from __future__ import annotations
from dataclasses import replace
import numpy as np
from fdd.balances.balances import BALANCES
from fdd.balances.effects import first_effects
from fdd.balances.ledger import Ledger, widened
from fdd.balances.rows import RowMaker


def ledger_of(samples, unit, effects):
    maker, ledger = RowMaker(unit), Ledger(unit, effects)
    ledger.push(*maker.push(samples))
    ledger.push(*maker.push(None))
    return ledger


def own_effects(logs, unit, ledgers=None, first=None):
    """Effects of the unit: each healthy log differs from the unit's mean by its own draw of `between`."""
    first = first or {n: first_effects(n) for n in BALANCES}
    ledgers = ledgers or [ledger_of(s, unit, first) for s in logs]
    out = {}
    for name, effects in first.items():
        prior = np.linalg.inv(effects.covariance)
        info, vec = prior.copy(), prior @ effects.mean
        between = effects.between
        noise = []
        for l in ledgers:
            m, v = widened(np.array([e[0] for e in l.entries[name]]), np.array([e[1] for e in l.entries[name]]), effects.wander)
            m, v = m.sum(axis=0), v.sum(axis=0)
            rows = sum(e[2] for e in l.entries[name])
            if not rows: continue
            m, v = widened(m, v, between)
            info += m; vec += v
            noise.append(np.median([e[3] for e in l.entries[name] if e[2]]))
        cov = np.linalg.inv(info)
        out[name] = replace(effects, mean=cov @ vec, covariance=cov + np.diag(between**2), noise=float(np.sqrt(np.median(noise))) if noise else effects.noise)
    return out
