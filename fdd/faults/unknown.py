"""Something is wrong that no entry of the catalogue explains."""

from fdd.faults.entry import Fault

FAULT = Fault(
    id="unknown", family="unknown", title="unknown fault",
    plant="something is wrong that is none of the above",
    severity="has no scale",
    source="",
    next_check="Repeat the healthy reference run and compare it with the unit's baseline, quantity by "
    "quantity, before anything is taken apart.",
)  # fmt: skip
