// What the test programs share: random numbers, memory without slack, checks, interruptions at random moments.
#pragma once

#if !defined(_WIN32)
#include <signal.h>
#include <sys/time.h>
#endif

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "isa.h"
#include "threads.h"

namespace scoup {

// The same numbers everywhere, unlike those of <random>. (splitmix64)
class Random {
  public:
    explicit Random(uint64_t seed) : state_(seed) {}
    // First the numbers that the bytes are: a fuzzer that changes one of them changes one choice.
    Random(const uint8_t* data, size_t size) : state_(size), data_(data), left_(size) {}

    uint64_t bits() {
        if (left_ >= sizeof(uint64_t)) {
            uint64_t number;
            std::memcpy(&number, data_, sizeof(number));
            data_ += sizeof(number);
            left_ -= sizeof(number);
            return number;
        }
        uint64_t z = state_ += 0x9e3779b97f4a7c15u;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
        return z ^ (z >> 31);
    }
    int64_t below(int64_t n) { return int64_t(bits() % uint64_t(n)); }
    int64_t between(int64_t low, int64_t high) { return low + below(high - low + 1); }
    double uniform(double low = 0, double high = 1) { return low + (high - low) * double(bits() >> 11) * 0x1p-53; }
    bool chance(double share) { return uniform() < share; }
    template <class T>
    T one_of(std::initializer_list<T> choices) {
        return choices.begin()[below(int64_t(choices.size()))];
    }

  private:
    uint64_t state_;
    const uint8_t* data_ = nullptr;
    size_t left_ = 0;
};

inline float hostile_float(Random& random) {
    using Limits = std::numeric_limits<float>;
    return random.one_of({Limits::quiet_NaN(), Limits::infinity(), -Limits::infinity(), 1e38f, -1e38f, Limits::max(),
                          Limits::denorm_min(), -Limits::denorm_min(), Limits::min(), 0.0f, -0.0f, 1.0f, -1.0f, 1e30f,
                          -1e30f, 1e-30f, 1e19f, 1e-19f, 0.00392156886f, 16777217.0f});
}

// An array in a block of its own that ends where the array ends, so that sanitizers see every step beyond it. It
// begins anywhere an element may: kernels must not count on more.
template <class T>
class Exact {
  public:
    Exact() = default;
    Exact(Random& random, int64_t size) : size_(size), offset_(random.below(4)) {
        block_ = static_cast<T*>(std::malloc(size_t(size + offset_) * sizeof(T)));
        if (block_ == nullptr && size + offset_ > 0) throw std::bad_alloc();
        for (int64_t i = 0; i < size; ++i) data()[i] = T();
    }
    Exact(Exact&& other) noexcept { swap(other); }
    Exact& operator=(Exact&& other) noexcept {
        swap(other);
        return *this;
    }
    ~Exact() { std::free(block_); }

    T* data() { return block_ + offset_; }
    const T* data() const { return block_ + offset_; }
    int64_t size() const { return size_; }
    T& operator[](int64_t i) { return data()[i]; }
    const T& operator[](int64_t i) const { return data()[i]; }

  private:
    void swap(Exact& other) noexcept {
        std::swap(block_, other.block_);
        std::swap(size_, other.size_);
        std::swap(offset_, other.offset_);
    }

    T* block_ = nullptr;
    int64_t size_ = 0, offset_ = 0;
};

inline void check(bool holds, const std::string& what) {
    if (!holds) throw std::logic_error(what);
}

template <class Array>
void check_same(const Array& a, const Array& b, const std::string& what) {
    check(a.size() == b.size(), what + ": sizes differ");
    check(a.size() == 0 || std::memcmp(a.data(), b.data(), size_t(a.size()) * sizeof(a[0])) == 0, what + ": bytes differ");
}

inline void check_near(double actual, double expected, double tolerance, const std::string& what) {
    if (std::abs(actual - expected) <= tolerance) return;  // not so for NaN
    check(false, what + ": " + std::to_string(actual) + " instead of " + std::to_string(expected) + ", tolerance " +
                     std::to_string(tolerance));
}

template <class Array>
void check_finite(const Array& values, const std::string& what) {
    for (int64_t i = 0; i < int64_t(values.size()); ++i) check(std::isfinite(values.data()[i]), what + ": not finite");
}

// The instruction sets that this CPU has.
inline std::vector<const char*> instruction_sets() {
    std::vector<const char*> found;
    for (const char* name : {"baseline", "v3", "v4"})
        if (use_isa(name)) found.push_back(name);
    use_isa("best");
    return found;
}

// for_chunks asks whether to go on after a tenth of a second only. The calls here are over long before, so a timer
// goes off within them and its handler sleeps for as long: the question comes after the chunk that was at work. Windows
// has no such timers, and libFuzzer needs them itself: there calls come to their end.
#if defined(_WIN32) || defined(SCOUP_FUZZING_ENGINE)
struct Timer {
    explicit Timer(double) {}
};
#else
class Timer {
  public:
    explicit Timer(double seconds) {
        struct sigaction action = {};
        action.sa_handler = [](int) { std::this_thread::sleep_for(std::chrono::milliseconds(110)); };
        action.sa_flags = SA_RESTART;
        sigaction(SIGALRM, &action, nullptr);
        set(1 + long(seconds * 1e6));
    }
    ~Timer() { set(0); }

  private:
    static void set(long microseconds) {
        itimerval value = {};
        value.it_value.tv_sec = microseconds / 1000000;
        value.it_value.tv_usec = microseconds % 1000000;
        setitimer(ITIMER_REAL, &value, nullptr);
    }
};
#endif

inline bool never() { return false; }

template <class Call>
double seconds_of(const Call& call) {
    const auto before = std::chrono::steady_clock::now();
    call();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - before).count();
}

// Interrupts call(interrupted) at a random moment of the `seconds` it usually takes. True if that ended it; it may be
// over sooner.
template <class Call>
bool interrupt(Random& random, double seconds, const Call& call) {
    const Timer timer(random.uniform(0, seconds));
    try {
        call([] { return true; });
        return false;
    } catch (const Cancelled&) {
        return true;
    }
}

}  // namespace scoup
