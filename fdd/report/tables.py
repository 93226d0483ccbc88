"""The tables of a report: rows of text, ready to be shown."""

from __future__ import annotations

import math

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED, Diagnosis, Estimate
from fdd.report.words import family_title, fault_title, likely, percent, place, seconds, span
from fdd.unit import Unit

NOTHING = "–"


def number(value: float | None, digits: int = 4) -> str:
    """A number with a few significant digits and a true minus sign; a dash for none.

    Examples
    --------
    >>> number(6.5210001), number(-1234567.0), number(None)
    ('6.521', '−1.235e+06', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{'−' if value < 0 else ''}{abs(value):.{digits}g}"


def with_std(value: float | None, std: float | None) -> str:
    """``value ± std``, both to the two leading digits of the standard deviation.

    Examples
    --------
    >>> with_std(9.8123, 0.1049), with_std(209.7, 12.2), with_std(151.0, None)
    ('9.81 ± 0.10', '210 ± 12', '151')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    if std is None or not math.isfinite(std) or std <= 0.0 or not 1e-6 <= std < 1e6:
        return number(value)
    decimals = max(0, 1 - math.floor(math.log10(std)))
    return f"{value:.{decimals}f} ± {std:.{decimals}f}".replace("-", "−")


def estimate_rows(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """Rows of the table of estimates; keys quantity, unit, baseline, value, change, observable, held."""
    rows = []
    for name, estimate in diagnosis.estimates.items():
        rows.append(_estimate_row(name, estimate))
        for method, told in estimate.methods.items():
            other = estimate.model_copy(update={"value": told.value, "std": told.std, "held": None})
            row = _estimate_row(name, other)
            rows.append({**row, "quantity": f"{row['quantity']}, by {method}"})
    return rows


def _estimate_row(name: str, e: Estimate) -> dict[str, str]:
    _, unit, title = ESTIMATED.get(name, (e.unit, e.unit, name.replace("_", " ").capitalize()))
    scale = DISPLAY_SCALE.get(name, 1.0)
    baseline, value, std, last, last_std = (
        None if x is None else x * scale for x in (e.baseline, e.value, e.std, e.held, e.held_std)
    )
    change = NOTHING if e.observable else "not seen"
    if e.observable and e.value is not None and e.baseline:
        percent_change = round(100.0 * (e.value / e.baseline - 1.0))
        change = f"{percent_change:+d} %".replace("-", "−") if percent_change else "0 %"
    held = ""  # while it is observable, and where it never was known
    if not (e.observable or last is None or e.age_s is None or (last_std or 0.0) > abs(last)):
        held = f"{with_std(last, last_std)}, {span(e.age_s)} before the end"
    return {
        "quantity": title, "unit": unit, "baseline": number(baseline), "value": with_std(value, std),
        "change": change, "observable": "yes" if e.observable else "no", "held": held,
    }  # fmt: skip


def probability_rows(diagnosis: Diagnosis) -> list[tuple[str, str, float]]:
    """Families by probability at the end of the log: title, percent in words, share; the likely ones only."""
    return [(family_title(k), percent(p), min(p, 1.0)) for k, p in likely(diagnosis)]


def sensor_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Channels that are not, or not always, to be trusted: name, and what is wrong since when."""
    rows = []
    for s in (s for s in diagnosis.sensors if s.state != "trusted"):
        since = "" if s.since is None else f", since {seconds(s.since)}"
        rows.append((s.channel.replace("_", " "), s.state.replace("_", " ") + since))
    return rows


def invisible_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What this log would not have shown: fault, and below which severity; the hardest to see first."""
    rows = []
    for i in sorted(diagnosis.not_visible, key=lambda i: -math.inf if i.severity is None else -i.severity):
        below = "at any severity" if i.severity is None else f"below severity {i.severity:.2f}"
        rows.append((fault_title(i.fault) + (f" ({place(i)})" if place(i) else ""), below))
    return rows


def quality_rows(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What was missing in the data, as counts and shares."""
    q = diagnosis.quality

    def counted(count: int, total: int) -> str:
        share = 100.0 * count / max(total, 1)
        told = f"{share:.2g} %" if share >= 0.01 else "under 0.01 %"
        return f"{grouped(count)} ({told})" if count and total > 0 else grouped(count)

    return [
        ("Samples", grouped(diagnosis.samples)),
        ("Dropped samples", counted(q.dropped_samples, diagnosis.samples + q.dropped_samples)),
        ("Samples with missing values", counted(q.nan_samples, diagnosis.samples)),
        ("Jumps in time", grouped(q.time_jumps)),
    ]


def grouped(count: int) -> str:
    """A count with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")


def unit_rows(unit: Unit) -> list[tuple[str, str]]:
    """The unit's profile in a few lines, in everyday units."""
    c, f, oil = unit.cylinder, unit.friction, unit.oil
    leakage, modulus = f"{unit.pump.total_leakage * 1e12:.4g}", f"{oil.bulk_modulus * 1e-6:.4g}"
    rows = [
        ("Profile", unit.name),
        ("Axis", unit.axis),
        ("Piston areas", f"{c.area_1 * 1e4:.4g} and {c.area_2 * 1e4:.4g} cm²"),
        ("Stroke", f"{c.stroke * 1e3:.4g} mm"),
        ("Moving mass", f"{c.moving_mass:.4g} kg"),
        ("Chamber volumes at mid-stroke", f"{c.volume_1 * 1e3:.4g} and {c.volume_2 * 1e3:.4g} L"),
        ("Pump displacement", f"{unit.pump.displacement * 1e6 * 2 * math.pi:.4g} cm³/rev"),
        ("Leakage coefficient", f"{leakage} × 10⁻¹² m³/(s·Pa) at {oil.reference_temperature:.3g} °C"),
        ("Effective bulk modulus", f"{modulus} MPa at {oil.reference_pressure * 1e-5:.3g} bar"),
        ("Coulomb friction", f"{f.forward.coulomb:.4g} N forward, {f.reverse.coulomb:.4g} N reverse"),
        ("Fastest pump speed", f"{unit.drive.max_speed * 30.0 / math.pi:.4g} rpm"),
        ("Wanted false alarms", f"{unit.monitoring.false_alarms_per_hour * 3600.0:.3g} per hour"),
    ]
    if unit.description:
        rows.insert(2, ("Description", unit.description))
    known = unit.baseline
    told = "none in the profile" if known is None else f"from {span(known.seconds)} of healthy logs"
    return [*rows, ("Healthy baseline", told)]
