// Whole images from a view. All images are written completely; a pixel nothing paints is zero.
#pragma once

#include "channel_kernels.h"
#include "code_kernels.h"
#include "threads.h"
#include "projection.h"

namespace scoup {

// Without alpha, tiles whose Gaussians have no value but zero are filled, not drawn.
void render_channels(const Projection& projection, const ChannelImage& out, int n_threads, const Interrupted& interrupted);

// Those that read codes throw std::invalid_argument if one that matters refers to an atom there is not.

// out [levels, height, width, n_atoms]
void render_codes(const Projection& projection, const GaussianCodes& codes, float* out, int n_threads, const Interrupted& interrupted);

void render_cosines(const Projection& projection, const GaussianCodes& codes, const Cosines& cosines, int n_threads,
                    const Interrupted& interrupted);

}  // namespace scoup
