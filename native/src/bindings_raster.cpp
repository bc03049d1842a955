// The rasteriser for Python; scoup/raster/native.py is its only user.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <tuple>

#include "arrays.h"
#include "code_arrays.h"
#include "python_signals.h"
#include "render.h"
#include "projection.h"

namespace nb = nanobind;

namespace scoup {
namespace {

constexpr int64_t kMostPixels = int64_t(1) << 31;
constexpr int32_t kMostEdge = 65535 * kTile;  // tiles are numbered in 16 bits

void check_size(int64_t width, int64_t height) {
    if (width < 1 || height < 1 || width > kMostEdge || height > kMostEdge || width * height > kMostPixels)
        throw std::invalid_argument("an image of " + std::to_string(width) + " x " + std::to_string(height) +
                                    " pixels cannot be rendered");
}

// A scene of arrays that Python keeps alive.
struct PyScene {
    Scene scene;
    Buffer<SceneBlock> blocks;
    Buffer<ChunkBounds> bounds;
};

PyScene py_scene(const Array& means, const Array& quats, const Array& scales, const Array& opacities,
                 const std::optional<Array>& ties, bool many_views, bool in_memory, int threads) {
    const auto count = int64_t(means.ndim() > 0 ? means.shape(0) : 0);
    if (count >= std::numeric_limits<int32_t>::max()) throw std::invalid_argument("too many Gaussians for one view");
    PyScene made{{count, data_of<float>(means, "means", {count, 3}), data_of<float>(quats, "quats", {count, 4}),
                  data_of<float>(scales, "scales", {count, 3}), data_of<float>(opacities, "opacities", {count}),
                  ties ? data_of<int64_t>(*ties, "ties", {count}) : nullptr},
                 {}, {}};
    if (!many_views) return made;
    if (in_memory) {
        made.blocks = without_lock([&] { return blocks_of(made.scene, sane(threads), python_signals()); });
        made.scene.blocks = made.blocks.data();
    }
    made.bounds = without_lock([&] { return bounds_of(made.scene, sane(threads), python_signals()); });
    made.scene.bounds = made.bounds.data();
    return made;
}

Projection py_project(const PyScene& made, const Array& viewmat, std::tuple<double, double, double, double> intrinsics,
             int64_t width, int64_t height, std::tuple<double, double, double> near_alpha_max_stop, bool stop_inclusive,
             bool centred_clamp, int threads) {
    check_size(width, height);
    Camera camera{};
    std::copy_n(data_of<double>(viewmat, "viewmat", {3, 4}), 12, camera.viewmat);
    std::tie(camera.fx, camera.fy, camera.cx, camera.cy) = intrinsics;
    for (const double focal : {camera.fx, camera.fy})
        if (!(focal > 0 && focal < 1e15)) throw std::invalid_argument("focal lengths must be positive and finite");
    if (!(std::abs(camera.cx) < 1e15 && std::abs(camera.cy) < 1e15))
        throw std::invalid_argument("the principal point must be finite");
    for (const double entry : camera.viewmat)
        if (!(std::abs(entry) < 1e30)) throw std::invalid_argument("viewmat must be finite");
    camera.width = int32_t(width), camera.height = int32_t(height);
    const auto [near, alpha_max, stop] = near_alpha_max_stop;
    if (!(near >= 0 && alpha_max > 0 && alpha_max <= 1 && stop > 0 && stop < 1))
        throw std::invalid_argument("near must be 0 or more, alpha_max and stop within 0 .. 1");
    const Preset preset{near, float(alpha_max), float(stop), stop_inclusive, centred_clamp};
    return without_lock([&] { return project(made.scene, camera, preset, sane(threads), python_signals()); });
}

nb::tuple py_render_channels(const Projection& projection, const Array& values, int threads, bool with_alpha) {
    if (values.ndim() != 2) throw std::invalid_argument("values must be [N, channels]");
    const auto channels = int64_t(values.shape(1));
    if (channels > 65536) throw std::invalid_argument("too many channels for one render");
    const float* data = data_of<float>(values, "values", {projection.n_gaussians, channels});
    const int64_t pixels = int64_t(projection.width) * projection.height;
    Buffer<float> image(pixels * channels), alpha(with_alpha ? pixels : 0);
    const ChannelImage out{data, int32_t(channels), image.data(), with_alpha ? alpha.data() : nullptr};
    without_lock([&] {
        render_channels(projection, out, sane(threads), python_signals());
    });
    const auto height = size_t(projection.height), width = size_t(projection.width);
    return nb::make_tuple(to_numpy(std::move(image), {height, width, size_t(channels)}),
                          with_alpha ? to_numpy(std::move(alpha), {height, width}) : nb::none());
}

nb::object py_render_codes(const Projection& projection, const Array& indices, const Array& weights, int64_t n_atoms, int threads) {
    const GaussianCodes codes = gaussian_codes(projection.n_gaussians, indices, weights, n_atoms);
    Buffer<float> out(int64_t(projection.width) * projection.height * codes.atoms_of_all_levels());
    without_lock([&] {
        render_codes(projection, codes, out.data(), sane(threads), python_signals());
    });
    return to_numpy(std::move(out), {size_t(codes.levels), size_t(projection.height), size_t(projection.width), size_t(n_atoms)});
}

// Cosines and norms.
nb::tuple py_render_cosines(const Projection& projection, const Array& indices, const Array& weights, const Array& grams,
                             const Array& scores, int threads) {
    if (grams.ndim() != 3 || scores.ndim() != 3) throw std::invalid_argument("grams and scores must have three axes");
    const auto n_atoms = int64_t(grams.shape(1)), n_queries = int64_t(scores.shape(2));
    const GaussianCodes codes = gaussian_codes(projection.n_gaussians, indices, weights, n_atoms);
    if (n_queries > 1 << 20) throw std::invalid_argument("too many queries for one render");
    const int64_t maps = int64_t(projection.width) * projection.height * codes.levels;
    Buffer<float> out(maps * n_queries), norms(maps);
    const Cosines cosines{data_of<float>(grams, "grams", {codes.levels, n_atoms, n_atoms}),
                          data_of<float>(scores, "scores", {codes.levels, n_atoms, n_queries}), int32_t(n_queries),
                          out.data(), norms.data()};
    without_lock([&] {
        render_cosines(projection, codes, cosines, sane(threads), python_signals());
    });
    const auto levels = size_t(codes.levels), height = size_t(projection.height), width = size_t(projection.width);
    return nb::make_tuple(to_numpy(std::move(out), {levels, size_t(n_queries), height, width}),
                          to_numpy(std::move(norms), {levels, height, width}));
}

}  // namespace

void bind_raster(nb::module_& m) {
    nb::class_<Projection>(m, "Projection", "A scene as one camera sees it: projected, sorted and binned.")
        .def_ro("width", &Projection::width)
        .def_ro("height", &Projection::height)
        .def_ro("n_gaussians", &Projection::n_gaussians)
        .def_ro("n_looked_at", &Projection::n_looked_at)
        .def_ro("n_visible", &Projection::n_visible)
        .def_prop_ro("n_pairs", [](const Projection& projection) { return projection.lists.size(); });
    nb::class_<PyScene>(m, "Scene", "Gaussians to project; for many views, bounds of their chunks, and in memory 48 bytes each, are worked out beforehand.")
        .def(
            "__init__",
            [](PyScene* self, const Array& means, const Array& quats, const Array& scales, const Array& opacities,
               const std::optional<Array>& ties, bool many_views, bool in_memory, int threads) {
                new (self) PyScene(py_scene(means, quats, scales, opacities, ties, many_views, in_memory, threads));
            },
            nb::arg("means"), nb::arg("quats"), nb::arg("scales"), nb::arg("opacities"), nb::arg("ties").none(),
            nb::arg("many_views"), nb::arg("in_memory"), nb::arg("threads"), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(), nb::keep_alive<1, 4>(),
            nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>());
    m.def("project", &py_project, nb::arg("scene"), nb::arg("viewmat"), nb::arg("intrinsics"), nb::arg("width"), nb::arg("height"),
          nb::arg("near_alpha_max_stop"), nb::arg("stop_inclusive"), nb::arg("centred_clamp"), nb::arg("threads"));
    m.def("render_channels", &py_render_channels, nb::arg("projection"), nb::arg("values"), nb::arg("threads"),
          nb::arg("with_alpha") = true);
    m.def("render_codes", &py_render_codes, nb::arg("projection"), nb::arg("indices"), nb::arg("weights"), nb::arg("n_atoms"),
          nb::arg("threads"));
    m.def("render_cosines", &py_render_cosines, nb::arg("projection"), nb::arg("indices"), nb::arg("weights"), nb::arg("grams"),
          nb::arg("scores"), nb::arg("threads"));
}

}  // namespace scoup
