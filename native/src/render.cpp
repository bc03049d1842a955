#include "render.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "code_sums.h"
#include "projection_tile.h"

namespace scoup {
namespace {

constexpr int64_t kPixels = int64_t(kTile) * kTile;

// Tiles side by side, a few at a time; `body` gets the tile, its number and the worker's.
void for_tiles(const Projection& projection, int64_t channels, int n_threads, const Interrupted& interrupted,
               const std::function<void(const Tile&, int64_t, int)>& body) {
    const int64_t tiles = projection.n_tiles();
    const int64_t at_once = channels > 1024 ? 1 : 8;  // not too much work between two questions about Ctrl-C
    for_chunks((tiles + at_once - 1) / at_once, n_threads, interrupted, [&](int64_t chunk, int worker) {
        for (int64_t t = chunk * at_once; t < std::min((chunk + 1) * at_once, tiles); ++t)
            body(tile_of(projection, t), t, worker);
    });
}

// One worker's scratch for codes, with the memory that it points to.
class CodeMemory {
  public:
    CodeMemory(const GaussianCodes& codes, int32_t n_queries)
        : sums_(codes.block_stride() * kPixels), place_(codes.levels * codes.index_values()),
          n_found_(codes.levels), atoms_(codes.atoms_of_all_levels()),
          products_(n_queries < 0 ? 0 : int64_t(codes.n_atoms) * (codes.n_atoms + n_queries)),
          entries_(16 * int64_t(codes.levels) * codes.k), row_(int64_t(codes.levels) * codes.k), no_atom_(1) {
        place_.fill(-1);
        no_atom_.fill(-1);
    }

    CodeScratch scratch() {
        return {sums_.data(),     place_.data(),   atoms_.data(), n_found_.data(),
                products_.data(), entries_.data(), row_.data(),   no_atom_.data()};
    }
    int32_t no_atom() const { return no_atom_[0]; }

  private:
    Buffer<float> sums_;
    Buffer<int32_t> place_, n_found_;
    Buffer<FoundAtom> atoms_;
    Buffer<float> products_;
    Buffer<CodeEntry> entries_;
    Buffer<float> row_;
    Buffer<int32_t> no_atom_;
};

void check_atoms(const std::vector<CodeMemory>& memory, const GaussianCodes& codes) {
    int32_t largest = -1;
    for (const CodeMemory& own : memory) largest = std::max(largest, own.no_atom());
    scoup::check_atoms(largest, codes.n_atoms);
}

std::vector<CodeMemory> code_memory(const GaussianCodes& codes, int32_t n_queries, int n_threads) {
    std::vector<CodeMemory> memory;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) memory.emplace_back(codes, n_queries);
    return memory;
}

// [N], whether a Gaussian has a value that is not zero.
Buffer<uint8_t> valued(const Projection& projection, const ChannelImage& out) {
    Buffer<uint8_t> found(projection.n_gaussians);
    for (int64_t i = 0; i < projection.n_gaussians; ++i) {
        const float* const values = out.values + i * out.channels;
        found[i] = std::any_of(values, values + out.channels, [](float value) { return value != 0; });
    }
    return found;
}

void fill(const Tile& tile, const ChannelImage& out) {
    const int32_t columns = std::min(kTile, tile.width - tile.x), rows = std::min(kTile, tile.height - tile.y);
    for (int32_t row = 0; row < rows; ++row)
        std::fill_n(out.image + (int64_t(tile.y + row) * tile.width + tile.x) * out.channels, columns * out.channels, 0.0f);
}

}  // namespace

void render_channels(const Projection& projection, const ChannelImage& out, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::channel_kernels, v3::channel_kernels, v4::channel_kernels);
    std::vector<Buffer<float>> scratch;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) scratch.emplace_back(out.channels * kPixels);
    const Buffer<uint8_t> drawn = out.alpha == nullptr ? valued(projection, out) : Buffer<uint8_t>(0);
    const auto is_drawn = [&](uint32_t slot) { return drawn[projection.projected[slot].id] != 0; };
    for_tiles(projection, out.channels, n_threads, interrupted, [&](const Tile& tile, int64_t, int worker) {
        if (out.alpha == nullptr && std::none_of(tile.slots, tile.slots + tile.count, is_drawn)) return fill(tile, out);
        kernels.render(tile, out, scratch[size_t(worker)].data());
    });
}

void render_codes(const Projection& projection, const GaussianCodes& codes, float* out, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::code_kernels, v3::code_kernels, v4::code_kernels);
    auto memory = code_memory(codes, -1, n_threads);
    for_tiles(projection, codes.atoms_of_all_levels(), n_threads, interrupted, [&](const Tile& tile, int64_t, int worker) {
        kernels.render(tile, codes, out, memory[size_t(worker)].scratch());
    });
    check_atoms(memory, codes);
}

void render_cosines(const Projection& projection, const GaussianCodes& codes, const Cosines& cosines, int n_threads,
                    const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::code_kernels, v3::code_kernels, v4::code_kernels);
    auto memory = code_memory(codes, cosines.n_queries, n_threads);
    for_tiles(projection, codes.atoms_of_all_levels(), n_threads, interrupted, [&](const Tile& tile, int64_t, int worker) {
        kernels.cosines(tile, codes, cosines, memory[size_t(worker)].scratch());
    });
    check_atoms(memory, codes);
}

}  // namespace scoup
