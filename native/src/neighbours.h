// Nearest neighbours of points, and the parts that are linked by them: what scoup/scene/neighbours.py says.
#pragma once

#include <cstdint>

#include "threads.h"

namespace scoup {

// The `count` nearest others of finite points [n, 3], nearest first, of equals the one with the lower number: numbers and
// lengths [n, count]. n > count >= 0.
void nearest_points(const double* points, int64_t n, int64_t count, int64_t* numbers, double* lengths, int n_threads,
                    const Interrupted& interrupted);

// The part [n] of each point: those that links [n, count] of at most `longest` connect, numbered by their first points.
void linked_parts(const int64_t* numbers, const double* lengths, int64_t n, int64_t count, double longest, int64_t* parts);

}  // namespace scoup
