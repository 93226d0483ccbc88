"""What each fault does to the balances' coefficients."""
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from fdd.balances.balances import BALANCES
from fdd.balances.effects import Effects
from fdd.balances.quantities import Scales


@dataclass
class Hypothesis:
    fault: str
    label: str
    columns: dict      # balance -> (n,q)
    scale: np.ndarray  # (q,) prior std of the amplitudes, in severities
    signed: bool
    side: int | None = None
    variant: str | None = None
    commonness: float = 1.0


def _col(balance, **values):
    c = BALANCES[balance].columns
    out = np.zeros((len(c), 1))
    for k, v in values.items():
        out[c.index(k), 0] = v
    return {balance: out}


def hypotheses(unit, effects: dict[str, Effects], scales: Scales):
    f = scales.fault_leakage / scales.leakage
    out = []
    def add(fault, label, columns, scale=0.7, signed=True, **kw):
        out.append(Hypothesis(fault, label, columns, np.atleast_1d(np.asarray(scale, float)), signed, **kw))
    add("internal_leakage", "internal leakage", _col("volume", leak=f))
    add("pump_wear", "pump wear", _col("volume", wear=f * scales.speed / 100.0 * 1.0, gain=-0.02))
    add("case_drain_seal_failure", "case", _col("volume", case=2 * f))
    for s in (1, 2):
        add("external_leakage", f"outside {s}", {**_col("volume", **{f"outside_{s}": 0.5 * f}), **_col("reservoir", drift=1.0)}, side=s)
    add("external_leakage", "reservoir", _col("reservoir", drift=1.0))
    add("aeration", "air", _col("volume", air=1.0))
    for s in (1, 2):
        add("check_valve_stuck_open", f"valve {s}", _col("volume", **{f"valve_{s}": 1.0}), side=s)
        add("check_valve_clogged", f"clogged {s}", _col("refeed", **{f"drop_{s}": 0.05}), side=s)
    add("relief_valve_stuck_open", "relief", _col("volume", relief_12=1.0, relief_21=1.0))
    for c in ("relief_12", "relief_21"):  # one of the two; a check valve of either side sticks more often
        add("relief_valve_stuck_open", c, _col("volume", **{c: 1.0}), commonness=0.5)
    fm = effects["force"].mean
    c = BALANCES["force"].columns
    i, j = c.index("friction_forward"), c.index("friction_reverse")
    fwd, rev = max(fm[i], 0.2), max(fm[j], 0.2)
    for name, k in (("loose", -0.65), ("tight", 1.0)):
        add("seal_wear", name, _col("force", friction_forward=k * fwd, friction_reverse=k * rev), variant=name)
        add("seal_wear", name + " forward", _col("force", friction_forward=k * fwd), variant=name + "_forward")
        add("seal_wear", name + " reverse", _col("force", friction_reverse=k * rev), variant=name + "_reverse")
    t = effects["torque"].mean
    ct = BALANCES["torque"].columns
    motor = {n: 0.43 * t[ct.index(n)] for n in ct if n != "zero"}
    add("motor_degradation", "motor", _col("torque", **motor))
    vl, ll = effects["volume"].mean, BALANCES["volume"].columns
    visc = t[ct.index("viscous")]
    for name, ratio in (("thin", 0.5), ("thick", 2.0)):
        k = 1.0 / ratio - 1.0
        vol = _col("volume", **{n: k * vl[ll.index(n)] for n in ("leak", "leak_square", "case", "wear")})
        add("oil_degradation", name, {**vol, **_col("torque", viscous=(ratio - 1.0) * visc)}, variant=name)
    for c in ("order_1", "order_2"):
        add("coupling_wear", f"lines {c}", _col("shaft", **{c: 0.1}))
    b = 0.073
    add("pressure_sensor_bias", "bias dp", _col("coherence", zero=b), signed=False)
    add("pressure_sensor_bias", "bias dp by torque", _col("torque", zero=-b * t[1]), signed=False)
    add("pressure_sensor_bias", "bias p1", {**_col("coherence", zero=-b), **_col("refeed", drop_1=-b)}, signed=False)
    add("pressure_sensor_bias", "bias p2", {**_col("coherence", zero=b), **_col("refeed", drop_2=-b)}, signed=False)
    return out
