// The thread pool: each task runs once, for any number of threads and callers; what a task throws.
#include <atomic>
#include <new>
#include <thread>
#include <vector>

#include "../src/pool.hpp"
#include "check.hpp"
#include "tests.hpp"

namespace {

// Each task runs once. The number of threads may increase or decrease between calls.
void test_each_task_runs_once() {
  for (const std::size_t threads : {1, 2, 5, 3, 64}) {
    for (int round = 0; round < 50; ++round) {
      std::vector<int> times(100, 0);
      monoloc::run_on_threads(times.size(), threads, [&](std::size_t i) { ++times[i]; });
      CHECK(times == std::vector<int>(100, 1));
    }
  }
}

// The pool serves one of several callers; the others run their tasks alone.
void test_callers_at_once() {
  std::atomic<std::size_t> done{0};
  std::vector<std::thread> callers;
  for (int caller = 0; caller < 4; ++caller) {
    callers.emplace_back([&] {
      for (int round = 0; round < 50; ++round) monoloc::run_on_threads(100, 3, [&](std::size_t) { ++done; });
    });
  }
  for (std::thread& caller : callers) caller.join();
  CHECK(done == 4 * 50 * 100);
}

// It is thrown to the caller, whatever thread the task ran on, and the pool works on.
void test_throwing_tasks() {
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

}  // namespace

void test_pool() {
  test_each_task_runs_once();
  test_callers_at_once();
  test_throwing_tasks();
}
