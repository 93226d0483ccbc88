// The EHA tracker in plain C++ with Eigen: what `estimators.eha_loop.track` would be if an engineer wrote it by hand.
//
// The same algorithm, function by function and by the same names: time grid, missing and late samples, model step with
// Jacobian, covariance step, parameters' walks, robust scalar updates in Joseph form, likelihood, EKF-SVSF switching, jumps,
// redundant sensor, force balance, bounds.
//
// Usage: tracker INPUT OUTPUT. INPUT is raw doubles: rows, repeats, dense, period, svsf, has_pressures, has_angle, gamma,
// layer, then model parameters, noise, first state, its variances, and the block. OUTPUT takes the final state, its
// variances and the summed log-likelihood; standard output the processor seconds per sample, one line a repeat.
#include <cstdio>
#include <ctime>
#include <limits>
#include <vector>

#include "filter.hpp"

constexpr double NaN = std::numeric_limits<double>::quiet_NaN();

struct Settings {
    double rows, repeats, dense, period, svsf, has_pressures, has_angle, gamma, layer;
};

template <int N>
void start_motion(Filter<N>& f, const Channels& z, double p_acc) {
    const auto known = [](double value, double other) { return std::isnan(value) ? other : value; };
    f.A.template topRows<MOVING>().setZero();
    f.A.template leftCols<MOVING>().setZero();
    const double drop = known(z[Z_DP], 0.0);
    f.x[X] = known(z[Z_X], 0.0);
    f.x[TH] = known(z[Z_TH], 0.0);
    f.x[V] = f.x[W] = 0.0;
    f.x[P1] = known(z[Z_P1], p_acc + std::max(drop, 0.0));
    f.x[P2] = known(z[Z_P2], p_acc + std::max(-drop, 0.0));
    f.A(X, X) = f.A(TH, TH) = 1.0;
    f.A(V, V) = 0.01;
    f.A(W, W) = f.A(P1, P1) = f.A(P2, P2) = 0.09;
}

// Parameters back to their bounds, and what is correlated with them along.
template <int N>
void keep_in_bounds(Filter<N>& f) {
    const auto kept = [&](int j) { return std::min(std::max(f.x[j], LOWEST[j]), HIGHEST[j]); };
    bool inside = true;
    for (int j = LEAK; j < STATES; ++j) inside = inside && LOWEST[j] <= f.x[j] && f.x[j] <= HIGHEST[j];
    if (inside) return;
    for (int j = LEAK; j < STATES; ++j)
        if (kept(j) != f.x[j]) f.move(j, kept(j) - f.x[j]);
    for (int j = LEAK; j < STATES; ++j) f.x[j] = kept(j);
}

struct Walks {  // of the parameters: variance per second, and inverse of the initial one; zero where there is none
    State rate = State::Zero(), inverse = State::Zero();

    explicit Walks(const double* c) {
        const auto walk = [&](int state, int speed, int initial, double unit) {
            if (!(c[initial] > 0.0)) return;
            rate[state] = std::pow(c[speed] * unit, 2);
            inverse[state] = 1.0 / std::pow(c[initial] * unit, 2);
        };
        walk(LEAK, N_LEAKAGE, N_INITIAL_LEAKAGE, 1.0);
        walk(AIR, N_AIR, N_INITIAL_AIR, 1e3);
        walk(SPLIT, N_AIR_SPLIT, N_INITIAL_AIR_SPLIT, 1e3);
        walk(GAIN, N_GAIN, N_INITIAL_GAIN, 1.0);
        walk(FRIC, N_FRICTION, N_INITIAL_FRICTION, 1.0);
        walk(VISC, N_VISCOUS_FRICTION, N_INITIAL_VISCOUS_FRICTION, 1.0);
        walk(SKEW, N_VISCOUS_SKEW, N_INITIAL_VISCOUS_SKEW, 1.0);
        walk(STIF, N_STIFFNESS, N_INITIAL_STIFFNESS, 1e-3);
        walk(THROT, N_THROTTLE, N_INITIAL_THROTTLE, 1.0);
        walk(INERT, N_INERTIA, N_INITIAL_INERTIA, 1.0);
        walk(ZERO, N_ZERO, N_INITIAL_ZERO, 1e-6);
        rate[LOAD] = c[N_LOAD] * c[N_LOAD];
        rate[VALVE1] = rate[VALVE2] = c[N_VALVE] * c[N_VALVE];
    }
};

// Draws the valves back; returns the variances that `h` ms of walking add.
template <int N>
State walk_parameters(Filter<N>& f, double h, double unrest, const Walks& walks, const double* c) {
    const double seconds = 1e-3 * h, aerated = std::max(1.0, 0.3 * f.x[AIR]);
    const double third = 1.0 / (3.0 * c[N_INITIAL_VALVE]), pull = 4.5 * third * third * seconds * walks.rate[VALVE1];
    const bool gap = pull > SHORT;
    State most = State::Ones(), added = State::Zero();  // times the initial variance
    most[LEAK] = std::pow(std::max(1.0, f.x[LEAK]), 2);
    most[AIR] = aerated * aerated;
    for (int i = LEAK; i < STATES; ++i) {
        const double fast = i == LEAK ? most[i] : 1.0, room = std::max(1.0 - f.variance(i) * walks.inverse[i] / most[i], 0.0);
        added[i] = seconds * walks.rate[i] * fast * room;
        if (gap && walks.inverse[i] > 0.0)
            added[i] = -std::expm1(-seconds * walks.rate[i] * fast * walks.inverse[i] / most[i]) * room * most[i] / walks.inverse[i];
    }
    added[LOAD] *= unrest;
    for (int j : {VALVE1, VALVE2}) {
        const double openness = 1.0 + std::pow(f.x[j] * third, 2), keep = gap ? std::exp(-pull / openness) : 1.0 - pull / openness;
        added[j] = gap ? std::pow(c[N_INITIAL_VALVE] * openness, 2) * (1.0 - keep * keep) : added[j] * openness;
        f.shrink(j, keep);
    }
    return added;
}

struct Scores {  // of the flow parameters, over a window and over several
    double shift[FLOW_PARAMETERS] = {}, gained[FLOW_PARAMETERS] = {};
    double shift_long[FLOW_PARAMETERS] = {}, gained_long[FLOW_PARAMETERS] = {};
    double span = 0, windows = 0, streak = 0;
};

// A score beyond its limit sets the flow parameters free; `x`, `variances` are those before the update.
template <int N>
void watch_jumps(Filter<N>& f, const double* x, const double* variances, double h, const double* c, Scores& m) {
    for (int i = 0; i < FLOW_PARAMETERS; ++i) {
        m.shift[i] += f.x[LEAK + i] - x[i];
        m.gained[i] += variances[i] - f.variance(LEAK + i);
    }
    m.span += h;
    if (m.span < SCORE_WINDOW - 0.5 * h) return;
    m.span = 0.0;
    m.windows += 1.0;
    bool jumped = false;
    for (int i = 0; i < FLOW_PARAMETERS; ++i) {
        m.shift_long[i] += m.shift[i];
        m.gained_long[i] += m.gained[i];
        jumped = jumped || (m.gained[i] > 0.0 && std::abs(m.shift[i]) > JUMP_SIGMAS * std::sqrt(m.gained[i]));
        m.shift[i] = m.gained[i] = 0.0;
    }
    if (m.windows >= LONG_WINDOWS) {
        m.windows = 0.0;
        for (int i = 0; i < FLOW_PARAMETERS; ++i) {
            jumped = jumped ||
                     (m.gained_long[i] > 0.0 && std::abs(m.shift_long[i]) > JUMP_SIGMAS * std::sqrt(m.gained_long[i]));
            m.shift_long[i] = m.gained_long[i] = 0.0;
        }
    }
    if (!jumped) {
        m.streak = 0.0;
        return;
    }
    const double size = std::pow(2.0, m.streak);
    m.streak = std::min<double>(m.streak + 1.0, MOST_STREAK);
    f.variance(LEAK) += std::pow(c[N_JUMP_LEAKAGE] * size, 2);
    f.variance(VALVE1) += std::pow(c[N_JUMP_VALVE] * size, 2);
    f.variance(VALVE2) += std::pow(c[N_JUMP_VALVE] * size, 2);
    f.variance(AIR) += std::pow(c[N_JUMP_AIR] * 1e3 * size, 2);
    f.variance(SPLIT) += std::pow(c[N_INITIAL_AIR_SPLIT] * 1e3 * size, 2);
    f.variance(GAIN) += std::pow(c[N_INITIAL_GAIN] * size, 2);
    m.windows = 0.0;
    for (int i = 0; i < FLOW_PARAMETERS; ++i) m.shift_long[i] = m.gained_long[i] = 0.0;
}

struct Rest {  // of the pressures: averages that noise and motion part in, and ms without a change
    double fast[2] = {}, slow[2] = {}, still = 0;
};

template <int N>
bool pressures_rest(const Filter<N>& f, double h, const double* c, Rest& m) {
    m.still += h;
    for (int i = 0; i < 2; ++i) {
        m.fast[i] += std::min(h / FAST, 1.0) * (f.x[P1 + i] - m.fast[i]);
        m.slow[i] += std::min(h / SLOW, 1.0) * (f.x[P1 + i] - m.slow[i]);
        if (std::abs(m.fast[i] - m.slow[i]) > c[N_PRESSURE] * 1e-6) m.still = 0.0;
    }
    return m.still > REST;
}

struct Redundancy {
    double sum = 0, pairs = 0;
};

// The zero of the difference sensor against the chambers' own; `gap` is NaN without one of them.
template <int N>
void compare_sensors(Filter<N>& f, double gap, double variance, Redundancy& m) {
    if (std::isnan(gap)) return;
    m.sum += gap;
    m.pairs += 1.0;
    if (m.pairs < PAIRS) return;
    const double error = m.sum / m.pairs - f.x[ZERO], prior = f.variance(ZERO);
    double noise = variance / m.pairs, s = prior + noise;
    m.sum = m.pairs = 0.0;
    if (error * error > ROBUST * ROBUST * s) {
        noise += s * (error * error / (s * ROBUST * ROBUST) - 1.0);
        s = prior + noise;
    }
    f.x[ZERO] += prior / s * error;
    f.variance(ZERO) = prior * noise / s;
}

inline Eigen::Vector4d motion_noise(const State& x, double h, double p_acc, bool known, const double* q, const double* c) {
    const double force = 1e-3 / q[Q_MOVING_MASS] * c[N_FORCE], acceleration = c[N_ACCELERATION] * 1e-3, margin = c[N_REFEED_MARGIN] * 1e-6;
    const bool fed1 = known ? x[P1] < p_acc + margin : x[P1] <= x[P2], fed2 = known ? x[P2] < p_acc + margin : x[P2] < x[P1];
    const bool relieved = std::abs(x[P1] - x[P2]) > c[N_RELIEF_PRESSURE] * 1e-6;
    const double few = c[N_FLOW] * 1e9, much = c[N_FLOW_REFEEDING] * 1e9;
    const double flow1 = relieved || fed1 ? much : few, flow2 = relieved || fed2 ? much : few;
    return {force * force * 1e3 * h, acceleration * acceleration * 1e-3 * h, flow1 * flow1 * 1e-3 * h,
            flow2 * flow2 * 1e-3 * h};
}

struct Balance {  // the force balance's memory
    double count = 0, force = 0, velocity = 0, position = 0, start = 0, sign = 0, curve = 0, square = 0;
    double unrest = 1, slid = 0;
};

template <int N>
void balance_forces(Filter<N>& f, Balance& m, double h, double curve, const double* q, const double* c) {
    const double v = f.x[V];
    if (m.count == 0.0) {
        m.force = m.velocity = m.position = m.curve = m.square = 0.0;
        m.start = v;
        const double direction = v > 0.0 ? 1.0 : -1.0;
        if (direction != m.sign) m.slid = 0.0;
        m.sign = direction;
    }
    if (v * m.sign < q[Q_SLIDING_VELOCITY]) m.slid = -FORCE_PERIOD;
    m.force += (q[Q_AREA_1] * f.x[P1] - q[Q_AREA_2] * f.x[P2]) * h;
    m.velocity += v * h;
    m.position += f.x[X] * h;
    m.square += v * std::abs(v) * h;
    m.curve += curve * h;
    m.count += h;
    if (m.count < FORCE_PERIOD - 0.5 * h) return;
    const double span = m.count;
    m.count = 0.0;
    m.slid += span;
    if (m.slid < FRICTION_SETTLES) return;
    const double acceleration = (v - m.start) / span * 1e3;
    Load out = Load::Zero();
    out[FRIC - FRIC] = m.curve / span;
    out[VISC - FRIC] = m.velocity / span;
    out[SKEW - FRIC] = std::abs(out[VISC - FRIC]);
    out[LOAD - FRIC] = 1.0;
    out[STIF - FRIC] = m.position / span;
    out[THROT - FRIC] = m.square / span;
    out[INERT - FRIC] = acceleration;
    const double y = m.force / span - q[Q_MOVING_MASS] * acceleration - out.dot(f.x.template tail<LOADS>());
    const double lag = FRICTION_LAG / span * (curve - friction_curve(m.start, q).curve);
    const double partner = PARTNER_MISFIT * f.x[THROT] * m.square / span, unrest = std::max(m.unrest, 1.0);
    double r = (c[N_FORCE_MEAN] * c[N_FORCE_MEAN] + lag * lag + partner * partner) * unrest * unrest;
    const double s = r + f.force_variance(out), ratio = y * y / s;
    m.unrest = std::min(std::max(m.unrest * std::exp(0.02 * (std::min(ratio, 9.0) - 1.0)), 0.01), 1e4);
    if (ratio > ROBUST * ROBUST) r += s * (ratio / (ROBUST * ROBUST) - 1.0);
    f.force_update(out, y, r);
}

template <int N>
double track(Filter<N>& f, const double* block, const Settings& set, const double* q, const double* c) {
    const double h0 = set.period * 1e3, r_mean = 0.04 * 1e4 / h0;
    Channels r0;
    r0[Z_X] = std::pow(c[N_POSITION] * 1e3, 2);
    r0[Z_TH] = std::pow(c[N_ANGLE], 2);
    r0[Z_P1] = r0[Z_P2] = std::pow(c[N_PRESSURE] * 1e-6, 2);
    r0[Z_DP] = std::pow(c[N_PRESSURE_DIFFERENCE] * 1e-6, 2);
    r0[Z_MEAN] = r_mean;
    const Walks walks(c);
    Balance balance;
    Scores scores;
    Redundancy redundancy;
    Rest rest;
    Friction friction = friction_curve(f.x[V], q);  // always that of the present estimate
    Jacobian F;
    Effect G;
    bool started = false;
    double origin = 0, index = 0, angle = 0, last_speed = 0, accumulator = NaN, viscosity = 1.0, blind_steps = 0, total = 0;
    for (long row = 0; row < static_cast<long>(set.rows); ++row, block += COLUMNS) {
        const double time = block[TIME];
        double steps = 0.0;
        if (started) {
            origin += 2e-5 * set.period;
            steps = std::max(std::floor((time - origin) / set.period + 0.25) - index, 1.0);
            index += steps;
            origin -= std::max(origin + index * set.period - time, 0.0);
        } else {
            origin = time;
            index = 0.0;
        }
        Channels z;
        z[Z_TH] = block[ANGLE];
        if (!set.has_angle) {
            const double speed = std::isnan(block[SPEED]) ? last_speed : block[SPEED];
            if (steps > 0.0) angle += set.period * (speed + (steps - 1.0) * 0.5 * (speed + last_speed));
            last_speed = speed;
            z[Z_TH] = angle;
        }
        if (!std::isnan(block[ACCUMULATOR])) accumulator = block[ACCUMULATOR] * 1e-6;
        if (!std::isnan(block[VISCOSITY])) viscosity = block[VISCOSITY];
        const bool known = !std::isnan(accumulator);
        const double p_acc = known ? accumulator : q[Q_ACCUMULATOR_PRESSURE];
        z[Z_X] = block[POSITION] * 1e3;
        z[Z_P1] = block[PRESSURE_1] * 1e-6;
        z[Z_P2] = block[PRESSURE_2] * 1e-6;
        const double difference = block[DIFFERENCE] * 1e-6, gap = difference - (z[Z_P1] - z[Z_P2]);
        z[Z_DP] = set.has_pressures ? NaN : difference;
        z[Z_MEAN] = set.has_pressures ? NaN : p_acc;

        const bool blind = std::isnan(z[Z_X]) || std::isnan(z[Z_TH]);
        if (blind) {
            blind_steps += steps;
            if (!started) continue;
        } else {
            steps += blind_steps;
            blind_steps = 0.0;
            if (!started) {
                start_motion(f, z, p_acc);
                started = true;
            } else if (steps > LONGEST_GAP) {
                start_motion(f, z, p_acc);
                f.widen(walk_parameters(f, steps * h0, balance.unrest, walks, c));
            } else {
                const double span = steps * h0, force = 1e-3 / q[Q_MOVING_MASS] * c[N_FORCE];
                const double spread = (f.A(V, V) + force * force * 1e3 * h0) * span * span;
                const double trust = spread / (spread + f.A(X, X) + r0[Z_X]);
                const double v_at = f.x[V] + trust * ((z[Z_X] - f.x[X]) / span - f.x[V]), w_at = (z[Z_TH] - f.x[TH]) / span;
                for (int k = 0; k < static_cast<int>(steps); ++k) {
                    if (k > 0) friction = friction_curve(f.x[V], q);
                    const Eigen::Vector4d noise = motion_noise(f.x, h0, p_acc, known, q, c);
                    const State added = walk_parameters(f, h0, balance.unrest, walks, c);
                    step(f.x, h0, viscosity, p_acc, v_at, w_at, q, friction, F, G);
                    f.propagate(F, G, noise, added);
                }
            }
        }
        f.plus[Z_MEAN] = f.x[P1] <= f.x[P2] ? P1 : P2;
        Channels y = f.innovation(z), r = r0;
        bool mask[MEASUREMENTS];
        for (int i = 0; i < MEASUREMENTS; ++i) {
            mask[i] = !blind && !std::isnan(y[i]);
            if (mask[i] && !set.svsf) r[i] += std::max(y[i] * y[i] / (ROBUST * ROBUST) - r[i] - f.channel_variance(i), 0.0);
        }
        double before[FLOW_PARAMETERS], spread[FLOW_PARAMETERS];
        for (int i = 0; i < FLOW_PARAMETERS; ++i) {
            before[i] = f.x[LEAK + i];
            spread[i] = f.variance(LEAK + i);
        }
        const double air[] = {f.x[AIR], f.x[SPLIT], f.A(AIR, AIR), f.A(SPLIT, SPLIT), f.A(AIR, SPLIT)};
        Motion motion, variances;
        const bool believed = mask[Z_MEAN];
        mask[Z_MEAN] = false;  // no measurement, so no layer
        const bool switched = set.svsf && f.svsf(y, r, mask, set.gamma, set.layer, motion, variances);
        mask[Z_MEAN] = believed;
        total += f.update(y, r, mask).second;
        if (switched) f.take(motion, variances);
        if (set.svsf) {
            f.plus[Z_MEAN] = f.x[P1] <= f.x[P2] ? P1 : P2;
            y = f.innovation(z);
            for (int i = 0; i < MEASUREMENTS; ++i)
                if (mask[i]) f.e_post[i] = y[i];
        }
        if (pressures_rest(f, std::max(steps, 1.0) * h0, c, rest)) {
            f.x[AIR] = air[0];
            f.x[SPLIT] = air[1];
            f.A(AIR, AIR) = air[2];
            f.A(SPLIT, SPLIT) = air[3];
            f.A(AIR, SPLIT) = f.A(SPLIT, AIR) = air[4];
        }
        if (!blind) {
            const double span = std::max(steps, 1.0) * h0;
            friction = friction_curve(f.x[V], q);
            watch_jumps(f, before, spread, span, c, scores);
            compare_sensors(f, gap, r0[Z_DP] + 2.0 * r0[Z_P1], redundancy);
            balance_forces(f, balance, span, friction.curve, q, c);
        }
        keep_in_bounds(f);
    }
    return total;
}

template <int N>
void measure(const Settings& set, const double* rest, std::FILE* out) {
    const double *q = rest, *c = q + PARAMETERS, *x = c + NOISE, *variances = x + STATES, *block = variances + STATES;
    Filter<N> f;
    double total = 0.0;
    for (int repeat = 0; repeat < static_cast<int>(set.repeats); ++repeat) {
        f = Filter<N>();
        f.x = Eigen::Map<const State>(x);
        f.widen(Eigen::Map<const State>(variances));
        const std::clock_t start = std::clock();
        total = track(f, block, set, q, c);
        std::printf("%.6e\n", static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC / set.rows);
    }
    std::fwrite(f.x.data(), sizeof(double), STATES, out);
    for (int i = 0; i < STATES; ++i) {
        const double variance = f.variance(i);
        std::fwrite(&variance, sizeof(double), 1, out);
    }
    std::fwrite(&total, sizeof(double), 1, out);
}

int main(int count, char** names) {
    std::FILE* in = count == 3 ? std::fopen(names[1], "rb") : nullptr;
    std::FILE* out = in ? std::fopen(names[2], "wb") : nullptr;
    if (!out) return 2;
    std::vector<double> input;
    double buffer[4096];
    for (std::size_t n; (n = std::fread(buffer, sizeof(double), 4096, in)) > 0;)
        input.insert(input.end(), buffer, buffer + n);
    const double* s = input.data();
    const Settings set{s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]};
    if (set.dense) measure<STATES>(set, s + 9, out);
    else measure<COUPLED>(set, s + 9, out);
    std::fclose(out);
    return 0;
}
