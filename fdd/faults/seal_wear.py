"""Actuator seal wear: the seals rub less or more, in both directions or in one."""

from functools import partial
from typing import Literal

from fdd.faults.entry import LEAKAGE, Amount, Columns, Effect, Fault, Figure, Healthy, Signature

_FRICTION = {"loose": 0.35, "tight": 2.0}
_LIPS = ("_forward", "_reverse")
_LOOSE = ("loose", "loose_forward", "loose_reverse")
_LEAK = 0.08
"""Of an internal leakage of severity 1, what a loose piston seal lets past at most: 1e-12 of 12e-12 m³/(s·Pa)
(assumption: `fdd.plant.details`). A load may hide how it rubs, not how it leaks."""


def _rubbing(kind: str) -> tuple[Effect, ...]:
    both, ways = (kind,), tuple(kind + lip for lip in _LIPS)

    def effect(parameter: str, law: str, variants: tuple[str, ...], *times: float) -> Effect:
        change: Literal["shift", "towards"] = "shift" if parameter == "middle" else "towards"
        return Effect(parameter, change, f"{kind}_friction", times=times, variants=variants, laws=(law,))

    # The plant has what both directions share once: worn in one direction, it takes half of the change.
    halves = ((both, 1.0), (ways, 0.5))
    by_law = {"friction": "whole", "coulomb": "coulomb", "stribeck": "stribeck"}
    return (
        *(effect(name + lip, law, (kind, kind + lip)) for name, law in by_law.items() for lip in _LIPS),
        *(effect("viscous", "whole", variants, half) for variants, half in halves),
        *(
            effect("viscous", "viscous", variants, 3.0 * half)
            if kind == "tight"
            else Effect("viscous", "lower", 1.0, times=(half,), variants=variants, laws=("viscous",))
            for variants, half in halves
        ),
        *(effect(f"coulomb{lip}", "viscous", (kind, kind + lip), 0.5) for lip in _LIPS),
        # Half of the change at mid-stroke, half all along in the one direction.
        effect("middle", "track", both),
        effect("middle", "track", ways, 0.5),
        *(effect(f"friction{lip}", "track", (kind + lip,), 0.5) for lip in _LIPS),
    )


def _columns(kind: str, lips: tuple[str, ...], leak: float, unit: Healthy) -> Columns:
    change = _FRICTION[kind] - 1.0
    names = [f"friction{lip}" for lip in lips]
    # A unit whose own friction hardly shows is judged by a fifth of its profile's.
    rubs = {"force": {name: change * max(unit.mean("force", name), 0.2) for name in names}}
    return {**rubs, "volume": {"leak": leak * unit.leakage_ratio}} if leak else rubs


FAULT = Fault(
    id="seal_wear", family="seal_wear", rank=1, title="actuator seal wear", thesis="Table 4.1",
    plant="the friction curve is scaled per direction; some rod leakage",
    severity="loose: friction falls to 35 %, each rod leaks 1e-14 m³/(s·Pa); tight: friction rises to 200 %; "
    "loose_forward: loose, friction of extension only; loose_reverse: of retraction only; "
    "tight_forward: tight, extension only; tight_reverse: retraction only",
    amounts=(Amount(1, "e-14 m³/(s·Pa)", "fault_leakage"),),
    source="assumption: a seal that lost its preload, or a swollen one, on both lips or one",
    next_check="Move the rod slowly and without load both ways, compare area times pressure difference "
    "with the acceptance run's, and look at the rod for oil and scores.",
    variants=("loose", "tight", "loose_forward", "loose_reverse", "tight_forward", "tight_reverse"),
    laws={
        "whole": "the whole curve, from rest to speed",
        "coulomb": "its level at speed alone",
        "stribeck": "what it has at rest beyond that level",
        "viscous": "its rise with speed, and half of the level",
        "track": "the whole curve about mid-stroke, where the seal runs most",
    },
    figures=(
        # A seal that lost its preload keeps some friction; a swollen one doubles it.
        Figure("loose_friction", _FRICTION["loose"], (0.0, 1.0), "friction over the healthy one"),
        Figure("tight_friction", _FRICTION["tight"], (1.0, 10.0), "friction over the healthy one"),
        # Table 4.1: "potential external leakage".
        Figure("loose_rod_leakage", 1e-14, LEAKAGE, "m³/(s·Pa) past each rod", (0.0, 3e-14), "leakage"),
    ),
    effects=(
        *(effect for kind in _FRICTION for effect in _rubbing(kind)),
        Effect("seal_leakage", "add", "loose_seal_leakage", variants=_LOOSE),  # a detail of the plant
        Effect("outside_1", "add", "loose_rod_leakage", variants=_LOOSE),
        Effect("outside_2", "add", "loose_rod_leakage", variants=_LOOSE),
    ),
    signatures=tuple(  # one part's weight, shared by the six ways in which it wears
        Signature(
            variant.replace("_", " ") + (" leaking" if leak else ""), partial(_columns, kind, lips, leak),
            variant=variant, commonness=weight,
        )
        for kind, leak, weight in (("loose", 0.0, 1 / 12), ("loose", _LEAK, 1 / 12), ("tight", 0.0, 1 / 6))
        for variant, lips in ((kind, _LIPS), *((kind + lip, (lip,)) for lip in _LIPS))
    ),
)  # fmt: skip
