// Several threads at once in the core, on one view and on their own; made to be run under a sanitizer for threads.
#include <cstdio>

#include "fuzz_coder.h"
#include "fuzz_raster.h"

namespace {

constexpr int kCallers = 3;

// What one caller does; the same whoever calls.
std::vector<float> work(const scoup::SceneArrays& arrays, const scoup::Camera& camera, const scoup::View& shared) {
    using namespace scoup;
    Random random(7);
    const Preset preset{0.2, 0.99f, 1e-4f, false, true};
    const View own = look(arrays.scene(), camera, preset, 2, never);
    std::vector<float> answers;
    for (const View* view : {&own, &shared}) {
        const Exact<float> alpha = channels_of(random, *view, Exact<float>(), 0, 2).alpha;
        answers.insert(answers.end(), alpha.data(), alpha.data() + alpha.size());
        const Seen seen{*view, alpha, 2};
        fuzz_channels(random, seen);
        fuzz_regions(random, seen);
        fuzz_uplift(random, seen);
        fuzz_codes(random, seen);
    }
    fuzz_vote(random, 2);
    const Exact<float> rows = random_rows(random, 1000, 128, 0), atoms = random_rows(random, 100, 128, 0);
    Codes codes(random, 1000, 4);
    code_rows({rows.data(), 1000, 128}, {atoms.data(), 100, 128}, {4, 1}, nullptr, codes.out(), 2, never);
    answers.insert(answers.end(), codes.weights.data(), codes.weights.data() + codes.weights.size());
    return answers;
}

}  // namespace

int main() {
    for (const char* isa : scoup::instruction_sets()) {
        scoup::use_isa(isa);
        scoup::Random random(1);
        const scoup::SceneArrays arrays = scoup::random_scene(random, 20000, 0.001);
        scoup::Camera camera{};
        camera.width = 130, camera.height = 70;
        for (int i = 0; i < 3; ++i) camera.viewmat[5 * i] = 1;
        camera.fx = camera.fy = 100, camera.cx = 65, camera.cy = 35;
        const scoup::View shared = scoup::look(arrays.scene(), camera, {0.2, 0.99f, 1e-4f, false, true}, 3, scoup::never);

        std::vector<std::vector<float>> answers(kCallers);
        std::vector<std::string> errors(kCallers);
        std::vector<std::thread> callers;
        for (size_t c = 0; c < kCallers; ++c)
            callers.emplace_back([&, c] {
                try {
                    answers[c] = work(arrays, camera, shared);
                } catch (const std::exception& error) {
                    errors[c] = error.what();
                }
            });
        for (auto& caller : callers) caller.join();
        for (size_t c = 0; c < kCallers; ++c) {
            if (errors[c].empty() && answers[c] != answers[0]) errors[c] = "another answer than the first caller's";
            if (errors[c].empty()) continue;
            std::printf("%s, caller %zu: %s\n", isa, c, errors[c].c_str());
            return 1;
        }
    }
    std::printf("%d callers agree on every instruction set\n", kCallers);
}
