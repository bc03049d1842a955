#include "neighbours.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>

#include "buffer.h"
#include "neighbour_kernels.h"

namespace scoup {
namespace {

struct Point {
    double place[3];
    int64_t number;
};

Box box_of(const Point* points, int64_t count) {
    Box box{{points->place[0], points->place[1], points->place[2]}, {points->place[0], points->place[1], points->place[2]}};
    for (int64_t i = 1; i < count; ++i)
        for (int axis = 0; axis < 3; ++axis) {
            box.low[axis] = std::min(box.low[axis], points[i].place[axis]);
            box.high[axis] = std::max(box.high[axis], points[i].place[axis]);
        }
    return box;
}

// A tree with the memory that it points to.
class Tree {
  public:
    Tree(const double* points, int64_t n) : x_(n + kLeaf), y_(n + kLeaf), z_(n + kLeaf), number_(n) {
        x_.fill(0), y_.fill(0), z_.fill(0);
        leaves_ = 1;
        while (leaves_ * kLeaf < n) leaves_ *= 2;
        first_ = Buffer<int64_t>(leaves_ + 1);
        boxes_ = Buffer<Box>(2 * leaves_ - 1);
        Buffer<Point> sorted(n);
        for (int64_t i = 0; i < n; ++i) sorted[i] = {{points[3 * i], points[3 * i + 1], points[3 * i + 2]}, i};
        split(sorted.data(), 0, n, 0);
        first_[leaves_] = n;
        for (int64_t i = 0; i < n; ++i) {
            x_[i] = sorted[i].place[0], y_[i] = sorted[i].place[1], z_[i] = sorted[i].place[2];
            number_[i] = sorted[i].number;
        }
    }

    PointTree tree() const {
        return {x_.data(), y_.data(), z_.data(), number_.data(), first_.data(), boxes_.data(), leaves_};
    }

  private:
    // Sorts points first .. last - 1 into the leaves under a box. No leaf is empty, for each has more than kLeaf / 4 points
    // unless it is the only one.
    void split(Point* points, int64_t first, int64_t last, int64_t box) {
        boxes_[box] = box_of(points + first, last - first);
        if (box >= leaves_ - 1) {
            first_[box - (leaves_ - 1)] = first;
            return;
        }
        int widest = 0;
        for (int axis = 1; axis < 3; ++axis)
            if (side(boxes_[box], axis) > side(boxes_[box], widest)) widest = axis;
        const int64_t middle = first + (last - first) / 2;
        std::nth_element(points + first, points + middle, points + last, [widest](const Point& a, const Point& b) {
            return a.place[widest] < b.place[widest] || (a.place[widest] == b.place[widest] && a.number < b.number);
        });
        split(points, first, middle, 2 * box + 1);
        split(points, middle, last, 2 * box + 2);
    }

    static double side(const Box& box, int axis) { return box.high[axis] - box.low[axis]; }

    Buffer<double> x_, y_, z_;
    Buffer<int64_t> number_, first_;
    Buffer<Box> boxes_;
    int64_t leaves_ = 1;
};

}  // namespace

void nearest_points(const double* points, int64_t n, int64_t count, int64_t* numbers, double* lengths, int n_threads,
                    const Interrupted& interrupted) {
    if (n == 0 || count == 0) return;
    const Tree sorted(points, n);
    const PointTree tree = sorted.tree();
    const auto& kernels = pick(baseline::neighbour_kernels, v3::neighbour_kernels, v4::neighbour_kernels);
    constexpr int64_t kAtOnce = 64;
    const int64_t chunks = (tree.leaves + kAtOnce - 1) / kAtOnce;
    n_threads = workers(chunks, n_threads);
    Buffer<double> squares(n_threads * kLeaf * count);
    Buffer<int64_t> nearest(n_threads * kLeaf * count);
    for_chunks(chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t own = worker * kLeaf * count;
        for (int64_t leaf = chunk * kAtOnce; leaf < std::min((chunk + 1) * kAtOnce, tree.leaves); ++leaf)
            kernels.nearest(tree, leaf, count, {squares.data() + own, nearest.data() + own}, numbers, lengths);
    });
}

void linked_parts(const int64_t* numbers, const double* lengths, int64_t n, int64_t count, double longest, int64_t* parts) {
    Buffer<int64_t> buffer(n);
    int64_t* parents = buffer.data();  // the lowest point of a part stands for it
    std::iota(parents, parents + n, int64_t(0));
    const auto first_of = [&](int64_t point) {
        while (parents[point] != point) point = parents[point] = parents[parents[point]];
        return point;
    };
    for (int64_t i = 0; i < n * count; ++i) {
        if (!(lengths[i] <= longest)) continue;
        if (numbers[i] < 0 || numbers[i] >= n) throw std::invalid_argument("a link leads to no point");
        const int64_t one = first_of(i / count), other = first_of(numbers[i]);
        parents[std::max(one, other)] = std::min(one, other);
    }
    int64_t found = 0;
    for (int64_t i = 0; i < n; ++i) {
        const int64_t first = first_of(i);
        parts[i] = first == i ? found++ : parts[first];
    }
}

}  // namespace scoup
