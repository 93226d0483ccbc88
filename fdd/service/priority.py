"""How urgent an alarm is: how large the fault, how sure, and what it takes away."""

from __future__ import annotations

from bisect import bisect_right

from fdd.diagnosis.findings import FaultFinding

PRIORITIES = ("low", "medium", "high", "urgent")
"""From the least on; four, as ISA-18.2 advises at most."""
LEVELS = (0.25, 0.5, 0.75)
"""Severities, 1 being gross, at which the next level begins."""
UNSIZED_LEVEL = 1
"""Of a fault that has no severity (a failed sensor, an unknown fault): neither small nor gross."""
DOUBTED = 0.5
"""Confidence below which an alarm is one priority lower: no fault is then more likely than not."""
AT_ONCE = {"external_leakage", "check_valve_stuck_open", "check_valve_clogged", "relief_valve_stuck_open"}
"""Faults one priority up, for their consequence and the time that is left, by which ISA-18.2 ranks alarms.
Oil that is lost outside does not come back, and the circuit is closed; a valve that fails takes the force of
one direction away at once, and no controller makes up for it. That this is worth one step is an assumption,
no figure of the thesis."""


def severity_level(finding: FaultFinding) -> int:
    """How many of `LEVELS` the fault's severity surely passed: the lower end of its 80 % interval counts.

    Examples
    --------
    >>> leak = dict(fault="pump_wear", family="leakage", ambiguity=["pump_wear"], onset_s=0.0, detected_s=9.0)
    >>> severity_level(FaultFinding(**leak, confidence=0.9, severity=0.6, severity_interval=(0.5, 0.7)))
    2
    """
    least = finding.severity_interval[0] if finding.severity_interval else finding.severity
    return UNSIZED_LEVEL if least is None else bisect_right(LEVELS, least)


def priority_of(finding: FaultFinding) -> str:
    """One of `PRIORITIES`. Faults that look alike count as the worst of them.

    Examples
    --------
    >>> leak = dict(family="leakage", onset_s=0.0, detected_s=9.0, severity=0.3)
    >>> [priority_of(FaultFinding(**leak, fault=f, ambiguity=[f], confidence=0.9))
    ...  for f in ("pump_wear", "external_leakage")]
    ['medium', 'high']
    """
    up = bool(AT_ONCE & {finding.fault, *finding.ambiguity})
    place = severity_level(finding) + up - (finding.confidence < DOUBTED)
    return PRIORITIES[min(max(place, 0), len(PRIORITIES) - 1)]
