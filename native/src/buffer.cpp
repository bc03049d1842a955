#include "buffer.h"

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace scoup {
namespace {

constexpr size_t kLargePage = size_t(2) << 20;
constexpr size_t kLarge = 2 * kLargePage;
constexpr size_t kMostKept = size_t(512) << 20;

// Large blocks that were given back, to be used again. The lock is only ever tried: where it is taken (by another
// thread, or for ever in a child forked meanwhile), memory comes from the system as usual.
class Kept {
  public:
    void* take(size_t bytes) {
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        if (!lock) return nullptr;
        auto best = blocks_.end();
        for (auto block = blocks_.begin(); block != blocks_.end(); ++block)
            if (block->bytes >= bytes && block->bytes / 2 <= bytes && (best == blocks_.end() || block->bytes < best->bytes))
                best = block;
        if (best == blocks_.end()) return nullptr;
        void* data = best->data;
        total_ -= best->bytes;
        blocks_.erase(best);
        return data;
    }

    // False if the block is not wanted.
    bool give(void* data, size_t bytes) {
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        if (!lock || bytes > kMostKept) return false;
        blocks_.push_back({data, bytes});
        total_ += bytes;
        while (total_ > kMostKept) {  // the oldest go first
            std::free(blocks_.front().data);
            total_ -= blocks_.front().bytes;
            blocks_.erase(blocks_.begin());
        }
        return true;
    }

  private:
    struct Block {
        void* data;
        size_t bytes;
    };
    std::mutex mutex_;
    std::vector<Block> blocks_;
    size_t total_ = 0;
};

Kept& kept() {
    static Kept* blocks = new Kept;  // never destroyed: arrays handed to Python may outlive static objects
    return *blocks;
}

}  // namespace

void* allocate(size_t bytes) {
    if (bytes < kLarge) {
        void* data = std::aligned_alloc(64, (bytes + 63) / 64 * 64);
        if (data == nullptr) throw std::bad_alloc();
        return data;
    }
    bytes = (bytes + kLargePage - 1) / kLargePage * kLargePage;
    if (void* data = kept().take(bytes)) return data;
    void* data = std::aligned_alloc(kLargePage, bytes);
    if (data == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    madvise(data, bytes, MADV_HUGEPAGE);
#endif
    return data;
}

void give_back(void* data, size_t bytes) {
    if (data == nullptr) return;
    if (bytes >= kLarge && kept().give(data, (bytes + kLargePage - 1) / kLargePage * kLargePage)) return;
    std::free(data);
}

}  // namespace scoup
