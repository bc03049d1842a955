#include "isa.h"

#include <atomic>
#include <cstdint>
#include <cstring>
#include <initializer_list>

namespace scoup {
namespace {

#if defined(SCOUP_X86)
struct Registers {
    uint32_t a, b, c, d;
};

Registers cpuid(uint32_t leaf) {
    Registers r{};
    asm volatile("cpuid" : "=a"(r.a), "=b"(r.b), "=c"(r.c), "=d"(r.d) : "a"(leaf), "c"(0));
    return r;
}

// Which registers the system keeps when it switches threads.
uint32_t kept_registers() {
    uint32_t low = 0, high = 0;
    asm volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

constexpr uint32_t bit(int place) { return uint32_t(1) << place; }
bool has(uint32_t value, uint32_t wanted) { return (value & wanted) == wanted; }
#endif

// Asked of the CPU itself: __builtin_cpu_supports needs a library that programs of Windows are not linked with. macOS
// keeps the registers of AVX-512 only once a thread has used them: there it is never the best.
Isa best() {
#if defined(SCOUP_X86)
    if (cpuid(0).a < 7) return Isa::baseline;
    const uint32_t first = cpuid(1).c, seventh = cpuid(7).b, extended = cpuid(0x80000001u).c;
    // FMA, MOVBE, XGETBV, AVX, F16C; BMI, AVX2, BMI2; LZCNT; 256 bits.
    constexpr uint32_t kFirst = bit(12) | bit(22) | bit(27) | bit(28) | bit(29), kSeventh = bit(3) | bit(5) | bit(8);
    if (!has(first, kFirst) || !has(seventh, kSeventh) || !has(extended, bit(5)) || !has(kept_registers(), 0x06)) return Isa::baseline;
    // AVX-512 F, DQ, CD, BW, VL; 512 bits and masks.
    constexpr uint32_t k512 = bit(16) | bit(17) | bit(28) | bit(30) | bit(31);
    return has(seventh, k512) && has(kept_registers(), 0xe6) ? Isa::v4 : Isa::v3;
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
