"""Where what stands: columns of the tracker's blocks, measurements, records and memory."""

from __future__ import annotations

from estimators.eha import model as eha

# Columns of a block given to `EhaTracker.push`, SI; NaN where a channel has no value.
TIME, POSITION, ANGLE, SPEED, PRESSURE_1, PRESSURE_2, DIFFERENCE, ACCUMULATOR, VISCOSITY = range(9)
COLUMNS = 9

# Rows of the measurement vector.
Z_X, Z_TH, Z_P1, Z_P2, Z_DP, Z_MEAN = range(6)
MEASUREMENTS = 6

# Columns of a record: time, states, variances of the parameters, then diagnostics.
R_TIME = 0
R_STATE = 1
R_VARIANCE = R_STATE + eha.STATES
R_NIS = R_VARIANCE + eha.STATES
R_CHANNELS = R_NIS + 1
R_LOGLIK = R_NIS + 2
R_OUTSIDE = R_NIS + 3
R_LAYER = R_NIS + 4
R_BETA1 = R_NIS + 5
R_BETA2 = R_NIS + 6
R_VISCOSITY = R_NIS + 7
R_UNREST = R_NIS + 8
R_SCORE = R_NIS + 9  # of the flow parameters, over the last complete window
R_LEAK_VALVE1 = R_SCORE + 5  # covariances of leakage with the valves'
R_LEAK_VALVE2 = R_SCORE + 6
RECORD = R_SCORE + 7

# Slots of the loop's memory.
(
    M_ORIGIN, M_INDEX, M_ANGLE, M_SPEED, M_ACC, M_VISC, M_COUNT, M_STARTED, M_NIS, M_CHANNELS, M_LOGLIK,
    M_OUT, M_FORCE, M_VMEAN, M_XMEAN, M_VSTART, M_FSIGN, M_FCOUNT, M_CURVE, M_SQUARE, M_FSCALE, M_SLID,
    M_BLIND, M_SPAN, M_WINDOWS, M_STREAK, M_REDUNDANT, M_PAIRS, M_FAST1, M_FAST2, M_SLOW1,
    M_SLOW2, M_STILL,
) = range(33)  # fmt: skip
# For each of the flow parameters, LEAK to SPLIT: see `estimators.eha.walk`.
FLOW_PARAMETERS = 5
M_SHIFT, M_GAINED, M_SHIFT_LONG, M_GAINED_LONG, M_SCORE = range(33, 33 + 5 * FLOW_PARAMETERS, FLOW_PARAMETERS)
MEMORY = 33 + 5 * FLOW_PARAMETERS
