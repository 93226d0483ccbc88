"""Fault detection and diagnosis for electro-hydrostatic actuators (EHAs).

======================  ==========================================================================
`simulate`              a scenario on a unit: samples as its log would show them, and the truth
`read_log`              a log of any format in SI units, and what was odd about it
`identify`              healthy logs to a `Unit`, the profile of one actuator, that can be saved
`diagnose`              a log to a `Diagnosis`: verdict, faults, estimates
`Pipeline`              the same in blocks of any size, as they come: `push`, `finish`
`load_dataset`          what ``fdd generate`` made, as pandas and NumPy, with splits by unit
`Scenario`, `Samples`   what `simulate` takes, and the channels that all of these take and give
`Diagnosis`             the answer, as ``fdd diagnose --json`` prints it
======================  ==========================================================================

>>> from fdd import Scenario, diagnose, simulate
>>> leak = {"fault": "internal_leakage", "severity": 0.8, "onset": 8.0}
>>> run = simulate("axis_a", Scenario(duration=20, load={"name": "spring"}, faults=[leak], seed=4))
>>> answer = diagnose(run.samples, unit="axis_a")  # or diagnose("run.mcap", unit="unit.yaml")
>>> answer.verdict, answer.faults[0].fault, answer.faults[0].onset_s
('faulty', 'internal_leakage', 8.0)
>>> leakage = answer.estimates["leakage"]  # m³/(s·Pa)
>>> leakage.value > leakage.baseline + 5 * leakage.std
True

Samples are NumPy columns in SI units (`fdd.samples.CHANNELS`: names, units, meaning); what is missing is NaN.
Unusable input raises `InputError`, a ValueError of one line: what is wrong, where, and what mends it.
The filters stand on their own in the package `estimators`, with filterpy's interface.
"""

from __future__ import annotations

TYPE_CHECKING = False  # type checkers know the name; the module typing takes longer than all else here
if TYPE_CHECKING:
    from fdd.campaign.loading import load_dataset
    from fdd.diagnosis.findings import Diagnosis
    from fdd.diagnosis.pipeline import Pipeline
    from fdd.errors import InputError
    from fdd.identification.from_logs import identify
    from fdd.logs.read import read_log
    from fdd.offline import diagnose
    from fdd.plant.scenario import Scenario
    from fdd.plant.simulate import simulate
    from fdd.samples import Samples
    from fdd.unit import Unit

__version__ = "0.1.0"
__all__ = [
    "Diagnosis", "InputError", "Pipeline", "Samples", "Scenario", "Unit", "diagnose", "identify",
    "load_dataset", "read_log", "simulate",
]  # fmt: skip

if not TYPE_CHECKING:  # or every name would be one for type checkers
    _HOMES = {
        "Diagnosis": "fdd.diagnosis.findings", "InputError": "fdd.errors",
        "Pipeline": "fdd.diagnosis.pipeline", "Samples": "fdd.samples", "Scenario": "fdd.plant.scenario",
        "Unit": "fdd.unit", "diagnose": "fdd.offline",
        "identify": "fdd.identification.from_logs", "load_dataset": "fdd.campaign.loading",
        "read_log": "fdd.logs.read", "simulate": "fdd.plant.simulate",
    }  # fmt: skip

    def __getattr__(name: str) -> object:
        """Load a door when it is first asked for (PEP 562): what needs none of them starts at once."""
        if name not in _HOMES:
            raise AttributeError(f"module 'fdd' has no attribute {name!r}")
        from importlib import import_module

        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
