#include "clock.h"

#include <chrono>
#include <cstdint>

namespace scoup {

double measure_clock_hz() {
#if defined(SCOUP_X86)
    // Each product waits for the one before it, three cycles on every x86-64 CPU of the last fifteen years.
    constexpr int kRounds = 1'000'000, kProducts = 10, kCycles = 3;
    uint64_t value = 3, factor = 5;
    const auto started = std::chrono::steady_clock::now();
    for (int i = 0; i < kRounds; ++i)
        asm volatile(
            "imul %1, %0\n\timul %1, %0\n\timul %1, %0\n\timul %1, %0\n\timul %1, %0\n\t"
            "imul %1, %0\n\timul %1, %0\n\timul %1, %0\n\timul %1, %0\n\timul %1, %0\n\t"
            : "+r"(value)
            : "r"(factor)
            : "cc");
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - started;
    return double(kRounds) * kProducts * kCycles / seconds.count();
#else
    return 0;
#endif
}

}  // namespace scoup
