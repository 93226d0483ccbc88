"""The monitor's status line."""

from __future__ import annotations

from fdd.cli.monitor_view import status_line
from fdd.diagnosis.findings import Estimate
from fdd.monitor import Status


def test_the_status_line_shows_the_likely_and_what_is_observable() -> None:
    leakage = Estimate(unit="m^3/(s*Pa)", baseline=6.5e-12, value=9.8123e-12, std=1.04e-13, observable=True)
    blind = Estimate(unit="N", baseline=130.0, value=90.0, std=80.0, observable=False)
    status = Status(
        61.25, 61000, "faulty", {"healthy": 0.02, "leakage": 0.9, "aeration": 0.08},
        {"leakage": leakage, "coulomb_friction": blind},
    )  # fmt: skip
    expected = "[   61.25 s] faulty  leakage 90 %  air in the oil 8 %  leakage 9.81 ± 0.10 1e-12 m³/(s·Pa)"
    assert status_line(status).plain == expected
    sure = Status(1.0, 1000, "healthy", {"healthy": 0.98, "leakage": 0.02})
    assert status_line(sure).plain == "[    1.00 s] healthy  healthy 98 %"
