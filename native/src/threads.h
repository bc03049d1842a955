// Work cut into chunks, done by threads.
//
// Threads are started for each call and joined before it returns: nothing lives on between calls, so a process
// may fork at any time, and several Python threads may call at once.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <functional>

namespace scoup {

// Asked about ten times a second, always by the thread that called for_chunks; true means: give up.
using Interrupted = std::function<bool()>;

// Thrown by for_chunks after Interrupted said so; the work is then half done and its results are to be dropped.
struct Cancelled : std::exception {
    const char* what() const noexcept override { return "interrupted"; }
};

// How many threads there is work for: 1 to n_chunks.
inline int workers(int64_t n_chunks, int n_threads) {
    return int(std::max<int64_t>(1, std::min<int64_t>(n_threads, n_chunks)));
}

// Runs body(chunk, worker) for every chunk in 0 .. n_chunks - 1, with worker in 0 .. n_threads - 1.
//
// Chunks are handed out in rising order to whichever worker is free. So that results do not depend on the number
// of threads, a body writes only what belongs to its chunk; `worker` is for scratch memory alone.
// An exception of a body ends the call and is thrown again here. Where the system gives fewer threads, or no memory to
// start one, those there are do the work.
void for_chunks(int64_t n_chunks, int n_threads, const Interrupted& interrupted,
                const std::function<void(int64_t chunk, int worker)>& body);

}  // namespace scoup
