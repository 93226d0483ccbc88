// The reduced model of `estimators.eha.model` and its Jacobian, in plain C++.
#pragma once
#include <Eigen/Dense>

#include <algorithm>
#include <cmath>

#include "indices.h"

constexpr int MOVING = P2 + 1, COUPLED = FRIC, LOADS = STATES - FRIC;
using State = Eigen::Matrix<double, STATES, 1>;
using Informed = Eigen::Matrix<double, COUPLED, 1>;  // the states that measurements of motion and pressure inform
using Jacobian = Eigen::Matrix<double, MOVING, COUPLED>;  // the other rows are the identity's
using Effect = Eigen::Matrix<double, MOVING, 4>;

struct Compliance { double value, slope, of_air; };

inline Compliance compliance(double p, double air, const double* q) {
    const double n = q[Q_POLYTROPIC_INDEX], absolute = std::max(p + ATMOSPHERE, 0.1 * ATMOSPHERE);
    const double c = std::pow(ATMOSPHERE / absolute, 1.0 + 1.0 / n) / (n * ATMOSPHERE);
    const double value = q[Q_STIFF_COMPLIANCE] + 1e-3 * air * c, floor = COMPLIANCE_FLOOR * q[Q_STIFF_COMPLIANCE];
    if (value < floor) return {floor, 0.0, 0.0};
    const double slope = p > -0.9 * ATMOSPHERE ? -c * (n + 1.0) / n / (p + ATMOSPHERE) : 0.0;
    return {value, 1e-3 * air * slope, 1e-3 * c};
}

struct Friction { double curve, slope, stick, stick_slope; };

inline Friction friction_curve(double v, const double* q) {
    const bool forward = v >= 0.0;
    const double coulomb = q[forward ? Q_COULOMB_FORWARD : Q_COULOMB_REVERSE], fixed = q[forward ? Q_STATIC_FORWARD : Q_STATIC_REVERSE];
    const double stribeck = q[forward ? Q_STRIBECK_FORWARD : Q_STRIBECK_REVERSE];
    const double exponent = q[forward ? Q_EXPONENT_FORWARD : Q_EXPONENT_REVERSE];
    const double speed = std::abs(v) + 1e-5, ratio = std::pow(speed / stribeck, exponent);
    const double excess = (fixed - coulomb) * std::exp(-ratio), level = coulomb + excess;
    const double sign = std::tanh(v / STICTION_VELOCITY), stick = level * (1.0 - sign * sign) / STICTION_VELOCITY;
    const double stribeck_slope = -excess * ratio * exponent / speed, direction = forward ? 1.0 : -1.0;
    return {sign * level, stick + std::abs(sign) * stribeck_slope, stick,
            (direction * stribeck_slope * (1.0 - sign * sign) - 2.0 * sign * stick) / STICTION_VELOCITY};
}

// `f` is the friction curve at the velocity of `x`.
inline void step(State& x, double h, double viscosity, double p_acc, double v_at, double w_at, const double* q,
                 const Friction& f, Jacobian& F, Effect& G) {
    const double area1 = q[Q_AREA_1], area2 = q[Q_AREA_2], mu = 1e-3 / q[Q_MOVING_MASS];
    const double v = x[V], p1 = x[P1], p2 = x[P2], pump = q[Q_DISPLACEMENT] * (1.0 + x[GAIN]);
    const Compliance b1 = compliance(p1, x[AIR] + x[SPLIT], q), b2 = compliance(p2, x[AIR] - x[SPLIT], q);
    const double swept1 = q[Q_POSITION_COMPLIANCE] * area1, swept2 = q[Q_POSITION_COMPLIANCE] * area2;
    const double volume1 = std::max(q[Q_VOLUME_1] + swept1 * x[X], 0.05 * q[Q_VOLUME_1]);
    const double volume2 = std::max(q[Q_VOLUME_2] - swept2 * x[X], 0.05 * q[Q_VOLUME_2]);
    const double i1 = 1.0 / (volume1 * b1.value), i2 = 1.0 / (volume2 * b2.value);

    const double drop = p1 - p2, over1 = p1 - p_acc, over2 = p2 - p_acc, rate = x[LEAK] / viscosity;
    const double total = (q[Q_CROSS_PORT_LEAKAGE] + 0.5 * q[Q_CASE_LEAKAGE]) / viscosity;
    const double base1 = q[Q_CROSS_PORT_LEAKAGE] * drop + q[Q_CASE_LEAKAGE] * over1, base2 = -q[Q_CROSS_PORT_LEAKAGE] * drop + q[Q_CASE_LEAKAGE] * over2;
    const double valve1 = total * x[VALVE1], valve2 = total * x[VALVE2];
    // The denser chamber gets less volume from the pump than the other loses.
    const double n = q[Q_POLYTROPIC_INDEX];
    const double shrunk1 = n * std::max(p1 + ATMOSPHERE, 0.1 * ATMOSPHERE) * b1.of_air;
    const double shrunk2 = n * std::max(p2 + ATMOSPHERE, 0.1 * ATMOSPHERE) * b2.of_air;
    const double thinned = shrunk2 - shrunk1, denser = 0.5 * (q[Q_STIFF_COMPLIANCE] * drop + x[AIR] * thinned);
    const double into = pump * (1.0 - denser), out_of = pump * (1.0 + denser);
    const double a1 = into * x[W] - rate * base1 - valve1 * over1, a2 = out_of * x[W] + rate * base2 + valve2 * over2;
    const double half1 = 0.5 * (q[Q_STIFF_COMPLIANCE] + x[AIR] * b1.of_air) * pump * w_at;
    const double half2 = 0.5 * (q[Q_STIFF_COMPLIANCE] + x[AIR] * b2.of_air) * pump * w_at;
    Informed da1 = Informed::Zero(), da2 = Informed::Zero(), dv = Informed::Zero();
    da1[W] = into;
    da2[W] = out_of;
    da1[GAIN] = q[Q_DISPLACEMENT] * (1.0 - denser) * w_at;
    da2[GAIN] = q[Q_DISPLACEMENT] * (1.0 + denser) * w_at;
    da1[AIR] = -0.5 * thinned * pump * w_at;
    da2[AIR] = -da1[AIR];
    da1[LEAK] = -base1 / viscosity;
    da2[LEAK] = base2 / viscosity;
    da1[VALVE1] = -total * over1;
    da2[VALVE2] = total * over2;
    da1[P1] = -rate * (q[Q_CROSS_PORT_LEAKAGE] + q[Q_CASE_LEAKAGE]) - valve1 - half1;
    da1[P2] = rate * q[Q_CROSS_PORT_LEAKAGE] + half2;
    da2[P1] = -rate * q[Q_CROSS_PORT_LEAKAGE] + half1;
    da2[P2] = rate * (q[Q_CROSS_PORT_LEAKAGE] + q[Q_CASE_LEAKAGE]) + valve2 - half2;

    const double implicit = x[FRIC] * f.stick, throttle = x[THROT] * std::abs(v);
    const double direction = v >= 0.0 ? 1.0 : -1.0, viscous = x[VISC] + direction * x[SKEW];
    const double force = area1 * p1 - area2 * p2 - x[FRIC] * f.curve - x[LOAD] - x[STIF] * x[X];
    const double den = std::max(1.0 + mu * h * (viscous + throttle + implicit), 0.5);
    const double v_new = (v * (1.0 + mu * h * implicit) + mu * h * force) / den;
    dv[X] = -mu * h * x[STIF];
    dv[V] = 1.0 + mu * h * (implicit - x[FRIC] * f.slope + x[FRIC] * f.stick_slope * (v - v_new)) -
            mu * h * x[THROT] * v_new * direction;
    dv[P1] = mu * h * area1;
    dv[P2] = -mu * h * area2;
    // Friction and load learn from the mean force alone (balance_forces): no derivatives to them are needed.
    dv /= den;

    const double inflow1 = a1 - area1 * v_new, inflow2 = area2 * v_new - a2;
    const double extra_w = w_at - x[W], extra_v = v_at - v_new;
    const double at1 = inflow1 + into * extra_w - area1 * extra_v, at2 = inflow2 - out_of * extra_w + area2 * extra_v;
    const double by_air1 = -h * i1 * b1.of_air / b1.value * at1, by_air2 = -h * i2 * b2.of_air / b2.value * at2;
    F.setZero();
    F.row(X) = h * dv.transpose();
    F.row(V) = dv.transpose();
    F.row(P1) = h * i1 * (da1 - area1 * dv).transpose();
    F.row(P2) = h * i2 * (area2 * dv - da2).transpose();
    F(X, X) += 1.0;
    F(TH, TH) = F(W, W) = 1.0;
    F(TH, W) = h;
    F(P1, P1) += 1.0;
    F(P2, P2) += 1.0;
    F(P1, X) += -h * i1 * swept1 / volume1 * at1;
    F(P1, P1) += -h * i1 * b1.slope / b1.value * at1;
    F(P1, AIR) += by_air1;
    F(P1, SPLIT) += by_air1;
    F(P2, X) += h * i2 * swept2 / volume2 * at2;
    F(P2, P2) += -h * i2 * b2.slope / b2.value * at2;
    F(P2, AIR) += by_air2;
    F(P2, SPLIT) -= by_air2;
    G.setZero();
    G(X, 0) = h;
    G(V, 0) = 1.0;
    G(P1, 0) = -h * area1 * i1;
    G(P2, 0) = h * area2 * i2;
    G(TH, 1) = h;
    G(W, 1) = 1.0;
    G(P1, 1) = h * into * i1;
    G(P2, 1) = -h * out_of * i2;
    G(P1, 2) = i1;
    G(P2, 3) = i2;

    x[X] += h * v_new;
    x[V] = v_new;
    x[TH] += h * x[W];
    x[P1] += h * i1 * inflow1;
    x[P2] += h * i2 * inflow2;
}
