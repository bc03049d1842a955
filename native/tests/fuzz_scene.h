// Random scenes, cameras and presets: good ones, and such as no one should meet.
#pragma once

#include "fuzzing.h"
#include "project_kernels.h"
#include "projected.h"

namespace scoup {

struct SceneArrays {
    Exact<float> means, quats, scales, opacities;
    Exact<int64_t> ties;
    bool tied = false;

    int64_t count() const { return opacities.size(); }
    int64_t tie(int64_t row) const { return tied ? ties[row] : row; }
    Scene scene() const {
        return {count(), means.data(), quats.data(), scales.data(), opacities.data(), tied ? ties.data() : nullptr};
    }
};

// Gaussians in front of a camera at the origin that looks along z, and a few behind it. `hostile` is the share of
// numbers that are replaced by the worst there are.
inline SceneArrays random_scene(Random& random, int64_t count, double hostile) {
    SceneArrays all{{random, 3 * count}, {random, 4 * count}, {random, 3 * count}, {random, count}, {random, count}};
    all.tied = random.chance(0.5);
    const double size = std::pow(10.0, random.uniform(-3, 0));
    for (int64_t i = 0; i < count; ++i) {
        const double depth = random.uniform(-0.5, 6);
        all.means[3 * i] = float(depth * random.uniform(-1, 1));
        all.means[3 * i + 1] = float(depth * random.uniform(-1, 1));
        all.means[3 * i + 2] = float(depth);
        for (int c = 0; c < 4; ++c) all.quats[4 * i + c] = float(random.uniform(-1, 1));
        for (int c = 0; c < 3; ++c) all.scales[3 * i + c] = float(size * std::pow(10.0, random.uniform(-1, 0.5)));
        all.ties[i] = int64_t(random.bits());
        all.opacities[i] = float(random.uniform());
        if (random.chance(0.1)) all.opacities[i] = 1.0f;
    }
    if (hostile == 0) return all;
    for (Exact<float>* array : {&all.means, &all.quats, &all.scales, &all.opacities})
        for (int64_t i = 0; i < array->size(); ++i)
            if (random.chance(hostile)) (*array)[i] = hostile_float(random);
    for (int64_t i = 0; i < count; ++i) {
        if (random.chance(hostile))
            for (int c = 0; c < 4; ++c) all.quats[4 * i + c] = 0;
        if (random.chance(hostile))
            for (int c = 0; c < 3; ++c) all.means[3 * i + c] = 0;  // at the camera
        if (random.chance(hostile)) {
            const float scale = random.one_of({0.0f, 1e-30f, 1e30f, -1.0f});
            for (int c = 0; c < 3; ++c) all.scales[3 * i + c] = scale;
        }
        if (random.chance(hostile) && i > 0) std::memcpy(&all.means[3 * i], &all.means[0], 3 * sizeof(float));
    }
    return all;
}

inline Camera random_camera(Random& random, bool hostile) {
    Camera camera{};
    const auto [width, height] = random.one_of<std::pair<int, int>>(
        {{1, 1}, {1, 40}, {16, 16}, {17, 33}, {64, 48}, {131, 70}, {131, 70}, {200, 150}, {8192, 1}, {1, 8192}});
    camera.width = width, camera.height = height;
    for (int i = 0; i < 3; ++i) camera.viewmat[5 * i] = 1;
    camera.fx = std::max(width, height) * random.uniform(0.3, 1.5);
    camera.fy = camera.fx * random.uniform(0.9, 1.1);
    camera.cx = width * random.uniform(0.3, 0.7);
    camera.cy = height * random.uniform(0.3, 0.7);
    if (!hostile) return camera;
    // Within what the binding lets through.
    if (random.chance(0.3)) camera.fx = random.one_of({1e-300, 1e-10, 1e-3, 1e7, 9e14});
    if (random.chance(0.3)) camera.fy = random.one_of({1e-300, 1e-10, 1e-3, 1e7, 9e14});
    if (random.chance(0.3)) camera.cx = random.one_of({-9e14, -1e5, 0.0, 1e5, 9e14});
    if (random.chance(0.3)) camera.cy = random.one_of({-9e14, -1e5, 0.0, 1e5, 9e14});
    for (double& entry : camera.viewmat)
        if (random.chance(0.05)) entry = random.one_of({0.0, -0.0, 1e-300, -1.0, 9e29, -9e29});
    return camera;
}

inline Preset random_preset(Random& random, bool hostile) {
    Preset preset{random.one_of({0.01, 0.2}), 0.99f, 1e-4f, random.chance(0.5), random.chance(0.5)};
    if (!hostile) return preset;
    if (random.chance(0.3)) preset.near = random.one_of({0.0, 1e-300, 5.9, 1e300});
    if (random.chance(0.3)) preset.alpha_max = random.one_of({1.0f, 0.001f, 1e-38f});
    if (random.chance(0.3)) preset.stop = random.one_of({0.0f, 1e-45f, 1e-30f, 0.5f, 0.999f});
    return preset;
}

}  // namespace scoup
