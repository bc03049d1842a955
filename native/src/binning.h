// Which Gaussian may paint in which tile: the tiles' lists, counted first, then filled.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "buffer.h"
#include "depth_sort.h"
#include "projected.h"
#include "threads.h"

namespace scoup {

constexpr int kUntestedTiles = 4;

// How many Gaussians reach each tile. Kept as differences along both axes: a rectangle of tiles is four numbers,
// whatever its size.
class ListLengths {
  public:
    ListLengths(int32_t tiles_x, int32_t tiles_y)
        : tiles_x_(tiles_x), tiles_y_(tiles_y), steps_(size_t(tiles_x + 1) * size_t(tiles_y + 1), 0) {}

    void add(int x0, int x1, int y0, int y1) {
        uint32_t* top = steps_.data() + size_t(y0) * size_t(tiles_x_ + 1);
        uint32_t* below = steps_.data() + size_t(y1) * size_t(tiles_x_ + 1);
        ++top[x0], --top[x1], --below[x0], ++below[x1];
    }
    void add(const ListLengths& other);  // of the same image

    // [tiles + 1], where each tile's list begins if they lie one after the other.
    Buffer<int64_t> starts() const;

  private:
    int32_t tiles_x_, tiles_y_;
    std::vector<uint32_t> steps_;  // they wrap around; no tile has 2^32 Gaussians
};

// The tiles of a view and the Gaussians that reach them. Slots of chunk c begin at c * stride.
class Binning {
  public:
    Binning(int32_t tiles_x, int32_t tiles_y, int64_t n_chunks, int64_t stride, int n_threads);

    // Where the rectangles of a chunk's slots are to be written.
    TileRect* rects(int64_t chunk) { return rects_.data() + chunk * stride_; }

    // Counts the tiles that the first `n` slots of a chunk reach. To be called once for every chunk.
    void count(int64_t chunk, int worker, const Projected* projected, int64_t n);

    // [tiles + 1], where each tile's list begins.
    Buffer<int64_t> starts() const;

    // The tiles' lists: slots by rising depth. `n_found` slots of each chunk are used, `depths` and `projected` are by slot;
    // `ties` as in DepthSort. Throws std::logic_error if a list does not end where `starts` says; nothing is written
    // beyond it.
    Buffer<uint32_t> lists(const Buffer<int64_t>& starts, const std::vector<int64_t>& n_found, const float* depths,
                           const Projected* projected, const int64_t* ties, int n_threads,
                           const Interrupted& interrupted) const;

  private:
    class Band;

    const Span* spans_of(uint32_t slot) const;

    int32_t tiles_x_, tiles_y_;
    int64_t stride_;
    Buffer<TileRect> rects_;
    // Of the Gaussians that do not reach all tiles of their rectangle, chunk by chunk: the range of rows, then that of each
    // row. Their rectangles tell where that is. Kept, not worked out again to fill: count and lists must agree.
    std::vector<std::vector<Span>> spans_;
    std::vector<std::optional<ListLengths>> lengths_;  // of the workers
};

}  // namespace scoup
