// Threads that stay, for work of a millisecond: starting one each time would cost a tenth of it.
#pragma once

#include <cstddef>
#include <functional>

namespace monoloc {

// Calls task(0) ... task(count - 1), each once, on the calling thread and up to threads - 1 others; returns when all
// are done. While another thread is inside, and for one thread, the caller does everything itself.
void run_on_threads(std::size_t count, std::size_t threads, const std::function<void(std::size_t)>& task);

}  // namespace monoloc
