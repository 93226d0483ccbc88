// Covariance step and updates of `estimators.eha.update`, written twice.
//
// The size N of the coupled block chooses: N = STATES is one dense matrix with the products and Joseph updates of a
// textbook; N = COUPLED has the tracker's own structure, two blocks and channels that select rows.
#pragma once
#include <utility>

#include "model.hpp"

using Channels = Eigen::Matrix<double, MEASUREMENTS, 1>;
using Motion = Eigen::Matrix<double, MOVING, 1>;
using Load = Eigen::Matrix<double, LOADS, 1>;
using Few = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, MEASUREMENTS, MEASUREMENTS>;

// One scalar channel h of variance r in Joseph form, (I - k h) P (I - k h)' + k r k'. Returns s, fills the gain.
template <int N>
double joseph(Eigen::Matrix<double, N, N>& P, const Eigen::Matrix<double, N, 1>& h, double r,
              Eigen::Matrix<double, N, 1>& k) {
    const Eigen::Matrix<double, N, 1> Ph = P * h;
    const double s = h.dot(Ph) + r;
    k = Ph / s;
    P -= k * Ph.transpose();
    const Eigen::Matrix<double, N, 1> left = P * h;
    P += (k * r - left) * k.transpose();
    P = (0.5 * (P + P.transpose())).eval();
    return s;
}

template <int N>
struct Filter {  // friction and load states are in B where they are not in A
    static constexpr bool DENSE = N == STATES;
    using Vector = Eigen::Matrix<double, N, 1>;
    using Matrix = Eigen::Matrix<double, N, N>;
    State x;
    Matrix A;
    Eigen::Matrix<double, LOADS, LOADS> B;
    Channels e_post = Channels::Zero();
    int plus[MEASUREMENTS] = {X, TH, P1, P2, P1, P1}, minus[MEASUREMENTS] = {-1, -1, -1, -1, P2, -1};

    Filter() {
        A.setZero();
        B.setZero();
    }

    void widen(const State& variances) {
        A.diagonal() += variances.template head<N>();
        if constexpr (!DENSE) B.diagonal() += variances.template tail<LOADS>();
    }

    double& variance(int i) {
        if constexpr (DENSE) return A(i, i);
        else return i < COUPLED ? A(i, i) : B(i - COUPLED, i - COUPLED);
    }

    // A parameter shrinks towards zero, and what is correlated with it follows.
    void shrink(int j, double keep) {
        x[j] *= keep;
        A.row(j) *= keep;
        A.col(j) *= keep;
    }

    // State `j` is moved, and the other parameters along the covariance.
    void move(int j, double by) {
        if (!(variance(j) > 0.0)) return;
        if (DENSE || j < COUPLED) {
            const double share = by / A(j, j);
            for (int i = LEAK; i < N; ++i) x[i] += A(i, j) * share;
        } else {
            x.template tail<LOADS>() += B.col(j - COUPLED) * (by / B(j - COUPLED, j - COUPLED));
        }
    }

    void propagate(const Jacobian& F, const Effect& G, const Eigen::Vector4d& noise, const State& walks) {
        if constexpr (DENSE) {
            Matrix full = Matrix::Identity();
            full.template topLeftCorner<MOVING, COUPLED>() = F;
            Eigen::Matrix<double, N, 4> effect = Eigen::Matrix<double, N, 4>::Zero();
            effect.template topRows<MOVING>() = G;
            A = (full * A * full.transpose() + effect * noise.asDiagonal() * effect.transpose()).eval();
            A = (0.5 * (A + A.transpose())).eval();
        } else {
            const Eigen::Matrix<double, MOVING, N> carried = F * A;
            A.template topRows<MOVING>() = carried;
            A.template leftCols<MOVING>() = carried.transpose();
            const Eigen::Matrix<double, MOVING, MOVING> corner =
                carried * F.transpose() + G * noise.asDiagonal() * G.transpose();
            A.template topLeftCorner<MOVING, MOVING>() = 0.5 * (corner + corner.transpose());
        }
        widen(walks);
    }

    Channels innovation(const Channels& z) const {
        Channels y;
        for (int c = 0; c < MEASUREMENTS; ++c) y[c] = z[c] - x[plus[c]] + (minus[c] >= 0 ? x[minus[c]] : 0.0);
        return y;
    }

    Vector output(int c) const {
        Vector h = Vector::Zero();
        h[plus[c]] = 1.0;
        if (minus[c] >= 0) h[minus[c]] = -1.0;
        return h;
    }

    double channel_variance(int c) const {
        const int a = plus[c], b = minus[c];
        return b < 0 ? A(a, a) : A(a, a) - 2.0 * A(a, b) + A(b, b);
    }

    // Channel `c`; rows of A where it selects them (estimators.eha.update says why this is Joseph's form).
    double scalar_update(int c, double r, Vector& k) {
        if constexpr (DENSE) {
            return joseph(A, output(c), r, k);
        } else {
            const int a = plus[c], b = minus[c];
            Vector Ph = A.col(a);
            if (b >= 0) Ph -= A.col(b);
            const double s = (b < 0 ? Ph[a] : Ph[a] - Ph[b]) + r, root = std::sqrt(s);
            const Vector u = Ph / root;
            A -= u * u.transpose();
            k = u / root;
            if (b < 0) {
                A.col(a) = r * k;
                A.row(a) = A.col(a).transpose();
            } else {
                Vector half = 0.5 * (r * k - (A.col(a) - A.col(b)));
                const double kept = A(a, b);
                half[a] = half[b] = 0.0;
                A.col(a) += half;
                A.col(b) -= half;
                A.row(a) = A.col(a).transpose();
                A.row(b) = A.col(b).transpose();
                A(a, a) = r * k[a] + kept;
                A(b, b) = kept - r * k[b];
                A(a, b) = A(b, a) = kept;
            }
            return s;
        }
    }

    std::pair<double, double> update(const Channels& y, const Channels& r, const bool* mask) {
        Vector shift = Vector::Zero(), k;
        double nis = 0.0, log_likelihood = 0.0;
        for (int c = 0; c < MEASUREMENTS; ++c) {
            if (!mask[c]) continue;
            const double s = scalar_update(c, r[c], k);
            const double e = y[c] - shift[plus[c]] + (minus[c] >= 0 ? shift[minus[c]] : 0.0);
            shift += e * k;
            nis += e * e / s;
            log_likelihood -= 0.5 * (std::log(2.0 * M_PI * s) + e * e / s);
        }
        x.template head<N>() += shift;
        return {nis, log_likelihood};
    }

    // The EKF-SVSF: motion states by the SVSF's gain where an optimal layer leaves its limit.
    bool svsf(const Channels& y, const Channels& r, const bool* mask, double gamma, double layer, Motion& motion,
              Motion& variances) {
        int used[MEASUREMENTS], m = 0;
        for (int c = 0; c < MEASUREMENTS; ++c)
            if (mask[c]) used[m++] = c;
        if (m == 0) return false;
        Few HPH(m, m), R = Few::Zero(m, m);
        Eigen::Matrix<double, N, Eigen::Dynamic, 0, N, MEASUREMENTS> PH(N, m);
        for (int i = 0; i < m; ++i) {
            PH.col(i) = A.col(plus[used[i]]);
            if (minus[used[i]] >= 0) PH.col(i) -= A.col(minus[used[i]]);
            R(i, i) = r[used[i]];
        }
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < m; ++j)
                HPH(i, j) = PH(plus[used[i]], j) - (minus[used[i]] >= 0 ? PH(minus[used[i]], j) : 0.0);
        Eigen::LLT<Few> factor(HPH);
        if (factor.info() != Eigen::Success) factor.compute(HPH + TIE_BREAK * R);
        if (factor.info() != Eigen::Success) return false;
        const Few optimal = factor.solve(HPH + R);
        Few weights = Few::Zero(m, m);
        bool exceeded = false;
        for (int i = 0; i < m; ++i) {
            const double e = std::abs(y[used[i]]), size = e + gamma * std::abs(e_post[used[i]]);
            const double limit = layer * std::sqrt(HPH(i, i) + R(i, i)), best = optimal(i, i) * size;
            exceeded = exceeded || best > limit;
            const double psi = 0.0 < best && best < limit ? best : limit;
            weights(i, i) = e > psi ? size / e : size / psi;
        }
        if (!exceeded) return false;
        const auto K = (PH * factor.solve(Few::Identity(m, m)) * weights).eval();
        Eigen::Matrix<double, N, N> left = Eigen::Matrix<double, N, N>::Identity();
        Vector moved = x.template head<N>();
        for (int i = 0; i < m; ++i) {
            left -= K.col(i) * output(used[i]).transpose();
            moved += K.col(i) * y[used[i]];
        }
        const Matrix posterior = left * A * left.transpose() + K * R * K.transpose();
        motion = moved.template head<MOVING>();
        variances = posterior.diagonal().template head<MOVING>();
        return true;
    }

    // After an SVSF gain: motion is the SVSF's, parameters stay the Kalman filter's.
    void take(const Motion& motion, const Motion& variances) {
        for (int i = 0; i < MOVING; ++i) {
            if (std::isfinite(motion[i])) x[i] = motion[i];
            const double surplus = variances[i] - A(i, i);
            if (surplus > 0.0 && std::isfinite(surplus)) A(i, i) += surplus;
        }
    }

    void force_update(const Load& h, double y, double r) {
        if constexpr (DENSE) {
            Vector out = Vector::Zero(), k;
            out.template tail<LOADS>() = h;
            joseph(A, out, r, k);
            x += k * y;
        } else {
            Load k;
            joseph(B, h, r, k);
            x.template tail<LOADS>() += k * y;
        }
    }

    double force_variance(const Load& h) const {
        if constexpr (DENSE) return h.dot(A.template bottomRightCorner<LOADS, LOADS>() * h);
        else return h.dot(B * h);
    }
};
