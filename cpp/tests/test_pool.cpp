// The thread pool: what a task throws.
#include <atomic>
#include <new>

#include "../src/pool.hpp"
#include "check.hpp"
#include "tests.hpp"

// It is thrown to the caller, whatever thread the task ran on, and the pool works on.
void test_pool() {
  for (const std::size_t failing : {0, 3, 57, 99}) {
    std::atomic<std::size_t> done{0};
    bool is_thrown = false;
    try {
      monoloc::run_on_threads(100, 4, [&](std::size_t i) {
        if (i == failing) throw std::bad_alloc();
        ++done;
      });
    } catch (const std::bad_alloc&) {
      is_thrown = true;
    }
    CHECK(is_thrown && done < 100);
    done = 0;
    monoloc::run_on_threads(100, 4, [&](std::size_t) { ++done; });
    CHECK(done == 100);
  }
}
