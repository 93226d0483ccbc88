"""Details of the plant that no unit profile knows, each an assumption with its usual range."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from fdd.plant.validated import Validated


class Details(Validated):
    """What the thesis and data sheets leave open. A campaign draws it per rig from `usual`.

    Attributes
    ----------
    bristle_stiffness : σ0 of eq. 5.8 (N/m); 1e6 gives half a millimetre of pre-sliding at 500 N, as
        elastomer seals do.
    bristle_damping : of the stuck piston on its bristles, relative to critical.
    bristle_fade : m/s, velocity at which the bristle damping has fallen to half.
    breakaway : share of its steady deflection up to which a bristle holds without sliding; 0 is eq. 5.9,
        0.6 gives the means of Table 5.1's static friction in the thesis's own experiment; the peaks still
        rise with the step's size by 11 to 18 N/V, which figure 5.8 does not show.
    friction_memory : s, lag of the friction curve behind the velocity (Hess and Soom; Armstrong-Hélouvry).
    seal_damping : N·s/m, of velocity changes quicker than that lag; steady friction is untouched.
        Together these two decide below which speed the piston sticks and slips; the thesis measured
        steady motion from 0.011 m/s on.
    pump_teeth : flow pulses per turn of the gear pump.
    pump_ripple : amplitude of these pulses over the mean flow.
    pump_compression : 0 the pump moves its displacement at the ports' mean density; 1 at
        its inlet's. Between them lies an apparent leakage of D·ω/(2β) per pressure.
    pump_coulomb_torque : dry friction of motor and pump (N·m).
    line_loss : K_pipe of eq. 3.33 (Pa·s²/m⁶); 6e11 gives 20 kPa at the pump's full flow.
    current_lag : of the drive's current loop (s).
    command_dead_band : of the drive's input (rad/s); Table 6.1 gives the motor 0.0011 V of ±10 V.
    coupling_stiffness, coupling_damping : of a worn coupling's flanks (N·m/rad, N·m·s/rad); a sound one
        is rigid.
    check_width, relief_width : pressure (Pa) over which these valves begin to open.
    orifice_transition : pressure (Pa) below which a stuck valve's orifice is laminar.
    stop_stiffness : of the cylinder's end stops (N/m).
    stop_damping : of these, s/m (force over spring force and velocity).
    cushion_length : m before the stop over which the cylinder's cushions take hold (section 4.5 names them).
    cushion_damping : force of a cushion over velocity squared (N·s²/m²).
    heat_capacity : of oil and housing (J/K): 3.7 kg of oil and about 20 kg of steel.
    cooling : heat given to the surroundings (W/K): about 0.8 m² at 10 W/(m²·K).
    loose_seal_leakage : cross-port leakage that a fully loose seal adds (m³/(s·Pa)).

    Examples
    --------
    >>> Details(pump_ripple=0.02).pump_teeth
    12
    """

    usual: ClassVar[dict[str, tuple[float, float]]] = {
        "bristle_stiffness": (4e5, 3e6),
        "bristle_damping": (0.3, 1.0),
        "bristle_fade": (0.003, 0.03),
        "breakaway": (0.3, 0.9),
        "friction_memory": (0.015, 0.06),
        "seal_damping": (200.0, 1000.0),
        "pump_teeth": (9, 14),
        "pump_ripple": (0.0, 0.02),
        "pump_compression": (0.0, 1.0),
        "pump_coulomb_torque": (0.02, 0.15),
        "line_loss": (0.0, 1.5e12),
        "heat_capacity": (8e3, 4e4),
        "cooling": (2.0, 20.0),
        "loose_seal_leakage": (0.0, 1e-12),
    }

    bristle_stiffness: Annotated[float, Field(ge=1e5, le=3e7)] = 1e6
    bristle_damping: Annotated[float, Field(ge=0.05, le=2.0)] = 0.5
    bristle_fade: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    breakaway: Annotated[float, Field(ge=0.0, le=0.95)] = 0.6
    friction_memory: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.04
    seal_damping: Annotated[float, Field(ge=0.0, le=1e4)] = 500.0
    pump_teeth: Annotated[int, Field(ge=1, le=100)] = 12
    pump_ripple: Annotated[float, Field(ge=0.0, le=0.2)] = 0.01
    pump_compression: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    pump_coulomb_torque: Annotated[float, Field(ge=0.0, le=1.0)] = 0.045
    line_loss: Annotated[float, Field(ge=0.0, le=1e14)] = 6e11
    current_lag: Annotated[float, Field(ge=1e-4, le=1e-3)] = 4e-4
    command_dead_band: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0346
    coupling_stiffness: Annotated[float, Field(ge=10.0, le=1e5)] = 500.0
    coupling_damping: Annotated[float, Field(ge=0.01, le=10.0)] = 0.25
    check_width: Annotated[float, Field(ge=200.0, le=1e5)] = 1e3
    relief_width: Annotated[float, Field(ge=1e3, le=1e6)] = 2e4
    orifice_transition: Annotated[float, Field(ge=1e3, le=1e5)] = 1e4
    stop_stiffness: Annotated[float, Field(ge=1e5, le=1e8)] = 2e7
    stop_damping: Annotated[float, Field(ge=0.0, le=100.0)] = 5.0
    cushion_length: Annotated[float, Field(ge=1e-3, le=0.1)] = 12e-3
    cushion_damping: Annotated[float, Field(ge=0.0, le=1e7)] = 1e5
    heat_capacity: Annotated[float, Field(ge=100.0, le=1e7)] = 17e3
    cooling: Annotated[float, Field(ge=0.0, le=1e4)] = 8.0
    loose_seal_leakage: Annotated[float, Field(ge=0.0, le=1e-11)] = 0.0
