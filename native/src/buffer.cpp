#include "buffer.h"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <type_traits>

#if defined(__linux__)
#include <sys/mman.h>
#endif
#if defined(_WIN32) || defined(__GLIBC__)
#include <malloc.h>
#endif

namespace scoup {
namespace {

constexpr size_t kLargePage = size_t(2) << 20;
constexpr size_t kLarge = 2 * kLargePage;
constexpr size_t kMostKept = size_t(256) << 20;

void* system_allocate(size_t boundary, size_t bytes) {
#if defined(_WIN32)
    return _aligned_malloc(bytes, boundary);
#else
    return std::aligned_alloc(boundary, bytes);
#endif
}

void system_free(void* data) {
#if defined(_WIN32)
    _aligned_free(data);
#else
    std::free(data);
#endif
}

// Large blocks that were given back, to be used again. Nothing here allocates or throws: blocks are given back by
// destructors. The lock is only ever tried: where it is taken (by another thread, or for ever in a child forked
// meanwhile), memory comes from the system as usual.
class Kept {
  public:
    // The smallest block of at least that size, if there is one not much larger.
    Block take(size_t bytes) noexcept {
        const Lock lock(busy_);
        if (!lock.taken) return {};
        int best = -1;
        for (int i = 0; i < count_; ++i)
            if (blocks_[i].bytes >= bytes && blocks_[i].bytes / 2 <= bytes && (best < 0 || blocks_[i].bytes < blocks_[best].bytes))
                best = i;
        return best < 0 ? Block{} : remove(best);
    }

    // False if the block is not wanted.
    bool give(const Block& block) noexcept {
        const Lock lock(busy_);
        if (!lock.taken || block.bytes > kMostKept) return false;
        while (total_ + block.bytes > kMostKept) system_free(remove(0).data);  // the oldest go first
        blocks_[count_++] = block;
        total_ += block.bytes;
        return true;
    }

    void clear() noexcept {
        const Lock lock(busy_);
        while (lock.taken && count_ > 0) system_free(remove(count_ - 1).data);
    }

  private:
    struct Lock {
        explicit Lock(std::atomic_flag& flag) noexcept : busy(flag), taken(!flag.test_and_set(std::memory_order_acquire)) {}
        ~Lock() {
            if (taken) busy.clear(std::memory_order_release);
        }
        Lock(const Lock&) = delete;
        Lock& operator=(const Lock&) = delete;

        std::atomic_flag& busy;
        const bool taken;
    };

    Block remove(int i) noexcept {
        const Block block = blocks_[i];
        std::copy(blocks_ + i + 1, blocks_ + count_, blocks_ + i);
        --count_;
        total_ -= block.bytes;
        return block;
    }

    std::atomic_flag busy_ = ATOMIC_FLAG_INIT;
    Block blocks_[kMostKept / kLarge];  // no block is smaller than kLarge
    int count_ = 0;
    size_t total_ = 0;
};

// Never destroyed, having no destructor: arrays handed to Python may outlive static objects.
Kept kept;
static_assert(std::is_trivially_destructible_v<Kept>);

}  // namespace

Block allocate(size_t bytes) {
    // Arrays of views differ a little in size. Rounded to one of eight sizes between two powers of two, a view's fit where
    // those of an earlier one were.
    size_t step = 64;
    while (step < bytes / 8) step *= 2;
    bytes = (bytes + step - 1) / step * step;
    const size_t boundary = bytes < kLarge ? 64 : kLargePage;
    bytes = (bytes + boundary - 1) / boundary * boundary;
    if (bytes >= kLarge)
        if (const Block block = kept.take(bytes); block.data != nullptr) return block;
    void* data = system_allocate(boundary, bytes);
    if (data == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    if (bytes >= kLarge) madvise(data, bytes, MADV_HUGEPAGE);
#endif
    return {data, bytes};
}

void give_back(const Block& block) noexcept {
    if (block.data == nullptr) return;
    if (block.bytes >= kLarge && kept.give(block)) return;
    system_free(block.data);
}

void release_kept() noexcept {
    kept.clear();
#if defined(__GLIBC__)
    malloc_trim(0);  // else what all threads have freed stays with the process
#endif
}

}  // namespace scoup
