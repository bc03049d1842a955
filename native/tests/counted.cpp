// A fixed piece of work for each kernel, to count its instructions (tools/count_instructions.py).
//
//     counted compiler           the compiler that this was built with
//     counted MODE REPETITIONS   the work of a mode, so many times on top of what prepares it
//     counted                    every mode once
//
// One thread, and the instruction set v3 where there is one: tools that count know no AVX-512.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <numeric>
#include <vector>

#include "code_sums.h"
#include "combinations.h"
#include "region_sums.h"
#include "render.h"
#include "projection.h"
#include "selection.h"
#include "vote.h"

namespace {

constexpr int kWidth = 160, kHeight = 120, kGaussians = 6000;
constexpr int kLevels = 3, kAtoms = 64, kSlots = 4, kQueries = 4, kRegions = 40;
constexpr int64_t kPixels = int64_t(kWidth) * kHeight;
const scoup::Interrupted kNever;

// The same numbers with every compiler and library: a linear congruential generator.
class Numbers {
  public:
    double uniform(double low, double high) {
        state_ = state_ * 6364136223846793005u + 1442695040888963407u;
        return low + (high - low) * double(state_ >> 11) * 0x1p-53;
    }
    int below(int n) { return int(uniform(0, n)); }

  private:
    uint64_t state_ = 1;
};

// A cloud in front of the camera, of sizes and opacities as in trained scenes.
struct Work {
    std::vector<float> means, quats, scales, opacities;
    scoup::Buffer<scoup::SceneBlock> blocks;
    scoup::Buffer<scoup::ChunkBounds> bounds;
    scoup::Camera camera{};
    scoup::Preset preset{0.2, 0.99f, 1e-4f, false, true};
    std::vector<float> colours, code_weights, region_code_weights, grams, scores;
    std::vector<uint8_t> code_indices, region_code_indices;
    std::vector<int32_t> labels;

    Work() {
        Numbers numbers;
        const auto fill = [&](auto& values, int64_t count, double low, double high) {
            values.resize(size_t(count));
            for (auto& value : values) value = typename std::decay_t<decltype(values)>::value_type(numbers.uniform(low, high));
        };
        for (int i = 0; i < kGaussians; ++i) {
            const double depth = numbers.uniform(1, 8);
            for (const double edge : {0.75, 0.56}) means.push_back(float(depth * numbers.uniform(-edge, edge)));
            means.push_back(float(depth));
            for (int c = 0; c < 3; ++c) scales.push_back(float(0.08 * std::exp2(numbers.uniform(-4, 0))));
            opacities.push_back(float(numbers.uniform(0.05, 1)));
        }
        fill(quats, 4 * kGaussians, -1, 1);
        blocks = scoup::blocks_of(unprepared(), 1, kNever);
        bounds = scoup::bounds_of(unprepared(), 1, kNever);
        for (int i = 0; i < 3; ++i) camera.viewmat[5 * i] = 1;
        camera.fx = camera.fy = kWidth / 1.5;
        camera.cx = kWidth / 2.0, camera.cy = kHeight / 2.0;
        camera.width = kWidth, camera.height = kHeight;
        fill(colours, 3 * kGaussians, 0, 1);
        fill(code_weights, kGaussians * kLevels * kSlots, 0, 1);
        fill(code_indices, kGaussians * kLevels * kSlots, 0, kAtoms);
        fill(region_code_weights, kRegions * kSlots, 0, 1);
        fill(region_code_indices, kRegions * kSlots, 0, kAtoms);
        fill(grams, kLevels * kAtoms * kAtoms, 0, 1);
        fill(scores, kLevels * kAtoms * kQueries, -1, 1);
        // Patches of regions, smaller from level to level.
        for (int level = 0; level < kLevels; ++level)
            for (int y = 0; y < kHeight; ++y)
                for (int x = 0; x < kWidth; ++x) {
                    const int patch = 60 >> level;
                    labels.push_back((x / patch * 7 + y / patch) % kRegions - (x % 50 == 0 ? kRegions : 0));
                }
    }

    scoup::Projection project() const {
        scoup::Scene scene = unprepared();
        scene.blocks = blocks.data();
        scene.bounds = bounds.data();
        return scoup::project(scene, camera, preset, 1, kNever);
    }

    scoup::Scene unprepared() const {
        return {kGaussians, means.data(), quats.data(), scales.data(), opacities.data(), nullptr};
    }
};

void channels(const Work& work, const scoup::Projection& projection, int32_t count) {
    std::vector<float> image(size_t(kPixels * count)), alpha(size_t(kPixels), 0.0f);
    scoup::render_channels(projection, {work.colours.data(), count, image.data(), alpha.data()}, 1, kNever);
}

scoup::GaussianCodes codes_of(const Work& work) {
    return {work.code_indices.data(), nullptr, work.code_weights.data(), nullptr, kLevels, kSlots, kAtoms};
}

scoup::Combinations combined(const Work& work) { return scoup::combine(work.labels.data(), kLevels, kPixels, 1, kNever); }

scoup::RegionSums sums_of(const Work& work, const scoup::Projection& projection) {
    const scoup::Combinations all = combined(work);
    return scoup::region_sums(projection, {all.map.data(), kWidth, kHeight}, 1, kNever);
}

// Two rounds over the sums of one view, as often as a scene has views.
void vote(const Work& work, const scoup::Projection& projection) {
    constexpr int kViews = 20;
    static const scoup::RegionSums sums = sums_of(work, projection);
    static const scoup::Combinations all = combined(work);
    const int64_t count = sums.weight.size(), buckets = (kGaussians + scoup::kVoteBucket - 1) / scoup::kVoteBucket;
    std::vector<uint32_t> starts(size_t(buckets + 1), 0), named(static_cast<size_t>(buckets));
    std::iota(named.begin(), named.end(), 0u);
    std::vector<uint8_t> places;
    std::vector<uint16_t> combinations;
    for (int64_t i = 0; i < count; ++i) {
        ++starts[size_t((sums.gaussian[i] >> scoup::kVoteBits) + 1)];
        places.push_back(uint8_t(sums.gaussian[i]));
        combinations.push_back(uint16_t(sums.combination[i]));
    }
    for (size_t b = 0; b < size_t(buckets); ++b) starts[b + 1] += starts[b];
    const std::vector<int64_t> regions(all.table.begin(), all.table.end());
    const scoup::ViewSums of_view{named.data(), starts.data(), places.data(), combinations.data(), sums.weight.data(),
                                  nullptr,      buckets,       count,         regions.data(),      all.count};
    const scoup::RegionCodes codes{work.region_code_indices.data(), nullptr, work.region_code_weights.data(), kRegions, kSlots};
    const std::vector<scoup::RegionCodes> levels(kLevels, codes);
    const scoup::Vote task(kGaussians, kAtoms, std::vector<scoup::ViewSums>(kViews, of_view), levels, work.grams.data());
    std::vector<uint8_t> indices(size_t(kGaussians) * kLevels * kSlots), again(indices.size());
    std::vector<float> weights(indices.size()), others(indices.size());
    const float sharpness[kLevels] = {5, 5, 5};
    task.round({indices.data(), nullptr, weights.data(), kSlots}, nullptr, true, 0, buckets, 1, kNever);
    const scoup::EarlierCodes earlier{indices.data(), nullptr, weights.data(), kSlots, sharpness};
    task.round({again.data(), nullptr, others.data(), kSlots}, &earlier, false, 0, buckets, 1, kNever);
}

void codes(const Work& work, const scoup::Projection& projection) {
    std::vector<float> out(size_t(kPixels) * kLevels * kAtoms);
    scoup::render_codes(projection, codes_of(work), out.data(), 1, kNever);
}

void cosines(const Work& work, const scoup::Projection& projection) {
    std::vector<float> out(size_t(kPixels) * kLevels * kQueries);
    scoup::render_cosines(projection, codes_of(work), {work.grams.data(), work.scores.data(), kQueries, out.data(), nullptr}, 1, kNever);
}

// Norms, the best of some phrases, and the relevancy of as many texts.
std::vector<float> relevancy(const Work& work) {
    const scoup::GaussianCodes codes = codes_of(work);
    const scoup::AtomScores scores{work.scores.data(), kQueries};
    std::vector<float> norms(size_t(kGaussians * kLevels)), best(norms.size()), out(norms.size() * kQueries);
    scoup::inverse_code_norms(kGaussians, codes, work.grams.data(), norms.data(), 1, kNever);
    scoup::best_code_cosines(kGaussians, codes, scores, norms.data(), best.data(), 1, kNever);
    scoup::code_relevancy(kGaussians, codes, scores, {norms.data(), best.data(), 10.0f}, out.data(), 1, kNever);
    return out;
}

// Of the relevancy above, made beforehand.
void select(const Work& work) {
    static const std::vector<float> values = relevancy(work);
    const scoup::ValueRows rows{values.data(), nullptr, kLevels * kQueries, kGaussians};
    std::vector<float> spans(size_t(2 * rows.count));
    std::vector<int64_t> bins(size_t(rows.count) * scoup::kBins);
    std::vector<uint8_t> masks(values.size());
    std::vector<scoup::SumAbove> found(size_t(rows.count));
    const std::vector<float> thresholds(size_t(rows.count), 0.6f);
    scoup::count_stretched(rows, 0.695f, spans.data(), bins.data(), 1, kNever);
    scoup::above_thresholds(rows, spans.data(), thresholds.data(), masks.data(), found.data(), 1, kNever);
}

struct Mode {
    const char* name;
    void (*run)(const Work& work, const scoup::Projection& projection);
};
constexpr Mode kModes[] = {
    {"project", [](const Work& work, const scoup::Projection&) { work.project(); }},
    {"alpha", [](const Work& work, const scoup::Projection& projection) { channels(work, projection, 0); }},
    {"channels", [](const Work& work, const scoup::Projection& projection) { channels(work, projection, 3); }},
    {"regions", [](const Work& work, const scoup::Projection& projection) { sums_of(work, projection); }},
    {"vote", vote},
    {"codes", codes},
    {"cosines", cosines},
    {"relevancy", [](const Work& work, const scoup::Projection&) { relevancy(work); }},
    {"select", [](const Work& work, const scoup::Projection&) { select(work); }},
};

}  // namespace

int main(int argc, char** argv) {
    if (argc == 2 && std::strcmp(argv[1], "compiler") == 0) {
#if defined(__clang__)
        std::printf("clang %s\n", __clang_version__);
#else
        std::printf("gcc %s\n", __VERSION__);
#endif
        return 0;
    }
    if (!scoup::use_isa("v3")) scoup::use_isa("baseline");
    const Work work;
    const scoup::Projection projection = work.project();
    const int repetitions = argc > 2 ? std::atoi(argv[2]) : 1;
    bool found = argc < 2;
    for (const Mode& mode : kModes) {
        if (argc >= 2 && std::strcmp(argv[1], mode.name) != 0) continue;
        found = true;
        for (int i = 0; i < repetitions; ++i) mode.run(work, projection);
    }
    if (!found) {
        std::printf("unknown mode; there are:");
        for (const Mode& mode : kModes) std::printf(" %s", mode.name);
        std::printf("\n");
        return 2;
    }
    std::printf("%s: %lld pairs\n", scoup::name_of(scoup::current_isa()), static_cast<long long>(projection.lists.size()));
}
