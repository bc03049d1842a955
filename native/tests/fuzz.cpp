// Random and hostile arrays through the whole core, on every instruction set: made to be run under sanitizers.
//
//     fuzz [rounds [seed [first round]]]
//
// Rounds do not depend on each other: one that failed is run again by `fuzz 1 SEED ROUND`.
#include <cstdio>

#include "fuzz_code_sums.h"
#include "fuzz_coder.h"
#include "fuzz_neighbours.h"
#include "fuzz_raster.h"
#include "fuzz_selection.h"
#include "fuzz_smoothing.h"
#include "fuzz_vote.h"

namespace {

void run_round(uint64_t seed, long long round, const std::vector<const char*>& sets) {
    scoup::Random random(seed * 0x100000001b3u + uint64_t(round));
    scoup::use_isa(sets[size_t(round) % sets.size()]);
    scoup::fuzz_raster(random);
    for (int i = 0; i < 2; ++i) {
        scoup::fuzz_vote(random, int(random.between(1, 4)));
        scoup::fuzz_damaged_sums(random, int(random.between(1, 4)));
    }
    for (int i = 0; i < 4; ++i) scoup::fuzz_coder(random);
    scoup::fuzz_code_sums(random, int(random.between(1, 4)));
    scoup::fuzz_neighbours(random, int(random.between(1, 4)));
    scoup::fuzz_selection(random, int(random.between(1, 4)));
    scoup::fuzz_mask_parts(random);
    scoup::fuzz_smoothing(random, int(random.between(1, 4)));
}

}  // namespace

int main(int argc, char** argv) {
    const long long rounds = argc > 1 ? std::atoll(argv[1]) : 30;
    const unsigned long long seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
    const long long first = argc > 3 ? std::atoll(argv[3]) : 0;
    const auto sets = scoup::instruction_sets();
    for (long long round = first; round < first + rounds; ++round) {
        // A sanitizer ends the program without a word about the round.
        if ((round - first) % 10 == 0) std::fprintf(stderr, "seed %llu, rounds from %lld\n", seed, round);
        try {
            run_round(seed, round, sets);
        } catch (const std::exception& error) {
            std::printf("seed %llu, round %lld, %s: %s\n", seed, round, scoup::name_of(scoup::current_isa()), error.what());
            return 1;
        }
    }
    std::printf("%lld rounds from seed %llu on %zu instruction sets\n", rounds, seed, sets.size());
}
