// Memory for arrays.
//
// Getting fresh pages from the system for every view costs as much as projecting it. Large blocks are therefore asked
// for in large pages, and up to 256 MB of them are kept for the next view when they are given back.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <utility>

namespace scoup {

struct Block {
    void* data = nullptr;
    size_t bytes = 0;  // what there really is
};

// At least `bytes` (more than 0) of uninitialised memory on a 64 byte boundary. Throws std::bad_alloc.
Block allocate(size_t bytes);
void give_back(const Block& block) noexcept;
// Gives what is kept, and what else is free, to the system.
void release_kept() noexcept;

// An array of a fixed size, not initialised.
template <class T>
class Buffer {
  public:
    Buffer() = default;

    explicit Buffer(int64_t size) : size_(size) {
        if (size < 0 || size_t(size) > (std::numeric_limits<size_t>::max() >> 1) / sizeof(T)) throw std::bad_alloc();
        if (size > 0) block_ = allocate(bytes());
    }

    Buffer(Buffer&& other) noexcept { swap(other); }
    Buffer& operator=(Buffer&& other) noexcept {
        swap(other);
        return *this;
    }
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    ~Buffer() { give_back(block_); }

    T* data() { return static_cast<T*>(block_.data); }
    const T* data() const { return static_cast<const T*>(block_.data); }
    int64_t size() const { return size_; }
    size_t bytes() const { return size_t(size_) * sizeof(T); }
    T& operator[](int64_t i) { return data()[i]; }
    const T& operator[](int64_t i) const { return data()[i]; }
    T* begin() { return data(); }
    T* end() { return data() + size_; }

    void fill(const T& value) {
        for (int64_t i = 0; i < size_; ++i) data()[i] = value;
    }

  private:
    void swap(Buffer& other) noexcept {
        std::swap(block_, other.block_);
        std::swap(size_, other.size_);
    }

    Block block_;
    int64_t size_ = 0;
};

}  // namespace scoup
