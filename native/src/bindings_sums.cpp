// Region sums and the vote for Python.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <tuple>

#include "arrays.h"
#include "code_arrays.h"
#include "combinations.h"
#include "python_signals.h"
#include "region_sums.h"
#include "projection.h"
#include "vote.h"

namespace nb = nanobind;

namespace scoup {
namespace {

constexpr int64_t kMostLevels = 1024, kMostAtoms = 65536, kMostKept = 65536;

nb::tuple py_combine(const Array& labels, int threads) {
    if (labels.ndim() != 3) throw std::invalid_argument("labels must be [levels, height, width]");
    const auto levels = int64_t(labels.shape(0)), height = int64_t(labels.shape(1)), width = int64_t(labels.shape(2));
    const auto* data = data_of<int32_t>(labels, "labels", {levels, height, width});
    if (levels > kMostLevels || height * width > std::numeric_limits<int32_t>::max())
        throw std::invalid_argument("label maps of too many levels or pixels");
    Combinations found =
        without_lock([&] { return combine(data, int32_t(levels), height * width, sane(threads), python_signals()); });
    Buffer<int32_t> table(int64_t(found.table.size()));
    std::copy(found.table.begin(), found.table.end(), table.begin());
    return nb::make_tuple(to_numpy(std::move(found.map), {size_t(height), size_t(width)}),
                          to_numpy(std::move(table), {size_t(found.count), size_t(levels)}));
}

nb::tuple py_region_sums(const Projection& projection, const Array& map, int threads) {
    const CombinationMap numbers{data_of<int32_t>(map, "combinations", {projection.height, projection.width}), projection.width, projection.height};
    RegionSums found = without_lock([&] { return region_sums(projection, numbers, sane(threads), python_signals()); });
    const auto count = size_t(found.weight.size());
    return nb::make_tuple(to_numpy(std::move(found.gaussian), {count}), to_numpy(std::move(found.combination), {count}),
                          to_numpy(std::move(found.weight), {count}));
}

// A vote, and the arrays that it reads.
class BoundVote {
  public:
    using ViewArrays = std::tuple<Array, Array, Array, Array, Array, Array>;
    using CodeArrays = std::tuple<Array, Array>;
    using EarlierArrays = std::tuple<Array, Array, Array>;

    BoundVote(int64_t n_gaussians, const Array& grams, std::vector<ViewArrays> views, std::vector<CodeArrays> codes)
        : grams_(grams), views_(std::move(views)), codes_(std::move(codes)), vote_(make(n_gaussians)) {}
    BoundVote(const BoundVote&) = delete;

    int64_t n_buckets() const { return vote_.n_buckets(); }

    void round(const WritableArray& indices, const WritableArray& weights, const std::optional<EarlierArrays>& earlier,
               bool unit_norm, int64_t first, int64_t last, int threads) const {
        check_range(first, last);
        const int64_t n = std::min(last * kVoteBucket, vote_.n_gaussians()) - first * kVoteBucket, levels = vote_.levels();
        const auto k = int64_t(indices.ndim() == 3 ? indices.shape(2) : 0);
        if (k < 1 || k > kMostKept) throw std::invalid_argument("indices must be [N, levels, k], and k at least 1");
        VotedCodes out{nullptr, nullptr, data_of<float>(weights, "weights", {n, levels, k}), int32_t(k)};
        if (vote_.n_atoms() <= 256)
            out.indices8 = data_of<uint8_t>(indices, "indices", {n, levels, k});
        else
            out.indices16 = data_of<uint16_t>(indices, "indices", {n, levels, k});
        std::optional<EarlierCodes> known;
        if (earlier) known = earlier_of(*earlier, first, last);
        without_lock([&] {
            vote_.round(out, known ? &*known : nullptr, unit_norm, first, last, sane(threads), python_signals());
        });
    }

    nb::list deviations(const EarlierArrays& earlier, int64_t first, int64_t last, int threads) const {
        check_range(first, last);
        const EarlierCodes known = earlier_of(earlier, first, last);
        const auto found =
            without_lock([&] { return vote_.deviations(known, first, last, sane(threads), python_signals()); });
        nb::list all;
        for (const std::vector<float>& level : found) {
            Buffer<float> values(int64_t(level.size()));
            std::copy(level.begin(), level.end(), values.begin());
            all.append(to_numpy(std::move(values), {level.size()}));
        }
        return all;
    }

  private:
    Vote make(int64_t n) const {
        if (n < 0 || n >= std::numeric_limits<int32_t>::max()) throw std::invalid_argument("too many Gaussians for one vote");
        const auto levels = int64_t(codes_.size()), n_atoms = int64_t(grams_.ndim() == 3 ? grams_.shape(1) : 0);
        if (n_atoms < 1 || n_atoms > kMostAtoms) throw std::invalid_argument("there must be 1 to 65536 atoms");
        if (levels > kMostLevels || levels * n_atoms > std::numeric_limits<int32_t>::max())
            throw std::invalid_argument("codes of too many levels");
        const auto* grams = data_of<float>(grams_, "grams", {levels, n_atoms, n_atoms});
        std::vector<RegionCodes> codes;
        for (const auto& [indices, weights] : codes_) {
            if (indices.ndim() != 2) throw std::invalid_argument("code indices must be [regions, k]");
            const auto rows = int64_t(indices.shape(0)), k = int64_t(indices.shape(1));
            if (k > kMostKept) throw std::invalid_argument("codes of too many entries");
            const Indices atoms = code_indices(indices, "code indices", {rows, k}, int32_t(n_atoms), 0, rows * k);
            codes.push_back({atoms.bytes, atoms.wide, data_of<float>(weights, "code weights", {rows, k}), rows, int32_t(k)});
        }
        std::vector<ViewSums> views;
        for (const auto& [buckets, starts, places, combinations, weights, regions] : views_) {
            const auto n_buckets = int64_t(buckets.ndim() == 1 ? buckets.shape(0) : 0);
            const auto count = int64_t(places.ndim() == 1 ? places.shape(0) : 0);
            const auto n_combinations = int64_t(regions.ndim() == 2 ? regions.shape(0) : 0);
            const bool halves = weights.dtype() == nb::dtype<uint16_t>();
            views.push_back({data_of<uint32_t>(buckets, "buckets", {n_buckets}), data_of<uint32_t>(starts, "starts", {n_buckets + 1}), data_of<uint8_t>(places, "places", {count}),
                             data_of<uint16_t>(combinations, "combinations", {count}),
                             halves ? nullptr : data_of<float>(weights, "weights", {count}),
                             halves ? data_of<uint16_t>(weights, "weights", {count}) : nullptr, n_buckets, count,
                             data_of<int64_t>(regions, "regions", {n_combinations, levels}), n_combinations});
        }
        return {n, int32_t(n_atoms), std::move(views), codes, grams};
    }

    // Buckets first .. last - 1 are those that are read.
    EarlierCodes earlier_of(const EarlierArrays& arrays, int64_t first, int64_t last) const {
        const auto& [indices, weights, sharpness] = arrays;
        const int64_t n = vote_.n_gaussians(), levels = vote_.levels();
        if (indices.ndim() != 3 || indices.shape(2) > size_t(kMostKept))
            throw std::invalid_argument("earlier indices must be [N, levels, k]");
        const auto k = int64_t(indices.shape(2));
        const int64_t begin = std::min(first * kVoteBucket, n), end = std::min(last * kVoteBucket, n);
        const Indices atoms = code_indices(indices, "earlier indices", {n, levels, k}, vote_.n_atoms(),
                                           begin * levels * k, (end - begin) * levels * k);
        return {atoms.bytes, atoms.wide, data_of<float>(weights, "earlier weights", {n, levels, k}), int32_t(k),
                data_of<float>(sharpness, "sharpness", {levels})};
    }

    void check_range(int64_t first, int64_t last) const {
        if (first < 0 || last < first || last > vote_.n_buckets()) throw std::invalid_argument("there are no such buckets");
    }

    Array grams_;
    std::vector<ViewArrays> views_;
    std::vector<CodeArrays> codes_;
    Vote vote_;
};

}  // namespace

void bind_sums(nb::module_& m) {
    m.def("combine", &py_combine, nb::arg("labels"), nb::arg("threads"));
    m.def("region_sums", &py_region_sums, nb::arg("projection"), nb::arg("combinations"), nb::arg("threads"));
    nb::class_<BoundVote>(m, "Vote", "Region sums of views and the codes of their regions, ready to be added up.")
        .def(nb::init<int64_t, const Array&, std::vector<BoundVote::ViewArrays>, std::vector<BoundVote::CodeArrays>>(),
             nb::arg("n_gaussians"), nb::arg("grams"), nb::arg("views"), nb::arg("codes"))
        .def_prop_ro("n_buckets", &BoundVote::n_buckets)
        .def("round", &BoundVote::round, nb::arg("indices"), nb::arg("weights"), nb::arg("earlier").none(),
             nb::arg("unit_norm"), nb::arg("first"), nb::arg("last"), nb::arg("threads"))
        .def("deviations", &BoundVote::deviations, nb::arg("earlier"), nb::arg("first"), nb::arg("last"), nb::arg("threads"));
}

}  // namespace scoup
