// Rounds over the rasteriser. What one function says is checked against what another says of the same view.
#pragma once

#include <algorithm>

#include "binning.h"
#include "fuzz_scene.h"
#include "combinations.h"
#include "region_sums.h"
#include "render.h"
#include "projection.h"

namespace scoup {

// One view, how it was made, and what a round needs to ask it.
struct Seen {
    const Projection& projection;
    const Exact<float>& alpha;
    int threads;

    int64_t pixels() const { return int64_t(projection.width) * projection.height; }
};

inline void check_view(const Projection& projection, const SceneArrays& scene) {
    const int64_t count = scene.count();
    check(projection.n_visible >= 0 && projection.n_visible <= count, "project: more are visible than there are");
    check(projection.starts[0] == 0 && projection.starts[projection.n_tiles()] == projection.lists.size(), "project: lists have holes");
    for (int64_t tile = 0; tile < projection.n_tiles(); ++tile) {
        check(projection.starts[tile] <= projection.starts[tile + 1], "project: a list ends before it begins");
        for (int64_t i = projection.starts[tile]; i < projection.starts[tile + 1]; ++i) {
            const Projected& p = projection.projected[projection.lists[i]];
            check(int64_t(p.id) < count, "project: no such Gaussian");
            if (i == projection.starts[tile]) continue;
            const Projected& before = projection.projected[projection.lists[i - 1]];
            check(before.depth < p.depth || (before.depth == p.depth && scene.tie(before.id) < scene.tie(p.id)),
                  "project: not front to back");
        }
    }
}

// Lists that are not as long as they were counted to be are refused, and nothing is written outside of them.
inline void fuzz_binning(Random& random, const SceneArrays& arrays, const Camera& camera, const Preset& preset, int threads) {
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    const int64_t count = arrays.count(), stride = count + 1;
    const int32_t tiles_x = (camera.width + kTile - 1) / kTile, tiles_y = (camera.height + kTile - 1) / kTile;
    const int64_t n_tiles = int64_t(tiles_x) * tiles_y;
    Buffer<Projected> projected(stride);
    Exact<float> depths(random, stride);
    Binning binning(tiles_x, tiles_y, 1, stride, 1);
    const int64_t found =
        kernels.project(arrays.scene(), camera, preset, 0, arrays.scene().n_blocks(), projected.data(), binning.rects(0), depths.data());
    std::vector<int64_t> rectangles(size_t(n_tiles), 0);  // without spans, a bound of what is counted
    for (int64_t i = 0; i < found; ++i) {
        const TileRect& rect = binning.rects(0)[i];
        check(rect.x0 <= rect.x1 && rect.y0 <= rect.y1 && rect.x1 <= tiles_x && rect.y1 <= tiles_y, "bin: no rectangle");
        for (int y = rect.y0; y < rect.y1; ++y)
            for (int x = rect.x0; x < rect.x1; ++x) ++rectangles[size_t(y) * size_t(tiles_x) + size_t(x)];
    }
    binning.count(0, 0, projected.data(), found);
    Buffer<int64_t> starts = binning.starts();
    for (int64_t tile = 0; tile < n_tiles; ++tile) {
        const int64_t length = starts[tile + 1] - starts[tile];
        check(length >= 0 && length <= rectangles[size_t(tile)], "bin: more than the rectangles hold");
    }
    const auto fill = [&] { return binning.lists(starts, {found}, depths.data(), projected.data(), nullptr, threads, never); };
    check(fill().size() == starts[n_tiles], "bin: lists have holes");

    const int64_t place = random.between(1, n_tiles);
    const int64_t change = place < n_tiles && random.chance(0.5) ? starts[place - 1] - starts[place] : random.between(1, 5);
    if (change == 0) return;
    for (int64_t tile = place; tile <= n_tiles; ++tile) {
        if (tile == place || random.chance(0.5)) starts[tile] += change;
        starts[tile] = std::max(starts[tile], starts[tile - 1]);
    }
    bool refused = false;
    try {
        fill();
    } catch (const std::logic_error&) {
        refused = true;
    }
    check(refused, "bin: lists of another length than counted");
}

inline void check_same_projection(const Projection& a, const Projection& b, const std::string& what) {
    check(a.n_visible == b.n_visible, what + ": other Gaussians are visible");
    check_same(a.starts, b.starts, what);
    check(a.lists.size() == b.lists.size(), what + ": lists");  // slots may differ: chunks that are passed over have none
    for (int64_t i = 0; i < a.lists.size(); ++i)
        check(std::memcmp(&a.projected[a.lists[i]], &b.projected[b.lists[i]], sizeof(Projected)) == 0, what + ": projections");
}

// [pixels, channels] of values [N, channels]; alpha as well.
struct Channels {
    Exact<float> image, alpha;
};
inline Channels channels_of(Random& random, const Projection& projection, const Exact<float>& values, int64_t channels, int threads) {
    const int64_t pixels = int64_t(projection.width) * projection.height;
    Channels out{{random, pixels * channels}, {random, pixels}};
    render_channels(projection, {values.data(), int32_t(channels), out.image.data(), out.alpha.data()}, threads, never);
    return out;
}

inline void fuzz_channels(Random& random, const Seen& seen) {
    const int64_t channels = random.one_of<int64_t>({0, 1, 2, 3, 4, 5, 7, 8, 9, 17});
    Exact<float> values(random, seen.projection.n_gaussians * channels);
    for (int64_t i = 0; i < values.size(); ++i) values[i] = float(random.uniform(-1, 1));
    const Channels out = channels_of(random, seen.projection, values, channels, seen.threads);
    const Channels alone = channels_of(random, seen.projection, values, channels, 1);
    check_same(out.image, alone.image, "channels: threads");
    check_same(out.alpha, alone.alpha, "alpha: threads");
    check_same(out.alpha, seen.alpha, "alpha: with other channels");
    for (int64_t i = 0; i < out.image.size(); ++i)
        check(std::abs(out.image[i]) <= out.alpha[i / channels] + 1e-4, "channels: more than what is painted");
    for (int64_t i = 0; i < values.size(); ++i)
        if (random.chance(0.1)) values[i] = hostile_float(random);
    channels_of(random, seen.projection, values, channels, seen.threads);

    const double kept = random.one_of({0.0, 0.01, 0.3});  // few tiles are left to draw
    for (int64_t i = 0; i < values.size(); ++i) values[i] = random.chance(kept) ? float(random.uniform(0.1, 1)) : 0.0f;
    const Channels whole = channels_of(random, seen.projection, values, channels, seen.threads);
    Exact<float> image(random, whole.image.size());
    render_channels(seen.projection, {values.data(), int32_t(channels), image.data(), nullptr}, seen.threads, never);
    check_same(image, whole.image, "channels: without alpha");
}

inline Exact<int32_t> random_labels(Random& random, const Seen& seen, int64_t levels, int32_t most) {
    Exact<int32_t> labels(random, levels * seen.pixels());
    const bool per_pixel = random.chance(0.3);
    if (per_pixel && seen.pixels() > 1000) most = std::min(most, 300);  // more would take long
    const int64_t patch = random.between(1, 40);
    const double none = random.one_of({0.0, 0.1, 1.0});
    for (int64_t i = 0; i < labels.size(); ++i) {
        const int64_t level = i / seen.pixels(), x = i % seen.projection.width, y = i % seen.pixels() / seen.projection.width;
        const int64_t cell = x / patch * 31 + y / patch * 17 + level;
        labels[i] = int32_t((per_pixel ? random.below(most) : cell % most));
        if (random.chance(none)) labels[i] = random.one_of({-1, -2, std::numeric_limits<int32_t>::min()});
    }
    return labels;
}

inline Combinations combined(const Seen& seen, const Exact<int32_t>& labels, int32_t levels, int threads) {
    return combine(labels.data(), levels, seen.pixels(), threads, never);
}

inline void fuzz_regions(Random& random, const Seen& seen) {
    const int32_t levels = int32_t(random.one_of({0, 1, 2, 3, 5}));
    const int32_t most = random.one_of({1, 3, 300, std::numeric_limits<int32_t>::max()});
    const Exact<int32_t> labels = random_labels(random, seen, levels, most);
    const Combinations all = combined(seen, labels, levels, seen.threads), alone_of_all = combined(seen, labels, levels, 1);
    check_same(all.map, alone_of_all.map, "combinations: threads");
    check(all.table == alone_of_all.table, "combinations: threads");

    int64_t known = 0;  // combinations are numbered in the order in which they are met
    for (int64_t pixel = 0; pixel < seen.pixels(); ++pixel) {
        bool any = false;
        for (int32_t level = 0; level < levels; ++level) {
            const int32_t label = std::max(labels[level * seen.pixels() + pixel], -1);
            any |= label >= 0;
            if (all.map[pixel] >= 0)
                check(all.table[size_t(all.map[pixel] * int64_t(levels) + level)] == label, "combinations: another label");
        }
        check(any == (all.map[pixel] >= 0) && all.map[pixel] <= known, "combinations: numbers");
        known = std::max(known, int64_t(all.map[pixel]) + 1);
    }
    check(known == all.count && int64_t(all.table.size()) == all.count * levels, "combinations: count");

    std::vector<double> pixels(size_t(all.count)), alpha(size_t(all.count)), weight(size_t(all.count));
    for (int64_t pixel = 0; pixel < seen.pixels(); ++pixel) {
        if (all.map[pixel] < 0) continue;
        pixels[size_t(all.map[pixel])] += 1;
        alpha[size_t(all.map[pixel])] += double(seen.alpha[pixel]);
    }
    const auto ask = [&](int threads) {
        return region_sums(seen.projection, {all.map.data(), seen.projection.width, seen.projection.height}, threads, never);
    };
    const RegionSums found = ask(seen.threads), alone = ask(1);
    check_same(found.gaussian, alone.gaussian, "region sums: threads");
    check_same(found.combination, alone.combination, "region sums: threads");
    check_same(found.weight, alone.weight, "region sums: threads");
    for (int64_t i = 0; i < found.weight.size(); ++i) {
        check(found.gaussian[i] >= 0 && found.gaussian[i] < seen.projection.n_gaussians, "region sums: no such Gaussian");
        check(found.combination[i] >= 0 && found.combination[i] < all.count, "region sums: no such combination");
        check(found.weight[i] > 0 && std::isfinite(found.weight[i]), "region sums: not positive");
        check(i == 0 || found.gaussian[i - 1] < found.gaussian[i] ||
                  (found.gaussian[i - 1] == found.gaussian[i] && found.combination[i - 1] < found.combination[i]),
              "region sums: not in order");
        weight[size_t(found.combination[i])] += double(found.weight[i]);
    }
    for (size_t c = 0; c < weight.size(); ++c)
        check_near(weight[c], alpha[c], 2e-5 * pixels[c] + 1e-4 * alpha[c], "region sum");
}

struct CodeArrays {
    Exact<uint8_t> indices8;
    Exact<uint16_t> indices16;
    Exact<float> weights;
    bool bytes;

    int64_t index(int64_t i) const { return bytes ? indices8[i] : indices16[i]; }
    GaussianCodes table(int32_t levels, int32_t k, int32_t n_atoms) const {
        return {bytes ? indices8.data() : nullptr, bytes ? nullptr : indices16.data(), weights.data(), nullptr, levels, k, n_atoms};
    }
};
inline CodeArrays random_codes(Random& random, int64_t entries, int32_t n_atoms) {
    CodeArrays codes{{random, entries}, {random, entries}, {random, entries}, random.chance(n_atoms <= 256 ? 0.7 : 0.3)};
    for (int64_t i = 0; i < entries; ++i) {
        const int64_t atom = random.below(codes.bytes ? std::min(n_atoms, 256) : n_atoms);
        codes.indices8[i] = uint8_t(atom), codes.indices16[i] = uint16_t(atom);
        codes.weights[i] = random.chance(0.2) ? 0.0f : float(random.uniform());
    }
    return codes;
}

// Rendered codes are channels of the codes written out; cosines follow from them.
inline void fuzz_codes(Random& random, const Seen& seen) {
    const int64_t n = seen.projection.n_gaussians;
    const auto levels = int32_t(random.between(1, 3)), k = int32_t(random.between(0, 5));
    const int32_t n_atoms = seen.pixels() > 5000 ? 7 : random.one_of({1, 2, 7, 64, 257});
    const CodeArrays codes = random_codes(random, n * levels * k, n_atoms);
    GaussianCodes table = codes.table(levels, k, n_atoms);
    const int64_t channels = table.atoms_of_all_levels(), image = seen.pixels() * n_atoms;
    Exact<float> rendered(random, levels * image), alone(random, levels * image);
    render_codes(seen.projection, table, rendered.data(), seen.threads, never);
    render_codes(seen.projection, table, alone.data(), 1, never);
    check_same(rendered, alone, "codes: threads");

    Exact<float> dense(random, n * channels);
    for (int64_t i = 0; i < n * levels * k; ++i)
        dense[i / k * n_atoms + codes.index(i)] += codes.weights[i];
    const Channels expected = channels_of(random, seen.projection, dense, channels, seen.threads);
    for (int64_t i = 0; i < rendered.size(); ++i) {
        const int64_t level = i / image, pixel = i % image / n_atoms, atom = i % n_atoms;
        check_near(rendered[i], expected.image[pixel * channels + level * n_atoms + atom], 1e-4, "codes");
    }

    constexpr int64_t kDim = 6;
    const auto n_queries = int32_t(random.between(0, 4));
    const int64_t atoms = int64_t(levels) * n_atoms;
    Exact<float> codebook(random, atoms * kDim), grams(random, atoms * n_atoms), scores(random, atoms * n_queries);
    for (int64_t i = 0; i < codebook.size(); ++i) codebook[i] = float(random.uniform(-0.2, 1));
    for (int64_t a = 0; a < atoms; ++a)
        for (int64_t b = 0; b < n_atoms; ++b)
            for (int64_t d = 0; d < kDim; ++d)
                grams[a * n_atoms + b] += codebook[a * kDim + d] * codebook[(a / n_atoms * n_atoms + b) * kDim + d];
    for (int64_t i = 0; i < scores.size(); ++i) scores[i] = float(random.uniform(-1, 1));
    Exact<float> cosines(random, levels * n_queries * seen.pixels()), again(random, cosines.size());
    Exact<float> norms(random, levels * seen.pixels());
    render_cosines(seen.projection, table, {grams.data(), scores.data(), n_queries, cosines.data(), norms.data()}, seen.threads, never);
    render_cosines(seen.projection, table, {grams.data(), scores.data(), n_queries, again.data(), nullptr}, 1, never);
    check_same(cosines, again, "cosines: threads");
    for (int64_t i = 0; i < cosines.size(); ++i) {
        const int64_t level = i / (n_queries * seen.pixels()), query = i / seen.pixels() % n_queries;
        const float* mine = &rendered[level * image + i % seen.pixels() * n_atoms];
        double norm2 = 0, own = 0, dot = 0;
        for (int64_t a = 0; a < n_atoms; ++a) {
            if (mine[a] == 0) continue;
            own += double(mine[a]) * mine[a];
            dot += double(mine[a]) * scores[(level * n_atoms + a) * n_queries + query];
            for (int64_t b = 0; b < n_atoms; ++b)
                norm2 += double(mine[a]) * mine[b] * grams[(level * n_atoms + a) * n_atoms + b];
        }
        check(std::isfinite(cosines[i]), "cosines: not finite");
        if (own == 0) check(cosines[i] == 0, "cosines: of nothing");
        if (norm2 > 0.01 * own && own > 1e-6)
            check_near(norms[level * seen.pixels() + i % seen.pixels()], std::sqrt(norm2), 1e-3 * std::sqrt(own), "norms");
        if (norm2 > 0.01 * own && own > 1e-6)
            check_near(cosines[i], dot / std::sqrt(norm2), 1e-3 * (1 + std::sqrt(own / norm2)), "cosines");
    }

    // float16 bits of any kind, weights that are no numbers.
    Exact<uint16_t> half(random, n * levels * k);
    for (int64_t i = 0; i < half.size(); ++i) half[i] = uint16_t(random.bits());
    table.weights = nullptr, table.half_weights = half.data();
    for (int64_t i = 0; i < grams.size(); ++i)
        if (random.chance(0.1)) grams[i] = hostile_float(random);
    render_codes(seen.projection, table, rendered.data(), seen.threads, never);
    render_cosines(seen.projection, table, {grams.data(), scores.data(), n_queries, cosines.data(), norms.data()}, seen.threads, never);

    // Atoms that there are not: refused where they are met, and never read beyond.
    Exact<uint8_t> any8(random, n * levels * k);
    Exact<uint16_t> any16(random, n * levels * k);
    for (int64_t i = 0; i < any8.size(); ++i) any8[i] = uint8_t(random.bits()), any16[i] = uint16_t(random.bits());
    table.indices8 = codes.bytes ? any8.data() : nullptr, table.indices16 = codes.bytes ? nullptr : any16.data();
    const auto refused = [&](const auto& call) {
        try {
            call();
        } catch (const std::invalid_argument&) {
        }
    };
    refused([&] { render_codes(seen.projection, table, rendered.data(), seen.threads, never); });
    refused([&] {
        render_cosines(seen.projection, table, {grams.data(), scores.data(), n_queries, cosines.data(), norms.data()}, seen.threads, never);
    });
}

// Of a chunk that is passed over, no row is visible.
inline void fuzz_bounds(Random& random, const SceneArrays& arrays, const Camera& camera, const Preset& preset) {
    const auto& kernels = pick(baseline::project_kernels, v3::project_kernels, v4::project_kernels);
    const Scene all = arrays.scene();
    for (int64_t first = 0; first < all.count;) {
        const int64_t n = std::min(random.between(1, 24), all.count - first);
        const Scene part{n, all.means + 3 * first, all.quats + 4 * first, all.scales + 3 * first, all.opacities + first, nullptr};
        const Buffer<ChunkBounds> bounds = bounds_of(part, 1, never);
        if (!kernels.may_see(bounds[0], camera, preset))
            check(project(part, camera, preset, 1, never).n_visible == 0, "project: a chunk was passed over wrongly");
        first += n;
    }
}

inline void fuzz_raster(Random& random) {
    const int64_t count = random.one_of<int64_t>({0, 1, 15, 16, 17, 300, 300, 1500, 1500, 3000, 9000});
    const double hostile = random.one_of({0.0, 0.0, 0.01, 0.1, 0.5});
    const bool hostile_camera = random.chance(0.3);
    const SceneArrays arrays = random_scene(random, count, hostile);
    const Camera camera = random_camera(random, hostile_camera);
    const Preset preset = random_preset(random, random.chance(0.3));
    const int threads = int(random.between(1, 4));
    const auto see = [&](int n_threads, const Interrupted& interrupted) {
        return project(arrays.scene(), camera, preset, n_threads, interrupted);
    };
    const Projection projection = see(threads, never);
    check_view(projection, arrays);
    double seconds = 0;
    seconds = seconds_of([&] { check_same_projection(projection, see(1, never), "project: threads"); });
    if (random.chance(0.05)) interrupt(random, seconds, [&](const Interrupted& stop) { see(threads, stop); });
    const Buffer<SceneBlock> blocks = blocks_of(arrays.scene(), threads, never);
    Scene prepared = arrays.scene();
    prepared.blocks = blocks.data();
    const Buffer<ChunkBounds> bounds = bounds_of(prepared, threads, never);
    prepared.bounds = bounds.data();
    check_same_projection(projection, project(prepared, camera, preset, threads, never), "project: prepared");
    fuzz_bounds(random, arrays, camera, preset);

    fuzz_binning(random, arrays, camera, preset, threads);
    const Channels alpha = channels_of(random, projection, Exact<float>(), 0, threads);
    for (int64_t i = 0; i < alpha.alpha.size(); ++i)
        check(alpha.alpha[i] >= 0 && alpha.alpha[i] <= 1, "alpha: not within 0 .. 1");

    const Seen seen{projection, alpha.alpha, threads};
    fuzz_channels(random, seen);
    fuzz_regions(random, seen);
    fuzz_codes(random, seen);
}

}  // namespace scoup
