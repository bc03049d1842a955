// Non-negative least squares over all atoms of a codebook, by coordinate descent.
//
// Results do not depend on the number of threads: every row is solved by itself.
#pragma once

#include <cstdint>

#include "coder.h"
#include "threads.h"

namespace scoup {

struct Descent {
    int32_t sweeps;   // over all atoms, at most
    float tolerance;  // a row is done once no weight has moved further than this in a sweep
};

// out [R, L]: the weights w >= 0 that least squares gives, from similarities s [R, L] of rows and atoms, and the Gram
// matrix G [L, L] of the atoms. Atoms of norm zero get none.
void wide_weights(Matrix similarities, const float* gram, const Descent& descent, float* out, int n_threads,
                  const Interrupted& interrupted);

}  // namespace scoup
