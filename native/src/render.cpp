#include "render.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

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

void check_atoms(int32_t largest, int32_t n_atoms) {
    if (largest >= n_atoms)
        throw std::invalid_argument("a code refers to atom " + std::to_string(largest) + " of " + std::to_string(n_atoms));
}

void check_atoms(const std::vector<CodeMemory>& memory, const GaussianCodes& codes) {
    int32_t largest = -1;
    for (const CodeMemory& own : memory) largest = std::max(largest, own.no_atom());
    check_atoms(largest, codes.n_atoms);
}

std::vector<CodeMemory> code_memory(const GaussianCodes& codes, int32_t n_queries, int n_threads) {
    std::vector<CodeMemory> memory;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) memory.emplace_back(codes, n_queries);
    return memory;
}

}  // namespace

void render_channels(const Projection& projection, const ChannelImage& out, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::channel_kernels, v3::channel_kernels, v4::channel_kernels);
    std::vector<Buffer<float>> scratch;
    for (int worker = 0; worker < std::max(n_threads, 1); ++worker) scratch.emplace_back(out.channels * kPixels);
    for_tiles(projection, out.channels, n_threads, interrupted, [&](const Tile& tile, int64_t, int worker) {
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

void code_scores(int64_t n, const GaussianCodes& codes, const float* table, int32_t columns, float* out, int n_threads,
                 const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::code_kernels, v3::code_kernels, v4::code_kernels);
    const int64_t entries = int64_t(codes.levels) * codes.k, scratch = kScoreRows * entries;
    if (n == 0 || columns == 0 || codes.levels == 0) return;
    if (scratch > std::numeric_limits<int32_t>::max() || codes.levels * codes.index_values() > std::numeric_limits<int32_t>::max())
        throw std::invalid_argument("codes of too many levels or entries");
    if (entries == 0) {
        std::fill_n(out, n * codes.levels * columns, 0.0f);
        return;
    }
    const int64_t padded_level = codes.index_values(), column = codes.levels * padded_level;
    Buffer<float> padded(columns * column);
    padded.fill(0.0f);
    for (int64_t level = 0; level < codes.levels; ++level)
        for (int64_t atom = 0; atom < codes.n_atoms; ++atom)
            for (int64_t c = 0; c < columns; ++c)
                padded[c * column + level * padded_level + atom] = table[(level * codes.n_atoms + atom) * columns + c];

    constexpr int64_t kRows = 16384;
    const int64_t chunks = (n + kRows - 1) / kRows;
    n_threads = int(std::min<int64_t>(n_threads, chunks));
    Buffer<int32_t> base(n_threads * scratch);
    Buffer<float> weights(n_threads * scratch), products(n_threads * scratch);
    std::vector<int32_t> largest(size_t(chunks), -1);
    for_chunks(chunks, n_threads, interrupted, [&](int64_t chunk, int worker) {
        const int64_t own = worker * scratch;
        largest[size_t(chunk)] =
            kernels.scores(codes, {padded.data(), columns, out}, chunk * kRows, std::min(n, (chunk + 1) * kRows),
                           {base.data() + own, weights.data() + own, products.data() + own});
    });
    for (const int32_t of_chunk : largest) check_atoms(of_chunk, codes.n_atoms);
}

ViewCounts count_work(const Projection& projection, int n_threads, const Interrupted& interrupted) {
    const auto& kernels = pick(baseline::count_kernels, v3::count_kernels, v4::count_kernels);
    std::vector<TileCounts> counts(static_cast<size_t>(projection.n_tiles()));
    for_tiles(projection, 1, n_threads, interrupted,
              [&](const Tile& tile, int64_t t, int) { counts[size_t(t)] = kernels.count(tile); });
    ViewCounts total{{}, kernels.lanes};
    for (const TileCounts& c : counts) {
        total.all.pairs += c.pairs;
        total.all.blocks += c.blocks;
        total.all.evaluations += c.evaluations;
    }
    return total;
}

}  // namespace scoup
