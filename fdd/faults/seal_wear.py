"""Actuator seal wear: the seals rub less or more, in both directions or in one."""

from __future__ import annotations

from functools import partial

from fdd.faults.effect import LEAKAGE, Effect, Figure
from fdd.faults.entry import Fault
from fdd.faults.signature import Columns, Healthy, Signature

_FRICTION = {"loose": 0.35, "tight": 2.0}
_LIPS = ("_forward", "_reverse")
_LOOSE = ("loose", "loose_forward", "loose_reverse")


def _rubbing(kind: str) -> tuple[Effect, ...]:
    by = f"{kind}_friction"
    ways = tuple(kind + lip for lip in _LIPS)
    by_law = {"friction": "whole", "coulomb": "coulomb", "stribeck": "stribeck"}
    return (
        *(
            Effect(f"{name}{lip}", "towards", by, variants=(kind, kind + lip), laws=(law,))
            for name, law in by_law.items()
            for lip in _LIPS
        ),
        # The plant has the rest in common: worn in one direction, it takes half of the change.
        *(
            Effect("viscous", "towards", by, times=(half * times,), variants=variants, laws=(law,))
            for law, times in (("whole", 1.0), ("viscous", 3.0))
            for half, variants in ((1.0, (kind,)), (0.5, ways))
            if not (law == "viscous" and kind == "loose")
        ),
        *(
            Effect("viscous", "lower", 1.0, times=(half,), variants=variants, laws=("viscous",))
            for half, variants in ((1.0, (kind,)), (0.5, ways))
            if kind == "loose"
        ),
        *(
            Effect(
                f"coulomb{lip}", "towards", by, times=(0.5,), variants=(kind, kind + lip), laws=("viscous",)
            )
            for lip in _LIPS
        ),
        Effect("middle", "shift", by, variants=(kind,), laws=("track",)),
        # Both directions share what mid-stroke does: half of the change there, half all along in the one.
        Effect("middle", "shift", by, times=(0.5,), variants=ways, laws=("track",)),
        *(
            Effect(f"friction{lip}", "towards", by, times=(0.5,), variants=(kind + lip,), laws=("track",))
            for lip in _LIPS
        ),
    )


def _columns(kind: str, lips: tuple[str, ...], unit: Healthy) -> Columns:
    change = _FRICTION[kind] - 1.0
    names = [f"friction{lip}" for lip in lips]
    # A unit whose own friction hardly shows is judged by a fifth of its profile's.
    return {"force": {name: change * max(unit.mean("force", name), 0.2) for name in names}}


FAULT = Fault(
    id="seal_wear",
    family="seal_wear",
    rank=1,
    title="actuator seal wear",
    thesis="Table 4.1",
    plant="the friction curve is scaled per direction; some rod leakage",
    severity="loose: friction falls to 35 %, each rod leaks 1e-14 m³/(s·Pa); tight: friction rises to 200 %; "
    "loose_forward: loose, friction of extension only; loose_reverse: of retraction only; "
    "tight_forward: tight, extension only; tight_reverse: retraction only",
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
        Figure(
            "loose_rod_leakage",
            1e-14,
            LEAKAGE,
            "m³/(s·Pa) from each chamber past its rod to the outside, where the seals are loose (Table 4.1: "
            '"potential external leakage")',
            usual=(0.0, 3e-14),
            grows="leakage",
        ),
    ),
    effects=(
        *(effect for kind in _FRICTION for effect in _rubbing(kind)),
        Effect("seal_leakage", "add", "loose_seal_leakage", variants=_LOOSE),  # a detail of the plant
        Effect("outside_1", "add", "loose_rod_leakage", variants=_LOOSE),
        Effect("outside_2", "add", "loose_rod_leakage", variants=_LOOSE),
    ),
    signatures=tuple(
        Signature(variant.replace("_", " "), partial(_columns, kind, lips), variant=variant)
        for kind in _FRICTION
        for variant, lips in ((kind, _LIPS), *((kind + lip, (lip,)) for lip in _LIPS))
    ),
)
