#include "threads.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace scoup {
namespace {

using Clock = std::chrono::steady_clock;
constexpr auto kBetweenQuestions = std::chrono::milliseconds(100);

// One call of for_chunks: what its workers share.
class Run {
  public:
    Run(int64_t n_chunks, const std::function<void(int64_t, int)>& body) : n_chunks_(n_chunks), body_(body) {}

    void work(int worker, const Interrupted* interrupted) {
        auto asked = Clock::now();
        while (!stop_.load(std::memory_order_relaxed)) {
            const int64_t chunk = next_.fetch_add(1, std::memory_order_relaxed);
            if (chunk >= n_chunks_) return;
            try {
                body_(chunk, worker);
                if (interrupted && *interrupted && Clock::now() - asked > kBetweenQuestions) {
                    asked = Clock::now();
                    if ((*interrupted)()) throw Cancelled();
                }
            } catch (...) {
                fail(std::current_exception());
            }
        }
    }

    void rethrow() const {
        if (error_) std::rethrow_exception(error_);
    }

  private:
    void fail(std::exception_ptr error) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!error_) error_ = error;
        stop_ = true;
    }

    const int64_t n_chunks_;
    const std::function<void(int64_t, int)>& body_;
    std::atomic<int64_t> next_{0};
    std::atomic<bool> stop_{false};
    std::mutex mutex_;
    std::exception_ptr error_;
};

}  // namespace

void for_chunks(int64_t n_chunks, int n_threads, const Interrupted& interrupted,
                const std::function<void(int64_t, int)>& body) {
    if (n_chunks <= 0) return;
    Run run(n_chunks, body);
    const int64_t workers = std::clamp<int64_t>(n_threads, 1, n_chunks);
    std::vector<std::thread> others;
    others.reserve(static_cast<size_t>(workers));
    for (int worker = 1; worker < workers; ++worker) {
        try {
            others.emplace_back([&run, worker] { run.work(worker, nullptr); });
        } catch (const std::system_error&) {
            break;  // the system gives no more threads; those there are do the work
        }
    }
    run.work(0, &interrupted);
    for (auto& other : others) other.join();
    run.rethrow();
}

}  // namespace scoup
