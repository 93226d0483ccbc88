"""Piston seal extrusion: pressure has pushed the piston's seal into its gap and bitten pieces out of it.

What is left of the lip no longer presses on the bore: oil passes the piston, in proportion to pressure over
viscosity as through any narrow clearance, and the piston rubs less. Each of the two alone is another fault: a
leak with friction as it was is internal leakage, less friction without a leak is a worn seal. Where a log
hardly slides its friction cannot be seen, and the answer names internal leakage beside this one.
"""

from __future__ import annotations

from fdd.faults import Amount, Columns, Effect, Fault, Figure, Healthy, Signature

LOST = 0.5
"""Share of the friction that is gone at severity 1."""


def shows(unit: Healthy) -> Columns:
    """The chambers' oil leaks as in internal leakage of severity 1, and the piston rubs half as much."""
    return {
        "volume": {"leak": unit.leakage_ratio},
        "force": {"friction_forward": -LOST, "friction_reverse": -LOST},
    }


FAULT = Fault(
    id="piston_seal_extrusion",
    family="seal_wear",
    title="extruded piston seal",
    plant="oil passes the piston, and the piston rubs less",
    severity="+12e-12 m³/(s·Pa) past the piston and 50 % of the friction gone",
    amounts=(Amount(12, "e-12 m³/(s·Pa)", "fault_leakage"),),
    source="leakage as of internal leakage; by pressure over viscosity as laminar flow through an annular "
    "gap (Merritt, Hydraulic Control Systems, 1967, chapter 3); assumption: half of the friction is the "
    "piston seal's, the rod seals have the other half",
    next_check="Hold half the relief pressure against the end stop, open the other chamber's bleed and "
    "measure what comes out of it in a minute.",
    figures=(
        Figure("extruded_seal_leakage", 12e-12, (0.0, 1e-9), "m³/(s·Pa) past the piston", grows="leakage"),
        Figure("extruded_seal_friction_lost", LOST, (0.0, 1.0), "share of the friction that is gone"),
    ),
    effects=(
        Effect("seal_leakage", "add", "extruded_seal_leakage"),
        Effect("friction_forward", "lower", "extruded_seal_friction_lost"),
        Effect("friction_reverse", "lower", "extruded_seal_friction_lost"),
        Effect("viscous", "lower", "extruded_seal_friction_lost"),
    ),
    # A piston has one seal, a pump many clearances.
    signatures=(Signature("extruded seal", shows, commonness=0.5),),
)
