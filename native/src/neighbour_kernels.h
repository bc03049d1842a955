// Nearest neighbours of the points of one leaf of a tree of points.
#pragma once

#include <cstdint>

#include "isa.h"

namespace scoup {

constexpr int64_t kLeaf = 24;  // most points of a leaf, whole vectors of them; a bit each in 32

struct Box {
    double low[3], high[3];
};

// Points sorted into leaves, which halve the points along their widest side again and again.
struct PointTree {
    const double *x, *y, *z;  // [count + kLeaf] in the order of the leaves, zeros at the end
    const int64_t* number;    // [count] of each point
    const int64_t* first;     // [leaves + 1], where the points of each leaf begin
    const Box* boxes;         // [2 * leaves - 1], tight; the children of box i are 2 i + 1 and 2 i + 2, the leaves come last
    int64_t leaves;           // a power of two
};

struct NeighbourScratch {
    double* squares;   // [kLeaf, count], of the nearest others so far, nearest first
    int64_t* numbers;  // [kLeaf, count]
};

struct NeighbourKernels {
    // For each point of a leaf, its `count` nearest others, of equals the one with the lower number: rows of numbers and
    // lengths [points, count]. There are more points than `count`.
    void (*nearest)(const PointTree& tree, int64_t leaf, int64_t count, const NeighbourScratch& scratch, int64_t* numbers,
                    double* lengths);
};

SCOUP_KERNEL_TABLE(NeighbourKernels, neighbour_kernels)

}  // namespace scoup
