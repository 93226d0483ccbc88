"""Details of the plant that no unit profile knows, each an assumption with its usual range."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from fdd.plant.validated import Validated


class Details(Validated):
    """What the thesis and data sheets leave open. A campaign draws it per rig from `usual`.

    Attributes
    ----------
    bristle_stiffness : σ0 of eq. 5.8 (N/m); 1e7 gives 50 µm of pre-sliding at 500 N.
    bristle_damping : of the stuck piston on its bristles, relative to critical.
    bristle_fade : m/s, velocity at which the bristle damping has fallen to half.
    pump_teeth : flow pulses per turn of the gear pump.
    pump_ripple : amplitude of these pulses over the mean flow.
    pump_compression : 0 the pump moves its displacement at the ports' mean density; 1 at
        its inlet's. Between them lies an apparent leakage of D·ω/(2β) per pressure.
    pump_coulomb_torque : dry friction of motor and pump (N·m).
    check_width, relief_width : pressure (Pa) over which these valves begin to open.
    orifice_transition : pressure (Pa) below which a stuck valve's orifice is laminar.
    stop_stiffness : of the cylinder's end stops (N/m).
    stop_damping : of these, s/m (force over spring force and velocity).
    loose_seal_leakage : cross-port leakage that a fully loose seal adds (m³/(s·Pa)).

    Examples
    --------
    >>> Details(pump_ripple=0.02).pump_teeth
    12
    """

    usual: ClassVar[dict[str, tuple[float, float]]] = {
        "bristle_stiffness": (3e6, 2e7),
        "bristle_damping": (0.3, 1.0),
        "bristle_fade": (0.003, 0.03),
        "pump_teeth": (9, 14),
        "pump_ripple": (0.0, 0.02),
        "pump_compression": (0.0, 1.0),
        "pump_coulomb_torque": (0.02, 0.15),
        "loose_seal_leakage": (0.0, 1e-12),
    }

    bristle_stiffness: Annotated[float, Field(ge=1e5, le=3e7)] = 1e7
    bristle_damping: Annotated[float, Field(ge=0.05, le=2.0)] = 0.5
    bristle_fade: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    pump_teeth: Annotated[int, Field(ge=1, le=100)] = 12
    pump_ripple: Annotated[float, Field(ge=0.0, le=0.2)] = 0.01
    pump_compression: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    pump_coulomb_torque: Annotated[float, Field(ge=0.0, le=1.0)] = 0.045
    check_width: Annotated[float, Field(ge=200.0, le=1e5)] = 1e3
    relief_width: Annotated[float, Field(ge=1e3, le=1e6)] = 2e4
    orifice_transition: Annotated[float, Field(ge=1e3, le=1e5)] = 1e4
    stop_stiffness: Annotated[float, Field(ge=1e5, le=1e8)] = 2e7
    stop_damping: Annotated[float, Field(ge=0.0, le=100.0)] = 5.0
    loose_seal_leakage: Annotated[float, Field(ge=0.0, le=1e-11)] = 0.0
