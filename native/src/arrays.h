// Arrays that come from Python, checked before anything is read. For bindings*.cpp files only.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>

#include "buffer.h"

namespace scoup {

using Array = nanobind::ndarray<nanobind::ro, nanobind::device::cpu>;
using WritableArray = nanobind::ndarray<nanobind::device::cpu>;

constexpr int64_t kAnySize = -1;

inline std::string shape_of(const std::initializer_list<int64_t>& shape) {
    std::string text = "[";
    for (const int64_t size : shape) text += (text.size() > 1 ? ", " : "") + (size == kAnySize ? "any" : std::to_string(size));
    return text + "]";
}

template <class T>
const char* type_name() {
    if constexpr (std::is_same_v<T, float>) return "float32";
    if constexpr (std::is_same_v<T, double>) return "float64";
    if constexpr (std::is_same_v<T, int32_t>) return "int32";
    if constexpr (std::is_same_v<T, int64_t>) return "int64";
    if constexpr (std::is_same_v<T, uint8_t>) return "uint8";
    if constexpr (std::is_same_v<T, uint16_t>) return "uint16";
    if constexpr (std::is_same_v<T, uint32_t>) return "uint32";
}

// The data of an array that must have this type and shape (kAnySize: any), be contiguous and aligned.
// Throws std::invalid_argument, which Python sees as ValueError, with the array's name.
template <class T, class A>
auto* data_of(const A& array, const char* name, std::initializer_list<int64_t> shape) {
    const auto refuse = [&](const std::string& why) {
        throw std::invalid_argument(std::string(name) + " must be a contiguous " + type_name<T>() + " array " +
                                    shape_of(shape) + "; " + why);
    };
    if (array.dtype() != nanobind::dtype<T>()) refuse("it has another dtype");
    if (array.ndim() != shape.size()) refuse("it has " + std::to_string(array.ndim()) + " dimensions");
    size_t axis = 0;
    int64_t step = 1;
    for (const int64_t size : shape) {
        if (size != kAnySize && int64_t(array.shape(axis)) != size)
            refuse("its axis " + std::to_string(axis) + " has " + std::to_string(array.shape(axis)) + " entries");
        ++axis;
    }
    for (size_t a = array.ndim(); a-- > 0;) {
        if (array.shape(a) > 1 && array.size() > 0 && array.stride(a) != step) refuse("it is not contiguous");
        step *= int64_t(array.shape(a));
    }
    if (reinterpret_cast<uintptr_t>(array.data()) % alignof(T) != 0) refuse("it is not aligned");
    using Pointer = std::conditional_t<std::is_same_v<A, Array>, const T*, T*>;
    return static_cast<Pointer>(array.data());
}

// A numpy array that owns the memory of a buffer, of which it shows the given shape.
template <class T>
nanobind::object to_numpy(Buffer<T>&& buffer, std::initializer_list<size_t> shape) {
    auto* kept = new Buffer<T>(buffer.size() > 0 ? std::move(buffer) : Buffer<T>(1));  // numpy wants memory even for nothing
    nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<Buffer<T>*>(p); });
    return nanobind::cast(nanobind::ndarray<nanobind::numpy, T>(kept->data(), shape, owner));
}

}  // namespace scoup
