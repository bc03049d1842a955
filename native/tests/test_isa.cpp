// The instruction set that is taken for the best is the one that Linux finds in this CPU; elsewhere it is only printed.
#include <cstdio>
#include <fstream>
#include <initializer_list>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

#include "isa.h"

namespace {

// What /proc/cpuinfo lists of the first processor; nothing where there is no such file, or it is another processor's (an
// emulator shows the real one's).
std::set<std::string> features() {
#if defined(SCOUP_X86)
    std::ifstream file("/proc/cpuinfo");
    for (std::string line; std::getline(file, line);) {
        if (line.rfind("flags", 0) != 0) continue;
        std::istringstream words(line.substr(line.find(':') + 1));
        return {std::istream_iterator<std::string>(words), std::istream_iterator<std::string>()};
    }
#endif
    return {};
}

bool has(const std::set<std::string>& found, std::initializer_list<const char*> wanted) {
    for (const char* each : wanted)
        if (found.count(each) == 0) return false;
    return true;
}

}  // namespace

int main() {
    const char* set = scoup::name_of(scoup::current_isa());
    const std::set<std::string> found = features();
    if (found.empty()) {
        std::printf("instruction set %s, not compared\n", set);
        return 0;
    }
    const bool v3 = has(found, {"avx2", "fma", "bmi1", "bmi2", "f16c", "movbe", "abm"});
    const bool v4 = v3 && has(found, {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"});
    const std::string expected = v4 ? "v4" : v3 ? "v3" : "baseline";
    std::printf("instruction set %s; the system says %s\n", set, expected.c_str());
    return set != expected;
}
