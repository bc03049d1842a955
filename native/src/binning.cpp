#include "binning.h"

#include <algorithm>
#include <stdexcept>

#include "project_kernels.h"

namespace scoup {
namespace {

// Whether an ellipse counts as reaching all tiles of the rectangle around it. Inside one row or one column of tiles it
// does. A few tiles more or less are not worth the square roots: the tile loop finds out by itself.
inline bool reaches_all(const TileRect& rect) {
    const int width = rect.x1 - rect.x0, height = rect.y1 - rect.y0;
    return (width < 2) | (height < 2) | (width * height <= kUntestedTiles);
}

// A rectangle no Gaussian has (it ends before it begins) says where its spans are instead.
inline bool has_spans(const TileRect& rect) { return rect.x0 > rect.x1; }
inline TileRect with_spans(uint32_t place) { return {1, 0, uint16_t(place & 0xffff), uint16_t(place >> 16)}; }
inline uint32_t place_of_spans(const TileRect& rect) { return uint32_t(rect.y0) | uint32_t(rect.y1) << 16; }

}  // namespace

void ListLengths::add(const ListLengths& other) {
    for (size_t i = 0; i < steps_.size(); ++i) steps_[i] += other.steps_[i];
}

Buffer<int64_t> ListLengths::starts() const {
    Buffer<int64_t> starts(int64_t(tiles_x_) * tiles_y_ + 1);
    std::vector<uint32_t> row(size_t(tiles_x_), 0);  // counts of the tiles of a row
    int64_t total = 0, tile = 0;
    for (int y = 0; y < tiles_y_; ++y) {
        uint32_t step = 0;
        for (int x = 0; x < tiles_x_; ++x) {
            step += steps_[size_t(y) * size_t(tiles_x_ + 1) + size_t(x)];
            row[size_t(x)] += step;
            starts[tile++] = total;
            total += row[size_t(x)];
        }
    }
    starts[tile] = total;
    return starts;
}

Binning::Binning(int32_t tiles_x, int32_t tiles_y, int64_t n_chunks, int64_t stride, int n_threads)
    : tiles_x_(tiles_x),
      tiles_y_(tiles_y),
      stride_(stride),
      rects_(n_chunks * stride),
      spans_(static_cast<size_t>(n_chunks)),
      lengths_(static_cast<size_t>(std::max(n_threads, 1))) {
    lengths_[0].emplace(tiles_x, tiles_y);
}

void Binning::count(int64_t chunk, int worker, const Projected* projected, int64_t n) {
    auto& counts = lengths_[size_t(worker)];
    if (!counts) counts.emplace(tiles_x_, tiles_y_);
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    std::vector<Span>& spans = spans_[size_t(chunk)];
    TileRect* const own = rects(chunk);
    for (int64_t i = 0; i < n; ++i) {
        const TileRect rect = own[i];
        if (reaches_all(rect)) {
            counts->add(rect.x0, rect.x1, rect.y0, rect.y1);
            continue;
        }
        const size_t place = spans.size();
        own[i] = with_spans(uint32_t(place));
        spans.resize(place + 1 + size_t(rect.y1 - rect.y0));
        Span* rows = spans.data() + place;
        *rows++ = {rect.y0, rect.y1};
        kernels.spans(projected[i], rect, rows);
        for (int row = rect.y0; row < rect.y1; ++row, ++rows) counts->add(rows->first, rows->end, row, row + 1);
    }
}

Buffer<int64_t> Binning::starts() const {
    ListLengths all = *lengths_[0];
    for (size_t worker = 1; worker < lengths_.size(); ++worker)
        if (lengths_[worker]) all.add(*lengths_[worker]);
    return all.starts();
}

const Span* Binning::spans_of(uint32_t slot) const {
    return spans_[slot / size_t(stride_)].data() + place_of_spans(rects_[slot]);
}

// Fills the lists of the tiles in some rows of tiles, unsorted.
class Binning::Band {
  public:
    Band(const Binning& binning, int begin, int end, const Buffer<int64_t>& starts, Buffer<DepthKey>& keys)
        : binning_(binning),
          tiles_x_(binning.tiles_x_),
          begin_(begin),
          end_(end),
          n_tiles_(size_t(end - begin) * size_t(tiles_x_)),
          free_(n_tiles_ + kCorners) {
        const int64_t first = int64_t(begin) * tiles_x_;
        for (size_t tile = 0; tile < n_tiles_; ++tile)
            free_[tile] = {keys.data() + starts[first + int64_t(tile)], keys.data() + starts[first + int64_t(tile) + 1]};
        for (size_t corner = 0; corner < kCorners; ++corner) free_[n_tiles_ + corner] = {&nowhere_, &nowhere_ + 1};
    }
    Band(const Band&) = delete;
    Band& operator=(const Band&) = delete;

    void add(int64_t first, int64_t last, const float* depths) {
        // Copies, which stay in registers: the compiler cannot know that keys are not written over members.
        const Binning& binning = binning_;
        const int tiles_x = tiles_x_, begin = begin_, end = end_;
        Free* const free = free_.data();
        const size_t n_tiles = n_tiles_;
        DepthKey* const nowhere = &nowhere_;
        bool too_long = false;
        // Each corner has a nowhere of its own, so that writes there do not wait for each other.
        const auto write = [&too_long, free, n_tiles, nowhere](size_t corner, bool wanted, size_t tile, DepthKey key) {
            Free& list = free[wanted ? tile : n_tiles + corner];
            DepthKey* const at = list.next;
            const bool fits = at != list.end;
            too_long |= !fits;
            *(fits ? at : nowhere) = key;
            list.next = at + (wanted & fits);
        };
        const auto write_row = [&](int row, int x0, int x1, DepthKey key) {
            const size_t tile = size_t(row - begin) * size_t(tiles_x);
            for (int x = x0; x < x1; ++x) write(0, true, tile + size_t(x), key);
        };
        for (int64_t slot = first; slot < last; ++slot) {
            const TileRect rect = binning.rects_[slot];
            const DepthKey key = depth_key(depths[slot], uint32_t(slot));
            const unsigned more_x = unsigned(rect.x1 - rect.x0) - 1, more_y = unsigned(rect.y1 - rect.y0) - 1;
            if ((more_x | more_y) <= 1) {
                if (rect.y1 <= begin || rect.y0 >= end) continue;
                // Most Gaussians reach 1, 2 or 4 tiles, as chance has it. To write four times, some of them to nowhere,
                // is cheaper than branches that cannot be foreseen.
                const bool upper = rect.y0 >= begin, lower = (more_y != 0) & (rect.y0 + 1 < end), right = more_x != 0;
                const size_t tile = size_t(rect.y0 - begin) * size_t(tiles_x) + rect.x0, below = tile + size_t(tiles_x);
                write(0, upper, tile, key);
                write(1, upper & right, tile + 1, key);
                write(2, lower, below, key);
                write(3, lower & right, below + 1, key);
            } else if (has_spans(rect)) {
                const Span* spans = binning.spans_of(uint32_t(slot));
                const int y0 = spans->first, y1 = spans->end;
                for (int row = std::max(y0, begin); row < std::min(y1, end); ++row)
                    write_row(row, spans[1 + row - y0].first, spans[1 + row - y0].end, key);
            } else {
                for (int row = std::max<int>(rect.y0, begin); row < std::min<int>(rect.y1, end); ++row)
                    write_row(row, rect.x0, rect.x1, key);
            }
        }
        too_long_ |= too_long;
    }

    // Whether every list ended just where it should.
    bool complete() const {
        bool all = !too_long_;
        for (size_t tile = 0; tile < n_tiles_; ++tile) all &= free_[tile].next == free_[tile].end;
        return all;
    }

  private:
    static constexpr size_t kCorners = 4;

    // What is still free of a tile's list.
    struct Free {
        DepthKey* next;
        DepthKey* end;
    };

    const Binning& binning_;
    const int tiles_x_, begin_, end_;
    const size_t n_tiles_;
    std::vector<Free> free_;  // of the tiles, then those of nowhere
    DepthKey nowhere_ = 0;
    bool too_long_ = false;
};

Buffer<uint32_t> Binning::lists(const Buffer<int64_t>& starts, const std::vector<int64_t>& n_found, const float* depths,
                                const Projected* projected, const int64_t* ties, int n_threads,
                                const Interrupted& interrupted) const {
    const int64_t n_tiles = int64_t(tiles_x_) * tiles_y_;
    Buffer<DepthKey> keys(starts[n_tiles]);
    // Each worker has a band of rows of tiles to itself. Bands hold about the same number of pairs.
    const int64_t n_bands = std::clamp<int64_t>(n_threads, 1, tiles_y_);
    std::vector<int> edges(size_t(n_bands + 1), tiles_y_);
    edges[0] = 0;
    for (int64_t band = 1; band < n_bands; ++band) {
        int row = edges[size_t(band - 1)];
        while (row < tiles_y_ && starts[int64_t(row) * tiles_x_] < keys.size() * band / n_bands) ++row;
        edges[size_t(band)] = row;
    }
    for_chunks(n_bands, n_threads, interrupted, [&](int64_t number, int) {
        Band band(*this, edges[size_t(number)], edges[size_t(number + 1)], starts, keys);
        for (size_t chunk = 0; chunk < n_found.size(); ++chunk) {
            const int64_t begin = int64_t(chunk) * stride_, end = begin + n_found[chunk];
            band.add(begin, end, depths);
        }
        if (!band.complete()) throw std::logic_error("the lists of the tiles are not as long as they were counted to be");
    });

    Buffer<uint32_t> lists(keys.size());
    std::vector<DepthSort> sorts(static_cast<size_t>(std::max(n_threads, 1)), DepthSort(projected, ties));
    for_chunks(n_tiles, n_threads, interrupted, [&](int64_t tile, int worker) {
        sorts[size_t(worker)](keys.data() + starts[tile], starts[tile + 1] - starts[tile], lists.data() + starts[tile]);
    });
    return lists;
}

}  // namespace scoup
