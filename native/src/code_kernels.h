// Rendering of sparse codes in one tile: coefficient maps, or cosines with the coefficients used up on the spot.
#pragma once

#include <cstdint>

#include "isa.h"
#include "tile.h"

namespace scoup {

// Sparse codes of Gaussians, [N, levels, k]. One of the two forms of indices and of weights is null.
struct GaussianCodes {
    const uint8_t* indices8;
    const uint16_t* indices16;
    const float* weights;
    const uint16_t* half_weights;  // bits of float16
    int32_t levels, k, n_atoms;

    int64_t atoms_of_all_levels() const { return int64_t(levels) * n_atoms; }

    // Values that an index may have, more than there are atoms. Tables are that long for each level, so that no index
    // leads out of them; what is no atom is found when it is first met. Arrays of Python's need no check before, which
    // would read all of them for every render, and may change meanwhile.
    int64_t index_values() const { return indices8 != nullptr ? 256 : 65536; }

    // Vectors of sums from one block of a tile to the next: not a multiple of a large power of two, or the sums of all
    // blocks would fall into the same few sets of the first-level cache.
    int64_t block_stride() const { return atoms_of_all_levels() + (37 - atoms_of_all_levels() % 64 + 64) % 64; }
};

struct FoundAtom {
    int32_t atom, place;
};

struct CodeEntry {
    int32_t place;
    float weight;
};

// Scratch of one worker. Only atoms that occur in a tile get sums.
struct CodeScratch {
    float* sums;       // [256 * block_stride()], on a 64 byte boundary
    int32_t* place;    // [levels, index_values()]: of an atom's sums, -1 for none; all -1 between tiles
    FoundAtom* atoms;  // [levels, n_atoms]: the atoms that occur at each level ...
    int32_t* n_found;  // [levels]: ... and how many
    float* products;   // [n_atoms, n_atoms + n_queries]: Gram rows and scores of the atoms that occur
    CodeEntry* entries;  // [16, levels * k]: of the Gaussians at work
    float* row;        // [levels * k]: weights of one Gaussian
    int32_t* no_atom;  // [1]: the largest index met that is no atom; left alone if there is none
};

struct Cosines {
    const float* grams;   // [levels, n_atoms, n_atoms], G = C C^T
    const float* scores;  // [levels, n_atoms, n_queries], A = C T^T
    int32_t n_queries;
    float* out;           // [levels, n_queries, height, width]
    float* norms;         // [levels, height, width], sqrt(W G W^T); or null
};

struct CodeKernels {
    // out [levels, height, width, n_atoms]
    void (*render)(const Tile& tile, const GaussianCodes& codes, float* out, const CodeScratch& scratch);
    void (*cosines)(const Tile& tile, const GaussianCodes& codes, const Cosines& cosines, const CodeScratch& scratch);
};

SCOUP_KERNEL_TABLE(CodeKernels, code_kernels)

}  // namespace scoup
