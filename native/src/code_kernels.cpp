#include "code_kernels.h"

#include "half.h"
#include "walk.h"

namespace scoup::SCOUP_ISA {
namespace {

// Adds weights times codes to sums for each atom that occurs in the tile. `Index` and `Weight` are the types the codes
// are stored in.
template <class Index, class Weight>
class CodeSink {
  public:
    SCOUP_INLINE CodeSink(const GaussianCodes& codes, const Index* indices, const Weight* weights,
                          const Projected* projected, const CodeScratch& scratch)
        : indices_(indices), weights_(weights), levels_(codes.levels), k_(codes.k), n_atoms_(codes.n_atoms),
          index_values_(codes.index_values()), projected_(projected), scratch_(scratch),
          planes_(reinterpret_cast<Floats*>(scratch.sums)), stride_(codes.block_stride()) {
        for (int level = 0; level < levels_; ++level) scratch.n_found[level] = 0;
    }

    SCOUP_INLINE void begin(const Stage& stage, int count) {
        int entry = 0;
        for (int i = 0; i < count; ++i) {
            first_entry_[i] = entry;
            const int64_t first = row(projected_[stage.slot[i]]);
            const Index* index = indices_ + first;
            const float* weight = from_stored(weights_ + first, levels_ * k_, scratch_.row);
            for (int level = 0; level < levels_; ++level)
                for (int j = 0; j < k_; ++j, ++index, ++weight) {
                    if (*weight == 0) continue;
                    const int32_t at = place(level, *index);
                    if (at >= 0) scratch_.entries[entry++] = {at, *weight};
                }
        }
        first_entry_[count] = entry;
    }

    SCOUP_INLINE void paint(int block, int i, Floats weight) {
        Floats* planes = planes_ + block * stride_;
        for (int e = first_entry_[i]; e < first_entry_[i + 1]; ++e)
            planes[scratch_.entries[e].place] += weight * scratch_.entries[e].weight;
    }

    SCOUP_INLINE void end(const Stage&, int) {}

    SCOUP_INLINE void soon(const Projected& p) const {
        const auto* indices = reinterpret_cast<const char*>(indices_ + row(p));
        const auto* weights = reinterpret_cast<const char*>(weights_ + row(p));
        const int64_t length = int64_t(levels_) * k_;
        __builtin_prefetch(indices);
        __builtin_prefetch(weights);
        __builtin_prefetch(weights + length * int64_t(sizeof(Weight)) - 1);
    }

  private:
    SCOUP_INLINE int64_t row(const Projected& p) const { return int64_t(p.id) * levels_ * k_; }

    // -1 for what is no atom.
    SCOUP_INLINE int32_t place(int level, int atom) {
        int32_t& place = scratch_.place[level * index_values_ + atom];
        if (__builtin_expect(place < 0, 0)) {
            if (atom >= n_atoms_) {
                if (atom > *scratch_.no_atom) *scratch_.no_atom = atom;
                return -1;
            }
            place = n_places_++;
            scratch_.atoms[int64_t(level) * n_atoms_ + scratch_.n_found[level]++] = {atom, place};
            for (int block = 0; block < kBlocks; ++block) planes_[block * stride_ + place] = Floats{};
        }
        return place;
    }

    const Index* indices_;
    const Weight* weights_;
    const int levels_, k_, n_atoms_;
    const int64_t index_values_;
    const Projected* projected_;
    const CodeScratch& scratch_;
    Floats* planes_;  // [blocks, places]: what is added to in one block lies together
    int64_t stride_;
    int32_t n_places_ = 0;
    int first_entry_[kStage + 1];
};

// The sums of a walked tile, by the atoms that occur.
class TileCodes {
  public:
    SCOUP_INLINE TileCodes(const Tile& tile, const GaussianCodes& codes, const CodeScratch& scratch)
        : n_atoms_(codes.n_atoms), levels_(codes.levels), index_values_(codes.index_values()),
          stride_(codes.block_stride()), scratch_(scratch) {
        if (codes.indices8 != nullptr)
            codes.weights != nullptr ? walk(tile, codes, codes.indices8, codes.weights)
                                     : walk(tile, codes, codes.indices8, codes.half_weights);
        else
            codes.weights != nullptr ? walk(tile, codes, codes.indices16, codes.weights)
                                     : walk(tile, codes, codes.indices16, codes.half_weights);
    }
    // Leaves the scratch as it was; to be called at the end. (A destructor would bring in code shared with other files.)
    SCOUP_INLINE void clear() const {
        for (int level = 0; level < levels_; ++level)
            for (int a = 0; a < count(level); ++a) scratch_.place[level * index_values_ + atom(level, a)] = -1;
    }

    SCOUP_INLINE int count(int level) const { return scratch_.n_found[level]; }
    SCOUP_INLINE int atom(int level, int a) const { return scratch_.atoms[int64_t(level) * n_atoms_ + a].atom; }
    // Sums of atom number a of those that occur, in one block.
    SCOUP_INLINE const Floats& sums(int level, int a, int block) const {
        return *(reinterpret_cast<const Floats*>(scratch_.sums) + block * stride_ +
                 scratch_.atoms[int64_t(level) * n_atoms_ + a].place);
    }

  private:
    template <class Index, class Weight>
    void walk(const Tile& tile, const GaussianCodes& codes, const Index* indices, const Weight* weights) {
        CodeSink<Index, Weight> sink(codes, indices, weights, tile.projected, scratch_);
        walk_blocks(tile, sink);
    }

    int n_atoms_, levels_;
    int64_t index_values_, stride_;
    const CodeScratch& scratch_;
};

void render(const Tile& tile, const GaussianCodes& codes, float* out, const CodeScratch& scratch) {
    const TileCodes found(tile, codes, scratch);
    for (int level = 0; level < codes.levels; ++level)
        for (int block = 0; block < kBlocks; ++block)
            for (int lane = 0; lane < kLanes; ++lane) {
                const int x = tile.x + block_x(block) + lane_x(lane), y = tile.y + block_y(block) + lane_y(lane);
                if (x >= tile.width || y >= tile.height) continue;
                float* pixel = out + ((int64_t(level) * tile.height + y) * tile.width + x) * codes.n_atoms;
                for (int a = 0; a < codes.n_atoms; ++a) pixel[a] = 0;
                for (int a = 0; a < found.count(level); ++a) pixel[found.atom(level, a)] = found.sums(level, a, block)[lane];
            }
    found.clear();
}

// The cosines of one level: cos = (W A) / sqrt(W G W^T), over the atoms that occur.
class CosineLevel {
  public:
    SCOUP_INLINE CosineLevel(const TileCodes& found, const GaussianCodes& codes, const Cosines& cosines, int level,
                             const CodeScratch& scratch)
        : found_(found), level_(level), count_(found.count(level)), n_queries_(cosines.n_queries),
          grams_(scratch.products), scores_(scratch.products + int64_t(count_) * count_) {
        const int64_t first = int64_t(level) * codes.n_atoms;
        for (int a = 0; a < count_; ++a) {
            const float* gram = cosines.grams + (first + found.atom(level, a)) * codes.n_atoms;
            for (int b = 0; b < a; ++b) grams_[int64_t(a) * count_ + b] = gram[found.atom(level, b)];
            grams_[int64_t(a) * count_ + a] = 0.5f * gram[found.atom(level, a)];
            for (int b = a + 1; b < count_ && b < a / kTogether * kTogether + kTogether; ++b)
                grams_[int64_t(a) * count_ + b] = 0;
            const float* score = cosines.scores + (first + found.atom(level, a)) * n_queries_;
            for (int q = 0; q < n_queries_; ++q) scores_[int64_t(a) * n_queries_ + q] = score[q];
        }
    }

    // Norms of a row of blocks and their inverses; zero where nothing is painted.
    SCOUP_INLINE void norms(int first_block, Floats norm[kColumns], Floats inverse[kColumns]) const {
        Floats half[kColumns] = {};  // of the squared norm: the Gram matrix is symmetric, one triangle will do
        int a = 0;
        for (; a + kTogether <= count_; a += kTogether) add_rows<kTogether>(a, first_block, half);
        for (; a < count_; ++a) add_rows<1>(a, first_block, half);
        for (int c = 0; c < kColumns; ++c) {
            norm[c] = half[c] > 0.0f ? sqrt(half[c] * 2.0f) : Floats{};
            inverse[c] = half[c] > 0.0f ? 1.0f / norm[c] : Floats{};
        }
    }

    SCOUP_INLINE void dot(int first_block, int query, Floats total[kColumns]) const {
        for (int c = 0; c < kColumns; ++c) total[c] = Floats{};
        for (int a = 0; a < count_; ++a) {
            for (int c = 0; c < kColumns; ++c)
                total[c] += found_.sums(level_, a, first_block + c) * scores_[int64_t(a) * n_queries_ + query];
        }
    }

  private:
    // Rows of the Gram matrix that go through the sums together: as many as there are registers for.
    static constexpr int kTogether = kLanes == 16 ? 4 : 2;

    template <int Rows>
    SCOUP_INLINE void add_rows(int first_row, int first_block, Floats half[kColumns]) const {
        Floats product[Rows][kColumns] = {};
        const float* gram = grams_ + int64_t(first_row) * count_;
        for (int b = 0; b < first_row + Rows; ++b) {
            for (int c = 0; c < kColumns; ++c) {
                const Floats sum = found_.sums(level_, b, first_block + c);
                for (int r = 0; r < Rows; ++r) product[r][c] += sum * gram[int64_t(r) * count_ + b];
            }
        }
        for (int r = 0; r < Rows; ++r)
            for (int c = 0; c < kColumns; ++c) half[c] += found_.sums(level_, first_row + r, first_block + c) * product[r][c];
    }

    const TileCodes& found_;
    int level_, count_, n_queries_;
    float* grams_;   // [count, count], lower triangle, the diagonal halved; zeros beyond it where rows go together
    float* scores_;  // [count, queries]
};

// Writes the pixels of a row of blocks that lie inside the image.
SCOUP_INLINE void store_row(const Tile& tile, int row, const Floats values[kColumns], float* plane) {
    for (int line = 0; line < kBlockHeight; ++line) {
        const int y = tile.y + row * kBlockHeight + line;
        if (y >= tile.height) return;
        float pixels[kTile];
        for (int column = 0; column < kColumns; ++column)
            for (int i = 0; i < kBlockWidth; ++i)
                pixels[column * kBlockWidth + i] = values[column][line * kBlockWidth + i];
        float* out = plane + int64_t(y) * tile.width + tile.x;
        const int inside = smaller(kTile, tile.width - tile.x);
        for (int i = 0; i < inside; ++i) out[i] = pixels[i];
    }
}

void cosines(const Tile& tile, const GaussianCodes& codes, const Cosines& cosines, const CodeScratch& scratch) {
    const TileCodes found(tile, codes, scratch);
    const int64_t plane = int64_t(tile.width) * tile.height;
    for (int level = 0; level < codes.levels; ++level) {
        const CosineLevel of_level(found, codes, cosines, level, scratch);
        for (int row = 0; row < kRows; ++row) {
            Floats norm[kColumns], inverse[kColumns];
            of_level.norms(row * kColumns, norm, inverse);
            if (cosines.norms != nullptr) store_row(tile, row, norm, cosines.norms + level * plane);
            for (int query = 0; query < cosines.n_queries; ++query) {
                Floats values[kColumns];
                of_level.dot(row * kColumns, query, values);
                for (int c = 0; c < kColumns; ++c) values[c] *= inverse[c];
                store_row(tile, row, values, cosines.out + (int64_t(level) * cosines.n_queries + query) * plane);
            }
        }
    }
    found.clear();
}

}  // namespace

const CodeKernels code_kernels = {render, cosines};

}  // namespace scoup::SCOUP_ISA
