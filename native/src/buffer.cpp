#include "buffer.h"

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif
#if defined(_WIN32)
#include <malloc.h>
#endif

namespace scoup {
namespace {

constexpr size_t kLargePage = size_t(2) << 20;
constexpr size_t kLarge = 2 * kLargePage;
constexpr size_t kMostKept = size_t(512) << 20;

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

// Large blocks that were given back, to be used again. The lock is only ever tried: where it is taken (by another
// thread, or for ever in a child forked meanwhile), memory comes from the system as usual.
class Kept {
  public:
    // The smallest block of at least that size, if there is one not much larger.
    Block take(size_t bytes) {
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        if (!lock) return {};
        auto best = blocks_.end();
        for (auto block = blocks_.begin(); block != blocks_.end(); ++block)
            if (block->bytes >= bytes && block->bytes / 2 <= bytes && (best == blocks_.end() || block->bytes < best->bytes))
                best = block;
        if (best == blocks_.end()) return {};
        const Block found = *best;
        total_ -= found.bytes;
        blocks_.erase(best);
        return found;
    }

    // False if the block is not wanted.
    bool give(const Block& block) {
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        if (!lock || block.bytes > kMostKept) return false;
        blocks_.push_back(block);
        total_ += block.bytes;
        while (total_ > kMostKept) {  // the oldest go first
            system_free(blocks_.front().data);
            total_ -= blocks_.front().bytes;
            blocks_.erase(blocks_.begin());
        }
        return true;
    }

  private:
    std::mutex mutex_;
    std::vector<Block> blocks_;
    size_t total_ = 0;
};

Kept& kept() {
    static Kept* blocks = new Kept;  // never destroyed: arrays handed to Python may outlive static objects
    return *blocks;
}

}  // namespace

Block allocate(size_t bytes) {
    const size_t boundary = bytes < kLarge ? 64 : kLargePage;
    bytes = (bytes + boundary - 1) / boundary * boundary;
    if (bytes >= kLarge)
        if (const Block block = kept().take(bytes); block.data != nullptr) return block;
    void* data = system_allocate(boundary, bytes);
    if (data == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    if (bytes >= kLarge) madvise(data, bytes, MADV_HUGEPAGE);
#endif
    return {data, bytes};
}

void give_back(const Block& block) {
    if (block.data == nullptr) return;
    if (block.bytes >= kLarge && kept().give(block)) return;
    system_free(block.data);
}

}  // namespace scoup
