#include "isa.h"

#include <atomic>
#include <cstring>
#include <initializer_list>

namespace scoup {
namespace {

Isa best() {
#if defined(SCOUP_X86)
    __builtin_cpu_init();
    const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                    __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                    __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                    __builtin_cpu_supports("avx512vl");
    return v4 ? Isa::v4 : v3 ? Isa::v3 : Isa::baseline;
#else
    return Isa::baseline;
#endif
}

std::atomic<int> chosen{-1};  // -1: not asked yet

}  // namespace

const char* name_of(Isa isa) {
    switch (isa) {
        case Isa::v3: return "v3";
        case Isa::v4: return "v4";
        default: return "baseline";
    }
}

Isa current_isa() {
    int isa = chosen.load(std::memory_order_relaxed);
    if (isa < 0) {
        isa = static_cast<int>(best());
        chosen.store(isa, std::memory_order_relaxed);
    }
    return static_cast<Isa>(isa);
}

bool use_isa(const char* name) {
    if (std::strcmp(name, "best") == 0) {
        chosen.store(static_cast<int>(best()), std::memory_order_relaxed);
        return true;
    }
    for (const Isa isa : {Isa::baseline, Isa::v3, Isa::v4}) {
        if (std::strcmp(name, name_of(isa)) == 0 && isa <= best()) {
            chosen.store(static_cast<int>(isa), std::memory_order_relaxed);
            return true;
        }
    }
    return false;
}

}  // namespace scoup
