// Random and hostile arrays through the whole core, on every instruction set: made to be run under sanitizers.
//
//     fuzz [rounds [seed [first round]]]
//
// Rounds do not depend on each other: one that failed is run again by `fuzz 1 SEED ROUND`. With SCOUP_FUZZING_ENGINE
// it is a target of libFuzzer instead, whose inputs are the random numbers of a part of a round (tools/oss_fuzz/).
#include <cstdio>
#include <iterator>

#include "fuzz_code_sums.h"
#include "fuzz_coder.h"
#include "fuzz_neighbours.h"
#include "fuzz_raster.h"
#include "fuzz_selection.h"
#include "fuzz_vote.h"

namespace {

// One of these with the random numbers that it takes, and how often a round does it.
struct Part {
    void (*run)(scoup::Random&);
    int times;
};

template <void (*Run)(scoup::Random&, int)>
void with_threads(scoup::Random& random) {
    Run(random, int(random.between(1, 4)));
}

const Part kParts[] = {
    {scoup::fuzz_raster, 1},
    {with_threads<scoup::fuzz_vote>, 2},
    {with_threads<scoup::fuzz_damaged_sums>, 2},
    {scoup::fuzz_coder, 4},
    {with_threads<scoup::fuzz_code_sums>, 1},
    {with_threads<scoup::fuzz_neighbours>, 1},
    {with_threads<scoup::fuzz_selection>, 1},
};

}  // namespace

#if defined(SCOUP_FUZZING_ENGINE)
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
    static const auto sets = scoup::instruction_sets();
    scoup::Random random(data, size);
    scoup::use_isa(sets[size_t(random.below(int64_t(sets.size())))]);
    kParts[random.below(int64_t(std::size(kParts)))].run(random);
    return 0;
}
#else
int main(int argc, char** argv) {
    const long long rounds = argc > 1 ? std::atoll(argv[1]) : 30;
    const unsigned long long seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
    const long long first = argc > 3 ? std::atoll(argv[3]) : 0;
    const auto sets = scoup::instruction_sets();
    for (long long round = first; round < first + rounds; ++round) {
        // A sanitizer ends the program without a word about the round.
        if ((round - first) % 10 == 0) std::fprintf(stderr, "seed %llu, rounds from %lld\n", seed, round);
        try {
            scoup::Random random(seed * 0x100000001b3u + uint64_t(round));
            scoup::use_isa(sets[size_t(round) % sets.size()]);
            for (const Part& part : kParts)
                for (int i = 0; i < part.times; ++i) part.run(random);
        } catch (const std::exception& error) {
            std::printf("seed %llu, round %lld, %s: %s\n", seed, round, scoup::name_of(scoup::current_isa()), error.what());
            return 1;
        }
    }
    std::printf("%lld rounds from seed %llu on %zu instruction sets\n", rounds, seed, sets.size());
}
#endif
