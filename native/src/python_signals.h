// Ctrl-C in long calls, the interpreter's lock, and how many threads. For bindings*.cpp files only.
#pragma once

#include <nanobind/nanobind.h>

#include "threads.h"

namespace scoup {

// Ctrl-C, asked from C++: takes the interpreter's lock and runs pending signal handlers. True if one of them raised;
// the Python error is then set.
inline Interrupted python_signals() {
    return [] {
        const nanobind::gil_scoped_acquire lock;
        return PyErr_CheckSignals() != 0;
    };
}

// Numbers of threads beyond this only cost scratch memory.
inline int sane(int threads) { return threads < 1 ? 1 : threads > 1024 ? 1024 : threads; }

// Runs work() without the interpreter's lock. An interruption comes out as the Python error it was.
template <class Work>
auto without_lock(const Work& work) {
    try {
        const nanobind::gil_scoped_release unlocked;
        return work();
    } catch (const Cancelled&) {
        throw nanobind::python_error();
    }
}

}  // namespace scoup
