#include "neighbour_kernels.h"

#include "doubles.h"

namespace scoup::SCOUP_ISA {
namespace {

SCOUP_INLINE double larger_of(double a, double b) { return a > b ? a : b; }

// Square of the distance of two boxes.
SCOUP_INLINE double gap(const Box& a, const Box& b) {
    double square = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const double apart = larger_of(larger_of(a.low[axis] - b.high[axis], b.low[axis] - a.high[axis]), 0.0);
        square += apart * apart;
    }
    return square;
}

// The nearest others of one point so far.
struct Nearest {
    double* squares;
    int64_t* numbers;
    int64_t count;

    SCOUP_INLINE void offer(double square, int64_t number) const {
        int64_t place = count - 1;
        if (square > squares[place] || (square == squares[place] && number > numbers[place])) return;
        for (; place > 0; --place) {
            if (squares[place - 1] < square || (squares[place - 1] == square && numbers[place - 1] < number)) break;
            squares[place] = squares[place - 1], numbers[place] = numbers[place - 1];
        }
        squares[place] = square, numbers[place] = number;
    }
};

// Offers the points of a leaf to point `own`; returns the square of the farthest that it has then.
SCOUP_INLINE double offer_leaf(const PointTree& tree, int64_t leaf, int64_t own, double worst, const Nearest& nearest) {
    const int64_t first = tree.first[leaf], count = tree.first[leaf + 1] - first;
    double squares[kLeaf];
    uint32_t near = 0;
    for (int64_t i = 0; i < kLeaf; i += kGroup) {
        const Doubles dx = load(tree.x + first + i) - tree.x[own], dy = load(tree.y + first + i) - tree.y[own],
                      dz = load(tree.z + first + i) - tree.z[own];
        Doubles square = dx * dx;  // rounded as gap() is, which is never more
        square += dy * dy;
        square += dz * dz;
        store(squares + i, square);
        near |= bits(square <= worst) << i;
    }
    near &= (uint32_t(1) << count) - 1;
    if (own >= first && own < first + count) near &= ~(uint32_t(1) << (own - first));
    for (; near != 0; near &= near - 1) {
        const int i = __builtin_ctz(near);
        nearest.offer(squares[i], tree.number[first + i]);
    }
    return nearest.squares[nearest.count - 1];
}

// The points of a leaf that may have a neighbour in a box, as bits.
SCOUP_INLINE uint32_t points_near(const PointTree& tree, int64_t first, const Box& box, const double* worst) {
    uint32_t near = 0;
    for (int64_t i = 0; i < kLeaf; i += kGroup) {
        Doubles square{};
        const double* const axes[] = {tree.x, tree.y, tree.z};
        for (int axis = 0; axis < 3; ++axis) {
            const Doubles place = load(axes[axis] + first + i);
            const Doubles apart = at_least(at_least(place - box.high[axis], box.low[axis] - place), Doubles{});
            square += apart * apart;
        }
        near |= bits(square <= load(worst + i)) << i;
    }
    return near;
}

void nearest(const PointTree& tree, int64_t leaf, int64_t count, const NeighbourScratch& scratch, int64_t* numbers,
             double* lengths) {
    const int64_t first = tree.first[leaf], points = tree.first[leaf + 1] - first, inner = tree.leaves - 1;
    const Box& own = tree.boxes[inner + leaf];
    const auto of = [&](int64_t point) { return Nearest{scratch.squares + point * count, scratch.numbers + point * count, count}; };
    for (int64_t i = 0; i < points * count; ++i) scratch.squares[i] = __builtin_inf(), scratch.numbers[i] = INT64_MAX;
    double worst[kLeaf];  // of each point
    for (int64_t point = 0; point < kLeaf; ++point)
        worst[point] = point < points ? offer_leaf(tree, leaf, first + point, __builtin_inf(), of(point)) : -1;
    double farthest = 0;  // of what is wanted yet
    const auto measure = [&] {
        farthest = 0;
        for (int64_t point = 0; point < kLeaf; ++point) farthest = larger_of(farthest, worst[point]);
    };
    measure();
    struct Waiting {
        int64_t box;
        double square;
    } waiting[128];
    int depth = 0;
    waiting[depth++] = {0, 0.0};
    while (depth > 0) {
        const Waiting next = waiting[--depth];
        if (next.square > farthest) continue;
        if (next.box < inner) {
            const int64_t left = 2 * next.box + 1, right = left + 1;
            const double to_left = gap(own, tree.boxes[left]), to_right = gap(own, tree.boxes[right]);
            const bool left_first = to_left <= to_right;  // the last to wait is the first to be looked at
            waiting[depth++] = left_first ? Waiting{right, to_right} : Waiting{left, to_left};
            waiting[depth++] = left_first ? Waiting{left, to_left} : Waiting{right, to_right};
            continue;
        }
        const int64_t other = next.box - inner;
        if (other == leaf) continue;
        for (uint32_t near = points_near(tree, first, tree.boxes[next.box], worst); near != 0; near &= near - 1) {
            const int point = __builtin_ctz(near);
            worst[point] = offer_leaf(tree, other, first + point, worst[point], of(point));
        }
        measure();
    }
    for (int64_t point = 0; point < points; ++point)
        for (int64_t i = 0; i < count; ++i) {
            const int64_t at = tree.number[first + point] * count + i;
            numbers[at] = scratch.numbers[point * count + i];
            lengths[at] = __builtin_sqrt(scratch.squares[point * count + i]);
        }
}

}  // namespace

const NeighbourKernels neighbour_kernels = {nearest};

}  // namespace scoup::SCOUP_ISA
