"""What an entry of the catalogue holds, and the words that entries share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fdd.faults.effect import Effect, Figure
from fdd.faults.signature import Signature

FAMILIES = (
    "healthy", "leakage", "seal_wear", "aeration", "check_valve", "relief_valve",
    "friction", "motor", "sensor", "unknown",
)  # fmt: skip
"""Keys of an answer's probabilities, in the contract's order."""

ASSUMED = "assumption: scale chosen so that 1.0 is gross and 0.2 is near the limit of what sensors show"


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One entry of the catalogue.

    Attributes
    ----------
    id, family : the contract's words.
    title : for people.
    thesis : where the thesis names or injects it; a package's own fault has none.
    plant : what it does to the plant, in words.
    severity : what severity 1.0 means, in physical units, on an actuator of the thesis's size; campaigns
        scale it for machines of other sizes (`fdd.campaign.sizes.Scale.fault_scales`).
    source : where that scale comes from, or that it is an assumption.
    next_check : what a technician does to confirm it, one sentence.
    variants, sides : choices that the injection takes; the first is the default.
    laws : name to how the plant may have it, the first by default. Signatures never see which.
    figures : numbers behind severity 1.
    effects : what they change in the plant.
    in_measurement : `fdd.plant.sensors` injects it, not the plant.
    signatures : how it shows in the balances; any of them speaks for the fault.
    rank : place within the family, as in the contract; a new fault comes last.
    """

    id: str
    family: str
    title: str
    plant: str
    severity: str
    source: str
    next_check: str
    thesis: str = ""
    variants: tuple[str, ...] = ()
    sides: tuple[int, ...] = ()
    laws: Mapping[str, str] = field(default_factory=dict)
    figures: tuple[Figure, ...] = ()
    effects: tuple[Effect, ...] = ()
    in_measurement: bool = False
    signatures: tuple[Signature, ...] = ()
    rank: int = 99

    @property
    def simulated(self) -> bool:
        """Whether `fdd.plant` injects it."""
        return bool(self.effects) or self.in_measurement
