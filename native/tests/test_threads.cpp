// Several threads at once in the core, on one view and on their own, and threads for which there is no memory; made to be
// run under a sanitizer for threads.
#include <atomic>
#include <cstdio>

#include "failing_memory.h"
#include "fuzz_coder.h"
#include "fuzz_raster.h"
#include "fuzz_vote.h"

namespace {

constexpr int kCallers = 3;

// What one caller does; the same whoever calls.
std::vector<float> work(const scoup::SceneArrays& arrays, const scoup::Camera& camera, const scoup::Projection& shared) {
    using namespace scoup;
    Random random(7);
    const Preset preset{0.2, 0.99f, 1e-4f, false, true};
    const Projection own = project(arrays.scene(), camera, preset, 2, never);
    std::vector<float> answers;
    for (const Projection* projection : {&own, &shared}) {
        const Exact<float> alpha = channels_of(random, *projection, Exact<float>(), 0, 2).alpha;
        answers.insert(answers.end(), alpha.data(), alpha.data() + alpha.size());
        const Seen seen{*projection, alpha, 2};
        fuzz_channels(random, seen);
        fuzz_regions(random, seen);
        fuzz_codes(random, seen);
    }
    fuzz_vote(random, 2);
    const Exact<float> rows = random_rows(random, 1000, 128, 0), atoms = random_rows(random, 100, 128, 0);
    Codes codes(random, 1000, 4);
    code_rows({rows.data(), 1000, 128}, {atoms.data(), 100, 128}, {4, 1}, nullptr, codes.out(), 2, never);
    answers.insert(answers.end(), codes.weights.data(), codes.weights.data() + codes.weights.size());
    return answers;
}

// Memory runs out at the first, the second, ... allocation of the calling thread: either all is done or it is
// std::bad_alloc, and all threads are at an end.
template <class Work>
void until_memory_suffices(const Work& work) {
    for (int successes = 0;; ++successes) {
        try {
            const scoup::FailingMemory failing(successes);
            work();
            if (scoup::allocations_left > 0) return;
        } catch (const std::bad_alloc&) {
        }
    }
}

void threads_without_memory() {
    constexpr int64_t kChunks = 50;
    until_memory_suffices([] {
        std::atomic<int> running{0}, done{0};
        const auto body = [&](int64_t, int) {
            ++running;
            std::this_thread::sleep_for(std::chrono::microseconds(20));
            ++done;
            --running;
        };
        try {
            scoup::for_chunks(kChunks, 8, scoup::never, body);
            scoup::check(done == kChunks, "threads: chunks are left out where memory is scarce");
        } catch (const std::bad_alloc&) {
            scoup::check(running == 0 && done == 0, "threads: work was begun without its workers");
            throw;
        }
    });
    // Errors of bodies in all threads at once: one of them comes out.
    for (int round = 0; round < 50; ++round) {
        bool thrown = false;
        try {
            scoup::for_chunks(8, 4, scoup::never, [](int64_t chunk, int) { throw std::out_of_range(std::to_string(chunk)); });
        } catch (const std::out_of_range&) {
            thrown = true;
        }
        scoup::check(thrown, "threads: an error got lost");
    }
}

void views_without_memory(const scoup::SceneArrays& arrays, const scoup::Camera& camera) {
    const scoup::Preset preset{0.2, 0.99f, 1e-4f, false, true};
    const scoup::Projection expected = scoup::project(arrays.scene(), camera, preset, 1, scoup::never);
    until_memory_suffices([&] {
        const scoup::Projection projection = scoup::project(arrays.scene(), camera, preset, 3, scoup::never);
        const int left = std::exchange(scoup::allocations_left, -1);  // the comparison may allocate
        scoup::check_same_projection(projection, expected, "project: memory is scarce");
        scoup::allocations_left = left;
    });
}

// Large blocks are given back by destructors where there is no memory.
void blocks_without_memory() {
    std::vector<scoup::Buffer<char>> blocks;
    for (int i = 0; i < 200; ++i) blocks.emplace_back(int64_t(4 + i % 5) << 20);
    const scoup::FailingMemory failing(0);
    while (!blocks.empty()) blocks.pop_back();
    for (int i = 0; i < 200; ++i) const scoup::Buffer<char> again(int64_t(4 + i % 5) << 20);
}

}  // namespace

int main() {
    threads_without_memory();
    blocks_without_memory();
    for (const char* isa : scoup::instruction_sets()) {
        scoup::use_isa(isa);
        scoup::Random random(1);
        const scoup::SceneArrays arrays = scoup::random_scene(random, 20000, 0.001);
        scoup::Camera camera{};
        camera.width = 130, camera.height = 70;
        for (int i = 0; i < 3; ++i) camera.viewmat[5 * i] = 1;
        camera.fx = camera.fy = 100, camera.cx = 65, camera.cy = 35;
        const scoup::Projection shared = scoup::project(arrays.scene(), camera, {0.2, 0.99f, 1e-4f, false, true}, 3, scoup::never);

        views_without_memory(arrays, camera);

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
