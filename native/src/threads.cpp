#include "threads.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <thread>
#include <utility>
#include <vector>

namespace scoup {
namespace {

using Clock = std::chrono::steady_clock;
constexpr auto kBetweenQuestions = std::chrono::milliseconds(100);

// One call of for_chunks: what its workers share.
class Run {
  public:
    Run(int64_t n_chunks, const std::function<void(int64_t, int)>& body) : n_chunks_(n_chunks), body_(body) {}

    void work(int worker, const Interrupted* interrupted) noexcept {
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
    // The first error is kept; it is read after all workers are done. No lock: taking one may fail, too.
    void fail(std::exception_ptr error) noexcept {
        if (!failed_.exchange(true)) error_ = std::move(error);
        stop_ = true;
    }

    const int64_t n_chunks_;
    const std::function<void(int64_t, int)>& body_;
    std::atomic<int64_t> next_{0};
    std::atomic<bool> stop_{false};
    std::atomic<bool> failed_{false};
    std::exception_ptr error_;
};

// Threads that are waited for, whatever happens: std::thread ends the process where one is forgotten.
class Team {
  public:
    explicit Team(int64_t most) { threads_.reserve(static_cast<size_t>(most)); }
    ~Team() {
        for (auto& thread : threads_) thread.join();
    }
    Team(const Team&) = delete;
    Team& operator=(const Team&) = delete;

    // False if the system gives no more threads, or no memory for one.
    template <class Work>
    bool start(const Work& work) {
        try {
            threads_.emplace_back(work);
            return true;
        } catch (const std::exception&) {
            return false;
        }
    }

  private:
    std::vector<std::thread> threads_;
};

}  // namespace

void for_chunks(int64_t n_chunks, int n_threads, const Interrupted& interrupted,
                const std::function<void(int64_t, int)>& body) {
    if (n_chunks <= 0) return;
    Run run(n_chunks, body);
    {
        const int team = workers(n_chunks, n_threads);
        Team others(team - 1);
        for (int worker = 1; worker < team; ++worker)
            if (!others.start([&run, worker] { run.work(worker, nullptr); })) break;  // those there are do the work
        run.work(0, &interrupted);
    }
    run.rethrow();
}

}  // namespace scoup
