// Thread pool for tasks of about a millisecond, of which starting a thread would take a tenth.
#pragma once

#include <cstddef>
#include <functional>

namespace monoloc {

// Calls task(0) ... task(count - 1), each once, on the calling thread and up to threads - 1 others, and returns when
// all are done. If the pool is in use, or threads is 1, the calling thread runs all tasks. Throws what a task throws,
// one of several, after no thread runs a task any more.
void run_on_threads(std::size_t count, std::size_t threads, const std::function<void(std::size_t)>& task);

}  // namespace monoloc
