// The choice of atoms for one row: greedy orthogonal least squares, then swaps.
#include "coder_kernels.h"

#include "vector.h"
#include "coder_nonnegative.h"

namespace scoup::SCOUP_ISA {
namespace {

constexpr float kNoGain = 1e-9f;    // share of the explained square below which another atom is rounding
constexpr double kSwapGain = 1e-6;  // share by which a swap must raise it

struct Pick {
    float gain;  // by how much the explained square grows; 0 if no atom helps
    int32_t atom;
};

// The best atom to add, found lane by lane: the first of the atoms that gain most.
class Best {
  public:
    // residual: similarity of atoms `first` .. with what is left of the row; left: what is left of their squared norms.
    SCOUP_INLINE void offer(Floats residual, Floats left, Floats floor, int32_t first) {
        const Ints usable = (residual > 0) & (left > floor);  // false for NaN
        const Floats gain = only(usable, residual * residual / left);
        const Ints better = gain > gain_;
        gain_ = better ? gain : gain_;
        first_ = better ? Ints{} + first : first_;
    }

    SCOUP_INLINE Pick pick() const {
        Pick best = {0, 0};
        for (int lane = 0; lane < kLanes; ++lane) {
            const int32_t atom = first_[lane] + lane;
            if (gain_[lane] > best.gain || (gain_[lane] == best.gain && atom < best.atom)) best = {gain_[lane], atom};
        }
        return best;
    }

  private:
    Floats gain_ = {};
    Ints first_ = {};
};

Pick first_pick(const CodeProblem& problem, const float* similarities) {
    Best best;
    for (int64_t j = 0; j < problem.stride; j += kLanes)
        best.offer(load(similarities + j), load(problem.norms + j), load(problem.floor + j), int32_t(j));
    return best.pick();
}

// Greedy orthogonal least squares: each atom is the one that, with those before, leaves the least of the row.
void choose(const CodeProblem& problem, const CoderScratch& scratch, const float* similarities, Support& support) {
    Pick pick = first_pick(problem, similarities);
    const float enough = kNoGain * pick.gain;
    while (pick.gain > enough) {
        support.add(pick.atom);
        if (support.count == problem.slots) return;
        const int earlier = support.count - 1;
        const float* residual = earlier ? scratch.residual : similarities;
        const float* left = earlier ? scratch.left : problem.norms;
        const float* gram = problem.gram + pick.atom * problem.stride;
        float* direction = scratch.directions + earlier * problem.stride;
        float along[kMaxSlots];  // components of the atom along earlier directions
        for (int u = 0; u < earlier; ++u) along[u] = scratch.directions[u * problem.stride + pick.atom];
        const float inverse = 1 / __builtin_sqrtf(left[pick.atom]);
        const float pull = residual[pick.atom] * inverse;
        Best best;
        for (int64_t j = 0; j < problem.stride; j += kLanes) {
            Floats q = load(gram + j);
            for (int u = 0; u < earlier; ++u) q -= along[u] * load(scratch.directions + u * problem.stride + j);
            q *= inverse;
            const Floats r = load(residual + j) - pull * q;
            const Floats d = load(left + j) - q * q;
            store(direction + j, q);
            store(scratch.residual + j, r);
            store(scratch.left + j, d);
            best.offer(r, d, load(problem.floor + j), int32_t(j));
        }
        // Its own left is zero but for rounding, hence under its floor: no atom is picked twice.
        pick = best.pick();
    }
}

// What removing each atom of a support would change, for all atoms at once.
//
// With M the inverse of the support's Gram matrix, row i of H = M G_S holds the weight of atom i in the least-squares
// copy of every other atom. Removing atom i gives back w_i / M_ii of it to the residual and 1 / M_ii to the
// squared norms left: r + (w_i / M_ii) h_i and d + h_i^2 / M_ii, with no need to start again from nothing.
class Removal {
  public:
    Removal(const CodeProblem& problem, const CoderScratch& scratch, const float* similarities)
        : problem_(problem), scratch_(scratch), similarities_(similarities) {}

    // False if that cannot be told for numbers too near to dependence.
    bool refresh(const Support& support, Factor& factor) {
        const int n = support.count;
        float inverse[kMaxSlots * kMaxSlots], weights[kMaxSlots];
        const float* gram[kMaxSlots];
        if (!factor.build(problem_, support.atoms, n)) return false;
        for (int i = 0; i < n; ++i) {
            double unit[kMaxSlots], column[kMaxSlots];
            for (int u = 0; u < n; ++u) unit[u] = u == i;
            factor.solve(unit, column);
            own_[i] = float(column[i]);
            for (int u = 0; u < n; ++u) inverse[i * n + u] = float(column[u]);
            weights[i] = float(support.weights[i]);
            gram[i] = problem_.gram + support.atoms[i] * problem_.stride;
        }
        switch (n) {  // the usual sizes with their loops unrolled
            case 3: spread<3>(n, gram, inverse, weights, support); break;
            case 4: spread<4>(n, gram, inverse, weights, support); break;
            default: spread<0>(n, gram, inverse, weights, support);
        }
        return true;
    }

    // The best atom in the place of atom `slot` of the support.
    Pick replacement(const Support& support, int slot, float& lost) const {
        const float back = 1 / own_[slot];
        const float weight = float(support.weights[slot]) * back;
        lost = float(support.weights[slot]) * weight;
        const float* h = scratch_.directions + slot * problem_.stride;
        Best best;
        for (int64_t j = 0; j < problem_.stride; j += kLanes) {
            const Floats copy = load(h + j);
            best.offer(load(scratch_.residual + j) + weight * copy, load(scratch_.left + j) + back * copy * copy,
                       load(problem_.floor + j), int32_t(j));
        }
        return best.pick();
    }

    // The best atom beside all of the support.
    Pick addition() const {
        Best best;
        for (int64_t j = 0; j < problem_.stride; j += kLanes)
            best.offer(load(scratch_.residual + j), load(scratch_.left + j), load(problem_.floor + j), int32_t(j));
        return best.pick();
    }

  private:
    template <int kCount>
    SCOUP_INLINE void spread(int count, const float* const* gram, const float* inverse, const float* weights,
                             const Support& support) {
        const int n = kCount ? kCount : count;
        for (int64_t j = 0; j < problem_.stride; j += kLanes) {
            Floats r = load(similarities_ + j), d = load(problem_.norms + j);
            for (int i = 0; i < n; ++i) {
                Floats h = {};
                for (int u = 0; u < n; ++u) h += inverse[i * n + u] * load(gram[u] + j);
                const Floats own = load(gram[i] + j);
                r -= weights[i] * own;
                d -= h * own;
                store(scratch_.directions + i * problem_.stride + j, h);
            }
            store(scratch_.residual + j, r);
            store(scratch_.left + j, d);
        }
        // Known exactly: the support leaves nothing of its own atoms, and each is a copy of itself alone.
        for (int u = 0; u < n; ++u) {
            const int32_t atom = support.atoms[u];
            scratch_.residual[atom] = scratch_.left[atom] = 0;
            for (int i = 0; i < n; ++i) scratch_.directions[i * problem_.stride + atom] = i == u;
        }
    }

    const CodeProblem& problem_;
    const CoderScratch& scratch_;
    const float* similarities_;
    float own_[kMaxSlots];  // the diagonal of M
};

// Tries each atom against all others, keeping what explains more, slot by slot. True if anything changed.
bool swap_pass(const CodeProblem& problem, const float* similarities, Removal& removal, bool& fresh, Factor& factor,
               Support& support) {
    bool changed = false;
    for (int slot = 0; slot < problem.slots && slot <= support.count; ++slot) {
        if (!fresh && !removal.refresh(support, factor)) return false;
        fresh = true;
        const bool adds = slot == support.count;
        float lost = 0;
        const Pick pick = adds ? removal.addition() : removal.replacement(support, slot, lost);
        // Least squares without signs bounds what the swap can explain.
        const double enough = support.explained * (1 + kSwapGain);
        if (!(support.explained - lost + pick.gain > enough)) continue;
        Support other = support;
        if (adds) {
            other.add(pick.atom);
        } else {
            other.atoms[slot] = pick.atom;
        }
        solve_nonnegative(problem, similarities, factor, other);
        if (!(other.explained > enough)) continue;
        support = other;
        changed = true;
        fresh = false;
    }
    return changed;
}

void by_falling_weight(Support& support) {
    for (int i = 1; i < support.count; ++i) {
        const double weight = support.weights[i];
        const int32_t atom = support.atoms[i];
        int at = i;
        for (; at > 0 && support.weights[at - 1] < weight; --at) {
            support.weights[at] = support.weights[at - 1];
            support.atoms[at] = support.atoms[at - 1];
        }
        support.weights[at] = weight;
        support.atoms[at] = atom;
    }
}

float code(const CodeProblem& problem, const CoderScratch& scratch, const float* similarities, const int32_t* warm,
           int32_t* atoms, float* weights) {
    Support support;
    Factor factor;
    if (warm == nullptr) {
        choose(problem, scratch, similarities, support);
    } else {
        for (int i = 0; i < problem.slots; ++i)
            if (warm[i] >= 0) support.add(warm[i]);
    }
    solve_nonnegative(problem, similarities, factor, support);
    if (problem.swap_passes > 0) {
        Removal removal(problem, scratch, similarities);
        bool fresh = false;
        for (int pass = 0; pass < problem.swap_passes; ++pass)
            if (!swap_pass(problem, similarities, removal, fresh, factor, support)) break;
    }
    by_falling_weight(support);
    for (int i = 0; i < problem.slots; ++i) {
        atoms[i] = i < support.count ? support.atoms[i] : -1;
        weights[i] = i < support.count ? float(support.weights[i]) : 0;
    }
    return float(__builtin_sqrt(support.explained > 0 ? support.explained : 0));
}

}  // namespace

extern const CoderKernels coder_kernels = {code};

}  // namespace scoup::SCOUP_ISA
