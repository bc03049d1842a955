// The Python module scoup._native.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include "buffer.h"
#include "isa.h"

namespace nb = nanobind;

namespace scoup {
void bind_code_sums(nb::module_& m);
void bind_coder(nb::module_& m);
void bind_neighbours(nb::module_& m);
void bind_raster(nb::module_& m);
void bind_sums(nb::module_& m);
void bind_selection(nb::module_& m);
}  // namespace scoup

NB_MODULE(_native, m) {
    m.doc() = "The compiled core of scoup.";
    nb::set_leak_warnings(false);  // views that a script still holds when it ends are no news to its user
    m.def("use_isa", [](const std::string& name) { return scoup::use_isa(name.c_str()); }, nb::arg("name"),
          "Use the kernels for an instruction set: baseline, v3, v4 or best. False if there is none or the CPU lacks it.");
    m.def("current_isa", [] { return std::string(scoup::name_of(scoup::current_isa())); }, "The instruction set in use.");
    m.def("release_memory", &scoup::release_kept, "Give back the memory that is kept for the arrays of the next view, and what else is free.");
    scoup::bind_code_sums(m);
    scoup::bind_coder(m);
    scoup::bind_neighbours(m);
    scoup::bind_raster(m);
    scoup::bind_sums(m);
    scoup::bind_selection(m);
}
