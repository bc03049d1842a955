// Non-negative least squares on a small support, in double precision. For *_kernels.cpp files only.
#pragma once

#include <cstdint>

#include "coder_kernels.h"
#include "vector.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr double kDependent = 1e-5;  // share of its squared norm that an atom must have left beside the others
constexpr double kNoWeight = 1e-7;   // weights below this share of the largest possible are rounding

// Atoms with weights. Atoms may depend on each other until weights were solved for.
struct Support {
    int count = 0;
    int32_t atoms[kMaxSlots];
    double weights[kMaxSlots];
    double explained = 0;  // squared norm of the decoded code, w . s

    void add(int32_t atom) { atoms[count++] = atom; }
};

// Lower Cholesky factor of the Gram matrix of some atoms, packed row after row.
class Factor {
  public:
    static constexpr int kSize = kMaxSlots * (kMaxSlots + 1) / 2;

    double& at(int i, int j) { return values_[i * (i + 1) / 2 + j]; }
    double at(int i, int j) const { return values_[i * (i + 1) / 2 + j]; }

    // Factors the matrix of these atoms. False if one of them depends on those before.
    bool build(const CodeProblem& problem, const int32_t* atoms, int count) {
        count_ = count;
        for (int i = 0; i < count; ++i) {
            const float* gram = problem.gram + atoms[i] * problem.stride;
            for (int j = 0; j <= i; ++j) {
                double rest = gram[atoms[j]];
                for (int k = 0; k < j; ++k) rest -= at(i, k) * at(j, k);
                if (j < i) {
                    at(i, j) = rest * inverse_[j];
                    continue;
                }
                if (!(rest > kDependent * gram[atoms[i]])) return false;
                inverse_[i] = 1 / __builtin_sqrt(rest);
                at(i, i) = rest * inverse_[i];
            }
        }
        return true;
    }

    // x = matrix^-1 b
    void solve(const double* b, double* x) const {
        for (int i = 0; i < count_; ++i) {
            double rest = b[i];
            for (int k = 0; k < i; ++k) rest -= at(i, k) * x[k];
            x[i] = rest * inverse_[i];
        }
        for (int i = count_ - 1; i >= 0; --i) {
            double rest = x[i];
            for (int k = i + 1; k < count_; ++k) rest -= at(k, i) * x[k];
            x[i] = rest * inverse_[i];
        }
    }

  private:
    int count_ = 0;
    double values_[kSize];
    double inverse_[kMaxSlots];  // 1 / diagonal
};

// The active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), started from nothing.
// Atoms that depend on those in use stay out.
class ActiveSet {
  public:
    ActiveSet(const CodeProblem& problem, const float* similarities, Factor& factor, Support& support)
        : problem_(problem), similarities_(similarities), factor_(factor), support_(support) {}

    void solve(double smallest) {
        for (int i = 0; i < support_.count; ++i) {
            support_.weights[i] = 0;
            out_[i] = false;
        }
        // Each round adds an atom; one that a step drops may come back, but not for ever.
        for (int round = 0; round < 4 * support_.count; ++round) {
            const int enters = steepest(smallest);
            if (enters < 0) return;
            used_[n_used_++] = enters;
            if (!settle(smallest)) out_[enters] = true;
        }
    }

  private:
    // Which unused atom lowers the residual fastest; -1 if none does.
    int steepest(double smallest) const {
        int best = -1;
        double best_pull = 0;
        for (int i = 0; i < support_.count; ++i) {
            if (out_[i] || is_used(i)) continue;
            const float* gram = problem_.gram + support_.atoms[i] * problem_.stride;
            double pull = similarities_[support_.atoms[i]];
            for (int u = 0; u < n_used_; ++u) pull -= gram[support_.atoms[used_[u]]] * support_.weights[used_[u]];
            if (pull > best_pull && pull > smallest * gram[support_.atoms[i]]) {
                best = i;
                best_pull = pull;
            }
        }
        return best;
    }

    // Least squares on the atoms in use, dropping those that would turn negative on the way there. False, and
    // the last atom is out again, if that atom is no use after all.
    bool settle(double smallest) {
        const int entered = used_[n_used_ - 1];
        for (;;) {
            int32_t atoms[kMaxSlots];
            double toward[kMaxSlots], target[kMaxSlots];
            for (int u = 0; u < n_used_; ++u) {
                atoms[u] = support_.atoms[used_[u]];
                toward[u] = similarities_[atoms[u]];
            }
            const bool last_is_new = n_used_ > 0 && used_[n_used_ - 1] == entered && support_.weights[entered] == 0;
            const bool independent = factor_.build(problem_, atoms, n_used_);
            if (independent) factor_.solve(toward, target);
            if (!independent || (last_is_new && !(target[n_used_ - 1] > smallest))) {
                --n_used_;  // only the newest can depend on the others
                return false;
            }
            double step = 1;
            for (int u = 0; u < n_used_; ++u) {
                const double now = support_.weights[used_[u]];
                if (target[u] <= smallest && now / (now - target[u]) < step) step = now / (now - target[u]);
            }
            int kept = 0;
            for (int u = 0; u < n_used_; ++u) {
                double& weight = support_.weights[used_[u]];
                weight += step * (target[u] - weight);
                const bool keep = step == 1 || weight > smallest;
                if (keep) {
                    used_[kept++] = used_[u];
                } else {
                    weight = 0;
                }
            }
            if (kept == n_used_) return true;
            n_used_ = kept;
        }
    }

    bool is_used(int i) const {
        for (int u = 0; u < n_used_; ++u)
            if (used_[u] == i) return true;
        return false;
    }

    const CodeProblem& problem_;
    const float* similarities_;
    Factor& factor_;
    Support& support_;
    int used_[kMaxSlots];
    int n_used_ = 0;
    bool out_[kMaxSlots];
};

// Solves for the weights of the support's atoms and keeps those that have one. Atoms may repeat, or be zero.
SCOUP_INLINE void solve_nonnegative(const CodeProblem& problem, const float* similarities, Factor& factor,
                                    Support& support) {
    double toward[kMaxSlots];
    double largest = 0;
    for (int i = 0; i < support.count; ++i) {
        toward[i] = similarities[support.atoms[i]];
        const double alone = toward[i] / problem.norms[support.atoms[i]];
        largest = alone > largest ? alone : largest;
    }
    const double smallest = kNoWeight * largest;
    bool positive = factor.build(problem, support.atoms, support.count);
    if (positive) {
        factor.solve(toward, support.weights);
        for (int i = 0; i < support.count; ++i) positive &= support.weights[i] > smallest;
    }
    // Mostly that was all: the atoms were chosen for pulling the row's way.
    if (!positive) ActiveSet(problem, similarities, factor, support).solve(smallest);

    int kept = 0;
    support.explained = 0;
    for (int i = 0; i < support.count; ++i) {
        if (!(support.weights[i] > 0)) continue;
        support.atoms[kept] = support.atoms[i];
        support.weights[kept++] = support.weights[i];
        support.explained += support.weights[i] * toward[i];
    }
    support.count = kept;
}

}  // namespace
}  // namespace scoup::SCOUP_ISA
