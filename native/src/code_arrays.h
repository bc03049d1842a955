// Arrays of code indices that come from Python. For bindings*.cpp files only.
#pragma once

#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>

#include "arrays.h"
#include "code_kernels.h"

namespace scoup {

template <class Index>
void check_indices(const Index* indices, int64_t count, int32_t n_atoms) {
    Index largest = 0;
    for (int64_t i = 0; i < count; ++i) largest = std::max(largest, indices[i]);
    if (count > 0 && int64_t(largest) >= n_atoms)
        throw std::invalid_argument("a code refers to atom " + std::to_string(largest) + " of " + std::to_string(n_atoms));
}

// Code indices of one byte, or else of two; the other pointer is null.
struct Indices {
    const uint8_t* bytes = nullptr;
    const uint16_t* wide = nullptr;
};

// Of `count` from the `first` on it is checked that there are such atoms.
inline Indices code_indices(const Array& indices, const char* name, std::initializer_list<int64_t> shape, int32_t n_atoms,
                            int64_t first, int64_t count) {
    Indices found;
    if (indices.dtype() == nanobind::dtype<uint8_t>()) {
        found.bytes = data_of<uint8_t>(indices, name, shape);
        if (n_atoms < 256) check_indices(found.bytes + first, count, n_atoms);
    } else {
        found.wide = data_of<uint16_t>(indices, name, shape);
        if (n_atoms < 65536) check_indices(found.wide + first, count, n_atoms);
    }
    return found;
}

// float16 weights come as the uint16 of their bits.
// Whether the atoms exist is found out when they are met.
inline GaussianCodes gaussian_codes(int64_t n, const Array& indices, const Array& weights, int64_t n_atoms) {
    if (indices.ndim() != 3) throw std::invalid_argument("code indices must be [N, levels, k]");
    if (n_atoms < 1 || n_atoms > 65536) throw std::invalid_argument("there must be 1 to 65536 atoms");
    const auto levels = int64_t(indices.shape(1)), k = int64_t(indices.shape(2));
    if (levels > 1024 || k > n_atoms + 65536) throw std::invalid_argument("codes of too many levels or entries");
    GaussianCodes codes{nullptr, nullptr, nullptr, nullptr, int32_t(levels), int32_t(k), int32_t(n_atoms)};
    if (indices.dtype() == nanobind::dtype<uint8_t>())
        codes.indices8 = data_of<uint8_t>(indices, "code indices", {n, levels, k});
    else
        codes.indices16 = data_of<uint16_t>(indices, "code indices", {n, levels, k});
    if (weights.dtype() == nanobind::dtype<uint16_t>())
        codes.half_weights = data_of<uint16_t>(weights, "code weights", {n, levels, k});
    else
        codes.weights = data_of<float>(weights, "code weights", {n, levels, k});
    return codes;
}

}  // namespace scoup
