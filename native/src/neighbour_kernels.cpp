#include "neighbour_kernels.h"

#include "vector.h"

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

    SCOUP_INLINE double worst() const { return squares[count - 1]; }
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

// Offers the points of a leaf to point `own`.
SCOUP_INLINE void offer_leaf(const PointTree& tree, int64_t leaf, int64_t own, const Nearest& nearest) {
    const int64_t first = tree.first[leaf], count = tree.first[leaf + 1] - first;
    const double x = tree.x[own], y = tree.y[own], z = tree.z[own];
    double squares[kLeaf];
    for (int64_t i = 0; i < count; ++i) {
        const double dx = tree.x[first + i] - x, dy = tree.y[first + i] - y, dz = tree.z[first + i] - z;
        squares[i] = dx * dx + dy * dy + dz * dz;
    }
    for (int64_t i = 0; i < count; ++i)
        if (squares[i] <= nearest.worst() && first + i != own) nearest.offer(squares[i], tree.number[first + i]);
}

void nearest(const PointTree& tree, int64_t leaf, int64_t count, const NeighbourScratch& scratch, int64_t* numbers,
             double* lengths) {
    const int64_t first = tree.first[leaf], points = tree.first[leaf + 1] - first, inner = tree.leaves - 1;
    const Box& own = tree.boxes[inner + leaf];
    const auto of = [&](int64_t point) { return Nearest{scratch.squares + point * count, scratch.numbers + point * count, count}; };
    for (int64_t i = 0; i < points * count; ++i) scratch.squares[i] = __builtin_inf(), scratch.numbers[i] = INT64_MAX;
    for (int64_t point = 0; point < points; ++point) offer_leaf(tree, leaf, first + point, of(point));
    double farthest = 0;  // of what is wanted yet
    const auto measure = [&] {
        farthest = 0;
        for (int64_t point = 0; point < points; ++point) farthest = larger_of(farthest, of(point).worst());
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
        for (int64_t point = 0; point < points; ++point) {
            const int64_t at = first + point;
            const Box place{{tree.x[at], tree.y[at], tree.z[at]}, {tree.x[at], tree.y[at], tree.z[at]}};
            if (gap(place, tree.boxes[next.box]) <= of(point).worst()) offer_leaf(tree, other, at, of(point));
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
