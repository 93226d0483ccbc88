"""The verdict in words that a test engineer would show a customer."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from fdd.diagnosis.findings import ESTIMATED, Diagnosis, FaultFinding, Invisible, present
from fdd.diagnosis.model import HELD_IN_DOUBT
from fdd.faults import CATALOGUE
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

FAMILY_TITLES = {
    "healthy": "Healthy", "leakage": "Leakage", "seal_wear": "Seal wear", "aeration": "Air in the oil",
    "check_valve": "Check valve", "relief_valve": "Relief valve", "friction": "Friction",
    "motor": "Motor and coupling", "sensor": "Sensor", "unknown": "Unknown fault",
}  # fmt: skip

MARKS = {"healthy": "✓", "faulty": "!", "inconclusive": "?"}


@dataclass(frozen=True)
class FindingWords:
    """One finding in words; empty strings where there is nothing to say. `place` is where, and of which kind
    (chamber, channel, variant), `check` what a technician does to confirm it."""

    headline: str
    alternatives: str
    severity: str
    detection: str
    evidence: list[str]
    place: str
    check: str


@dataclass(frozen=True)
class VerdictWords:
    """The whole verdict in words: a headline, what stands beside it, and each finding."""

    kind: str
    mark: str
    headline: str
    remark: str
    findings: list[FindingWords] = field(default_factory=list)


def fault_title(name: str) -> str:
    """A fault's name for people; an id that the catalogue lacks is shown with blanks."""
    found = CATALOGUE.get(name)
    return name.replace("_", " ") if found is None else found.title


def family_title(name: str) -> str:
    """The same of a family."""
    return FAMILY_TITLES.get(name, name.replace("_", " ").capitalize())


def percent(share: float) -> str:
    """A probability in percent that never claims certainty.

    Examples
    --------
    >>> percent(0.97), percent(0.998), percent(0.002)
    ('97 %', 'over 99 %', 'under 1 %')
    """
    if share > 0.995:
        return "over 99 %"
    if share < 0.005:
        return "under 1 %"
    return f"{100.0 * share:.0f} %"


def seconds(value: float) -> str:
    """A time on the log, to a tenth of a second below ten minutes."""
    if not math.isfinite(value):
        return "an unknown time"
    return f"{value:.1f} s" if abs(value) < 600.0 else f"{value:.0f} s"


def span(value: float) -> str:
    """A duration, e.g. ``60 s``, ``4.5 s`` or ``25 min``."""
    if value >= 5400.0:
        return f"{value / 3600.0:.1f} h"
    if value >= 600.0:
        return f"{value / 60.0:.0f} min"
    return f"{value:.0f} s" if value >= 10.0 else f"{value:.1f} s"


def listed(names: list[str], last: str = "or") -> str:
    """``a``, ``a or b``, ``a, b or c``; with another word before the last."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def candidates(finding: FaultFinding) -> str:
    """The fault, or the faults that it cannot be told from, each with its share where that is known."""
    first, *others = (
        fault_title(f) + (f" ({percent(finding.shares[f])})" if f in finding.shares else "")
        for f in dict.fromkeys([finding.fault, *finding.ambiguity])
    )
    if len(others) > 1:
        return f"{first} or one of {len(others)} others"
    return listed([first, *others])


def finding_words(finding: FaultFinding, unit: Unit | None = None) -> FindingWords:
    """One finding in words; severity 1 is told for the size of `unit`, of the thesis's where None."""
    title = candidates(finding)
    parts = [title[:1].upper() + title[1:], f"since {seconds(finding.onset_s)}"]
    if finding.severity is not None:
        parts.append(f"severity {finding.severity:.2f}")
    parts.append(f"{percent(finding.confidence)} sure")
    scale = severity_one(finding.fault, unit)
    severity = f"Severity 1.0 means: {scale}." if scale and finding.severity is not None else ""
    if severity and finding.severity_interval is not None:
        low, high = finding.severity_interval
        severity = f"Severity between {low:.2f} and {high:.2f} (80 %). {severity}"
    delay = finding.detected_s - finding.onset_s
    detection = f"Detected at {seconds(finding.detected_s)}"
    if delay >= 0.0:
        detection += f", {delay:.1f} s after its onset"
    if finding.onset_interval is not None:
        early, late = finding.onset_interval
        detection += f". It began between {seconds(early)} and {seconds(late)} (80 %)"
    check = f"To confirm it: {finding.next_check}" if finding.next_check else ""
    named = place(finding)
    where = f"Where and how: {named}." if named else ""
    told = ", ".join(parts), _alternatives(finding), severity, f"{detection}.", list(finding.evidence)
    return FindingWords(*told, where, check)


def _alternatives(finding: FaultFinding) -> str:
    """What else it may be; less likely is what has under half the share of the fault that is named."""
    shares, alike, less = finding.shares, [], []
    for name in finding.ambiguity:
        if name in shares and shares[name] < 0.5 * shares.get(finding.fault, 1.0):
            less.append(f"{fault_title(name)} ({percent(shares[name])})")
        elif name != finding.fault:
            alike.append(fault_title(name) + (f" ({percent(shares[name])})" if name in shares else ""))
    said = [f"it could as well be {listed(alike)}"] if alike else []
    said += [f"less likely it is {listed(less)}"] if less else []
    if not said:
        return ""
    text = "; ".join(said)
    return (
        f"{text[:1].upper()}{text[1:]}: the signals in this log cannot tell these apart, "
        f"and {percent(finding.confidence)} is for the group as a whole."
    )


def severity_one(fault: str, unit: Unit | None) -> str:
    """What severity 1 of a fault means, in figures of this unit's size; of the thesis's where None."""
    entry = CATALOGUE.get(fault)
    if entry is None or unit is None or not entry.amounts:
        return "" if entry is None else entry.severity
    own, thesis = Scales.of(unit), Scales.of(Unit.load("axis_a"))
    factors = {a.words(): a.words(getattr(own, a.grows) / getattr(thesis, a.grows)) for a in entry.amounts}
    return re.sub("|".join(map(re.escape, factors)), lambda found: factors[found[0]], entry.severity)


def place(named: FaultFinding | Invisible) -> str:
    """Which chamber, channel or variant is named, or an empty string."""
    parts = [] if named.side is None else [f"chamber {named.side}"]
    return ", ".join([*parts, *(x.replace("_", " ") for x in (named.channel, named.variant) if x)])


def verdict_words(diagnosis: Diagnosis, unit: Unit | None = None) -> VerdictWords:
    """The diagnosis in words."""
    kind, mark = diagnosis.verdict, MARKS[diagnosis.verdict]
    ordered = sorted(diagnosis.faults, key=lambda f: -f.confidence)
    findings = [finding_words(f, unit) for f in ordered]
    if kind == "healthy":
        sure = diagnosis.probabilities.get("healthy")
        remark = "" if sure is None else f"{percent(sure).capitalize()} sure."
        return VerdictWords(kind, mark, f"Healthy: no fault found in {span(diagnosis.duration_s)}", remark)
    if kind == "inconclusive":
        unseen = (name for name, e in diagnosis.estimates.items() if not e.observable)
        blind = [ESTIMATED[name][2].lower() if name in ESTIMATED else name for name in unseen]
        leaning = _leaning(diagnosis)
        note = diagnosis.quality.notes[0].strip().rstrip(".") if diagnosis.quality.notes else ""
        if diagnosis.samples == 0:
            note = "the log holds no samples"
        elif not note and blind and len(blind) == len(diagnosis.estimates):
            note = "the motion in this log shows none of the quantities that faults act on"
        why = note or f"no answer is sure enough after {span(diagnosis.duration_s)}"
        hints = [
            f"Most probable: {leaning}." if leaning else "",
            f"Not observable in this log: {', '.join(blind)}." if blind else "",
            "What is suspected stands below; take it as a hint, not as a finding." if findings else "",
        ]
        return VerdictWords(kind, mark, f"Inconclusive: {why}", " ".join(filter(None, hints)), findings)
    if not findings:
        return VerdictWords(kind, mark, "Faulty: the log differs from a healthy one", _leaning(diagnosis))
    likelier = sum(f.confidence >= HELD_IN_DOUBT for f in diagnosis.faults)
    left = len(findings) - likelier
    which = "is a hint" if left == 1 else f"{left} are hints"
    remarks = [
        f"{likelier} faults found, the surest first." if likelier > 1 else "",
        f"The last {which}, less likely than not." if left else "",
    ]
    return VerdictWords(kind, mark, findings[0].headline, " ".join(filter(None, remarks)), findings)


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one line, for a terminal or a page's title."""
    return verdict_words(diagnosis).headline


def _leaning(diagnosis: Diagnosis) -> str:
    """The two most probable families, or an empty string."""
    top = likely(diagnosis)[:2]
    return ", ".join(f"{family_title(name).lower()} {percent(p)}" for name, p in top)


def likely(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """Families of at least half a percent by the probability at the end of the log that each is there."""
    there = present(diagnosis.probabilities, diagnosis.faults)
    return sorted(((k, p) for k, p in there.items() if p >= 0.005), key=lambda item: -item[1])


def second_opinion_words(diagnosis: Diagnosis) -> str:
    """What a classifier says beside the answer; empty where none was asked."""
    other = diagnosis.second_opinion
    if other is None:
        return ""
    return (
        f"The classifier {other.classifier} takes it for {other.answer.replace('_', ' ')} "
        f"({100 * other.probability:.0f} %)."
    )
