// Memory that runs out on request, in the thread that asks for it. For one .cpp file of a program: it replaces operator
// new.
#pragma once

#include <cstdlib>
#include <new>

namespace scoup {

// How many more calls of operator new succeed in this thread; below 0 all do.
inline thread_local int allocations_left = -1;

struct FailingMemory {
    explicit FailingMemory(int successes) { allocations_left = successes; }
    ~FailingMemory() { allocations_left = -1; }
    FailingMemory(const FailingMemory&) = delete;
    FailingMemory& operator=(const FailingMemory&) = delete;
};

}  // namespace scoup

void* operator new(size_t bytes, const std::nothrow_t&) noexcept {
    if (scoup::allocations_left == 0) return nullptr;
    if (scoup::allocations_left > 0) --scoup::allocations_left;
    return std::malloc(bytes > 0 ? bytes : 1);
}
void* operator new(size_t bytes) {
    if (void* data = operator new(bytes, std::nothrow)) return data;
    throw std::bad_alloc();
}
void operator delete(void* data) noexcept { std::free(data); }
void operator delete(void* data, size_t) noexcept { std::free(data); }
void operator delete(void* data, const std::nothrow_t&) noexcept { std::free(data); }
