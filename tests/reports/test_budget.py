"""The loss budget's tables, and its departures on two simulated logs."""

from __future__ import annotations

from fdd.campaign.dataset import Conditions, Entry, Label
from reports.budget import Departure, Said, table


def entry(file: str, *, onset: float | None, severity: float = 0.5, visible: bool = True) -> Entry:
    leak = Label(
        fault="internal_leakage", family="leakage", severity=severity, onset_s=onset or 0.0, profile="step"
    )
    faults = () if onset is None else (leak,)
    return Entry(
        file=f"unit_000/{file}", truth=f"unit_000/truth_{file}", unit="unit_000", base="axis_a",
        duration_s=60.0, samples=60_000, faults=faults, truth_medians={},
        visible=None if onset is None else visible, structure="thesis",
        scenario=Conditions(
            load="gust", duty="steps", control="position", oil_temperature=30.0, charge_factor=1.0, seed=1
        ),
    )  # fmt: skip


def test_what_is_lost_is_told_by_its_kind() -> None:
    leak = (("pump_wear", ("pump_wear", "internal_leakage")),)
    found = [
        Said(entry("a", onset=0.0), "faulty", 9.0, leak),
        Said(entry("b", onset=20.0), "faulty", 9.0, (("aeration", ("aeration",)),)),
        Said(entry("c", onset=20.0), "healthy", 2.0, ()),
        Said(entry("d", onset=20.0, severity=0.1), "healthy", 2.0, ()),
        Said(entry("e", onset=20.0, visible=False), "healthy", 2.0, ()),
        Said(entry("f", onset=None), "faulty", 6.0, leak),
        Said(entry("g", onset=None), "healthy", 1.0, ()),
    ]
    lines = table(found).splitlines()
    (whole,) = (line for line in lines if line.startswith("| all"))
    assert "0.67" in whole and "of 3" in whole and "0.33" in whole, (
        "a small and an invisible one are not asked"
    )
    (start,) = (line for line in lines if "from the first sample" in line)
    assert "1.00" in start and "of 1" in start
    assert "0.50" in lines[0] and "of 2" in lines[0], "healthy logs called faulty"
    assert any("unit_000/f 6.0" in line for line in lines)


def test_departures_are_told_over_what_is_stated() -> None:
    """Test: a hundred departures, two of them far. Expected: rms, share, and the farthest log."""
    found = [Departure("volume", "leak", 1.0, 0.05, f"unit_000/log_{k:03d}") for k in range(98)]
    found += [Departure("volume", "leak", z, 0.05, "unit_000/odd") for z in (4.0, -10.0)]
    found += [Departure("force", "damping", 1.0, 0.5, "unit_000/few") for _ in range(5)]
    (row,) = (line for line in table(found).splitlines() if "leak" in line)
    assert (
        "| 100 |" in row and "1.48" in row and "1.46" in row and "0.02" in row and "unit_000/odd -10.0" in row
    )
    assert "damping" not in table(found), "too few logs say nothing"
