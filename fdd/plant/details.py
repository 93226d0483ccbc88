"""Details of the plant that no unit profile knows, each an assumption with its usual range."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from fdd.plant.validated import Ranges, Validated


class Details(Validated):
    """What the thesis and data sheets leave open. A campaign draws it per rig from `usual`.

    Attributes
    ----------
    bristle_stiffness : σ0 of eq. 5.8 (N/m); 1e6 gives half a millimetre of pre-sliding at 500 N, as
        elastomer seals do.
    bristle_damping : of the stuck piston on its bristles, relative to critical.
    bristle_fade : m/s, velocity at which the bristle damping has fallen to half.
    breakaway : share of its steady deflection up to which a bristle holds without sliding; 0 is eq. 5.9,
        0.65 gives the means of Table 5.1's static friction in the thesis's own experiment; the peaks still
        rise with the step's size by 7 to 16 N/V, most of it the piston's inertia; figure 5.8 shows no rise.
    friction_memory : s, lag of the friction curve behind the velocity (Hess and Soom; Armstrong-Hélouvry).
        Section 5.3 reads its steady curves off a run-up of 0.11 m/s², in which 40 ms shift them by
        4.4 mm/s and 5 to 9 %; with 25 ms they agree with Table 5.2. With 20 ms the piston sticks and slips
        at 0.011 m/s, the thesis's slowest motion.
    seal_damping : N·s/m, of velocity changes quicker than that lag; steady friction is untouched. The pole
        pair of eq. 6.13 decays with 50.9 1/s whatever the bulk modulus, which over twice the moving
        mass is 375 N·s/m; lines, leakage and motor make up some 35 of them.
    pump_teeth : flow pulses per turn of the gear pump.
    pump_ripple : amplitude of these pulses over the mean flow.
    pump_compression : 0 the pump moves its displacement at the ports' mean density; 1 at
        its inlet's. Between them lies an apparent leakage of D·ω/(2β) per pressure.
    pump_coulomb_torque : dry friction of motor and pump (N·m).
    pump_friction : torque by which the load rubs in the gears and their bearings, over D·Δp.
    pump_drag : viscous torque of the pump over μ·D·ω. With both a gear pump of the thesis's size gives 88 %
        of its torque at 3.44 MPa and full speed, 94 % at 20.68 MPa; catalogues have 85 to 95 %.
    pole_pairs : of the motor. cogging_torque : of magnets and slots, over that of the relief setting.
    winding_time, continuous_share : I²t protection: s, thermal time constant of the winding, and the share of
        the current limit that it bears for good.
    line_loss : K_pipe of eq. 3.33 (Pa·s²/m⁶); 6e11 gives 20 kPa at the pump's full flow.
    current_lag : of the drive's current loop (s).
    command_dead_band : of the drive's input (rad/s); Table 6.1 gives the motor 0.0011 V of ±10 V.
    coupling_stiffness, coupling_damping : of a worn coupling's flanks (N·m/rad, N·m·s/rad); a sound one
        is rigid.
    check_width, relief_width : pressure (Pa) over which these valves begin to open.
    relief_lag, relief_hysteresis : s, by which a relief valve follows the pressure; how far below its setting
        an open one shuts, over the setting. Its override, the rise at full flow, is the unit's flow gain.
    gas_time : s, with which the accumulator's gas takes its shell's temperature: 2 to 20 s for 0.1 to 5 l
        (Pourmovahed and Otis, doi:10.1115/1.2894128). gas_warming : share of the oil's warming that the shell
        takes, between the surroundings and the oil.
    gallery_volume : m³ of oil in pump case and passages around the accumulator; gallery_gas : volume of the
        gas in it over that, at charge pressure, which is all that gives once the accumulator is empty.
    film_share : share of the seals' Coulomb friction that the oil's film carries: it goes with the root of
        viscosity (elastohydrodynamic seals: Nikas, doi:10.1243/13506501JET607).
    orifice_transition : pressure (Pa) below which a stuck valve's orifice is laminar.
    stop_stiffness : of the cylinder's end stops (N/m).
    stop_damping : of these, s/m (force over spring force and velocity).
    cushion_length : m before the stop over which the cylinder's cushions take hold (section 4.5 names them).
    cushion_damping : force of a cushion over velocity squared (N·s²/m²).
    heat_capacity : of oil and housing (J/K): 3.7 kg of oil and about 20 kg of steel.
    cooling : heat given to the surroundings (W/K): about 0.8 m² at 10 W/(m²·K).
    loose_seal_leakage : cross-port leakage that a fully loose seal adds (m³/(s·Pa)).
    friction_law : of the seals: ``elastoplastic`` LuGre with a film that lags; plain ``lugre``, whose film
        follows at once (eq. 5.9); ``dahl``, a bristle without the falling curve; ``smooth``, the Stribeck
        curve through zero as a tanh, without any pre-sliding.
    smooth_width : m/s of that tanh.
    seal_pressure : rise of the seals' friction with the chambers' mean pressure, over pressure times area;
        a lip that the pressure presses on gives 0.002 to 0.01 (assumption).
    check_lag : s, by which a refeeding valve's poppet follows the pressure that moves it. It has all but
        closed after four or five of them. check_hysteresis : Pa by which a raised poppet stays up longer.
    pilot_ratio : of refeeding valves that the other chamber's pressure opens too, over their seat's area;
        0 is a plain check valve. Unequal areas need them, for what the smaller chamber cannot take.
    pilot_cracking, pilot_band : Pa beyond which that piston lifts the poppet, and over which it does so.
    air_law : ``free`` air is compressed only; where it is ``dissolving`` pressure drives it into the oil.
    dissolving_pressure : Pa, gauge, from which on all but a tenth of the air dissolves in the end.
    dissolving_time, releasing_time : s; air comes out faster than it goes in, hence the hysteresis
        (assumption: minutes in, tenths of a second out).

    Examples
    --------
    >>> Details(pump_ripple=0.02).pump_teeth
    12
    """

    usual: ClassVar[Ranges] = {
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
        "pump_friction": (0.02, 0.08),
        "pump_drag": (1e4, 4e4),
        "cogging_torque": (0.0, 2.5e-2),
        "check_lag": (1e-3, 6e-3),
        "check_hysteresis": (0.0, 3e3),
        "relief_lag": (3e-3, 1.5e-2),
        "relief_hysteresis": (0.0, 0.1),
        "gas_time": (2.0, 20.0),
        "gas_warming": (0.2, 1.0),
        "film_share": (0.1, 0.5),
    }

    bristle_stiffness: Annotated[float, Field(ge=1e3, le=1e9)] = 1e6
    bristle_damping: Annotated[float, Field(ge=0.05, le=2.0)] = 0.5
    bristle_fade: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    breakaway: Annotated[float, Field(ge=0.0, le=0.95)] = 0.65
    friction_memory: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.025
    seal_damping: Annotated[float, Field(ge=0.0, le=1e6)] = 340.0
    pump_teeth: Annotated[int, Field(ge=1, le=100)] = 12
    pump_ripple: Annotated[float, Field(ge=0.0, le=0.2)] = 0.01
    pump_compression: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    pump_coulomb_torque: Annotated[float, Field(ge=0.0, le=100.0)] = 0.045
    line_loss: Annotated[float, Field(ge=0.0, le=1e16)] = 6e11
    current_lag: Annotated[float, Field(ge=1e-4, le=1e-3)] = 4e-4
    command_dead_band: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0346
    coupling_stiffness: Annotated[float, Field(ge=1.0, le=1e7)] = 500.0
    coupling_damping: Annotated[float, Field(ge=1e-3, le=1e4)] = 0.25
    check_width: Annotated[float, Field(ge=200.0, le=1e5)] = 1e3
    relief_width: Annotated[float, Field(ge=1e3, le=1e6)] = 2e4
    orifice_transition: Annotated[float, Field(ge=1e3, le=1e5)] = 1e4
    stop_stiffness: Annotated[float, Field(ge=1e5, le=1e11)] = 2e7
    stop_damping: Annotated[float, Field(ge=0.0, le=100.0)] = 5.0
    cushion_length: Annotated[float, Field(ge=1e-3, le=0.1)] = 12e-3
    cushion_damping: Annotated[float, Field(ge=0.0, le=1e9)] = 1e5
    heat_capacity: Annotated[float, Field(ge=100.0, le=1e8)] = 17e3
    cooling: Annotated[float, Field(ge=0.0, le=1e4)] = 8.0
    loose_seal_leakage: Annotated[float, Field(ge=0.0, le=1e-9)] = 0.0
    friction_law: Literal["elastoplastic", "lugre", "dahl", "smooth"] = "elastoplastic"
    smooth_width: Annotated[float, Field(ge=5e-4, le=0.1)] = 3e-3
    seal_pressure: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    check_lag: Annotated[float, Field(ge=5e-4, le=0.2)] = 2e-3
    check_hysteresis: Annotated[float, Field(ge=0.0, le=1e6)] = 1e3
    relief_lag: Annotated[float, Field(ge=1e-3, le=0.1)] = 5e-3
    relief_hysteresis: Annotated[float, Field(ge=0.0, le=0.3)] = 0.05
    gas_time: Annotated[float, Field(ge=0.1, le=1e4)] = 8.0
    gas_warming: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    gallery_volume: Annotated[float, Field(ge=1e-7, le=1e-1)] = 1e-4
    gallery_gas: Annotated[float, Field(ge=1e-3, le=0.2)] = 0.01
    film_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    pump_friction: Annotated[float, Field(ge=0.0, le=0.3)] = 0.04
    pump_drag: Annotated[float, Field(ge=0.0, le=1e6)] = 2e4
    pole_pairs: Annotated[int, Field(ge=1, le=50)] = 4
    cogging_torque: Annotated[float, Field(ge=0.0, le=0.2)] = 8e-3
    winding_time: Annotated[float, Field(ge=0.1, le=1e4)] = 30.0
    continuous_share: Annotated[float, Field(ge=0.05, le=1.0)] = 0.6
    pilot_ratio: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    pilot_cracking: Annotated[float, Field(ge=0.0, le=1e6)] = 2e4
    pilot_band: Annotated[float, Field(ge=1e3, le=1e7)] = 1e5
    air_law: Literal["free", "dissolving"] = "dissolving"
    dissolving_pressure: Annotated[float, Field(ge=1e5, le=1e8)] = 2e6
    dissolving_time: Annotated[float, Field(ge=0.01, le=3600.0)] = 120.0
    releasing_time: Annotated[float, Field(ge=0.01, le=600.0)] = 0.2
