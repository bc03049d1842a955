#include "combinations.h"

#include <algorithm>

namespace scoup {
namespace {

constexpr int64_t kPixelsAtOnce = int64_t(1) << 16;

// Numbers rows of labels in the order in which they are first met.
class Numbering {
  public:
    explicit Numbering(int32_t levels) : levels_(levels), slots_(512, -1) {}

    int32_t number(const int32_t* row) {
        if (2 * size_t(count_ + 1) > slots_.size()) grow();
        size_t slot = place(row);
        for (; slots_[slot] >= 0; slot = (slot + 1) % slots_.size())
            if (std::equal(row, row + levels_, rows_.begin() + int64_t(slots_[slot]) * levels_)) return slots_[slot];
        slots_[slot] = count_;
        rows_.insert(rows_.end(), row, row + levels_);
        return count_++;
    }

    int32_t count() const { return count_; }
    const int32_t* row(int32_t number) const { return rows_.data() + int64_t(number) * levels_; }
    std::vector<int32_t> take_rows() { return std::move(rows_); }

  private:
    size_t place(const int32_t* row) const {
        uint64_t hash = 0;
        for (int32_t level = 0; level < levels_; ++level) hash = (hash ^ uint32_t(row[level])) * 0x9e3779b97f4a7c15u;
        return size_t(hash >> 32) % slots_.size();
    }

    void grow() {
        std::vector<int32_t> larger(2 * slots_.size(), -1);
        slots_.swap(larger);
        for (int32_t number = 0; number < count_; ++number) {
            size_t slot = place(row(number));
            while (slots_[slot] >= 0) slot = (slot + 1) % slots_.size();
            slots_[slot] = number;
        }
    }

    int32_t levels_, count_ = 0;
    std::vector<int32_t> rows_, slots_;
};

// Combinations of some of the pixels, by numbers of their own.
Numbering number_pixels(const int32_t* labels, int32_t levels, int64_t pixels, int64_t first, int64_t last, int32_t* map) {
    constexpr int64_t kAtOnce = 1024;
    Numbering numbering(levels);
    std::vector<int32_t> row(size_t(levels), -1);
    int32_t number = -1;
    for (int64_t start = first; start < last; start += kAtOnce) {
        const int64_t count = std::min(kAtOnce, last - start);
        uint8_t differs[kAtOnce] = {start == first};  // from the pixel before; most pixels do not
        for (int32_t level = 0; level < levels; ++level) {
            const int32_t* here = labels + level * pixels + start;
            for (int64_t i = start == first; i < count; ++i) differs[i] |= here[i] != here[i - 1];
        }
        for (int64_t i = 0; i < count; ++i) {
            if (differs[i] != 0) {
                bool any = false;
                for (int32_t level = 0; level < levels; ++level) {
                    row[size_t(level)] = std::max(labels[level * pixels + start + i], -1);
                    any |= row[size_t(level)] >= 0;
                }
                number = any ? numbering.number(row.data()) : -1;
            }
            map[start + i] = number;
        }
    }
    return numbering;
}

}  // namespace

Combinations combine(const int32_t* labels, int32_t levels, int64_t pixels, int n_threads, const Interrupted& interrupted) {
    const int64_t n_chunks = (pixels + kPixelsAtOnce - 1) / kPixelsAtOnce;
    Combinations all;
    all.map = Buffer<int32_t>(pixels);
    std::vector<Numbering> parts(static_cast<size_t>(n_chunks), Numbering(levels));
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int) {
        const int64_t first = chunk * kPixelsAtOnce, last = std::min(first + kPixelsAtOnce, pixels);
        parts[size_t(chunk)] = number_pixels(labels, levels, pixels, first, last, all.map.data());
    });
    Numbering whole(levels);
    std::vector<std::vector<int32_t>> renumbered(static_cast<size_t>(n_chunks));
    for (int64_t chunk = 0; chunk < n_chunks; ++chunk) {
        const Numbering& part = parts[size_t(chunk)];
        for (int32_t number = 0; number < part.count(); ++number) renumbered[size_t(chunk)].push_back(whole.number(part.row(number)));
    }
    for_chunks(n_chunks, n_threads, interrupted, [&](int64_t chunk, int) {
        const std::vector<int32_t>& numbers = renumbered[size_t(chunk)];
        for (int64_t pixel = chunk * kPixelsAtOnce; pixel < std::min((chunk + 1) * kPixelsAtOnce, pixels); ++pixel)
            if (all.map[pixel] >= 0) all.map[pixel] = numbers[size_t(all.map[pixel])];
    });
    all.count = whole.count();
    all.table = whole.take_rows();
    return all;
}

}  // namespace scoup
