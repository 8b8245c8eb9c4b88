#include "pool.hpp"

#ifndef _WIN32
#include <unistd.h>
#endif

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace monoloc {
namespace {

class Pool {
 public:
  void run(std::size_t count, std::size_t helpers, const std::function<void(std::size_t)>& task) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      while (workers_.size() < helpers) workers_.emplace_back(&Pool::work, this, workers_.size());
      task_ = &task;
      count_ = count;
      next_ = 0;
      wanted_ = busy_ = helpers;
      ++round_;
    }
    wake_.notify_all();
    take();
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return busy_ == 0; });
    if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
  }

  std::mutex in_use;

 private:
  // What a task throws is thrown by run(), after all threads are done with the tasks; those that are left are skipped.
  void take() {
    try {
      for (std::size_t i = next_++; i < count_; i = next_++) (*task_)(i);
    } catch (...) {
      next_ = count_;
      const std::lock_guard<std::mutex> lock(mutex_);
      failure_ = std::current_exception();
    }
  }

  void work(std::size_t number) {
    std::size_t seen = 0;
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      wake_.wait(lock, [&] { return round_ != seen && number < wanted_; });
      seen = round_;
      lock.unlock();
      take();
      lock.lock();
      if (--busy_ == 0) done_.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_, done_;
  std::vector<std::thread> workers_;
  const std::function<void(std::size_t)>* task_ = nullptr;
  std::exception_ptr failure_;
  std::size_t count_ = 0, wanted_ = 0, busy_ = 0, round_ = 0;
  std::atomic<std::size_t> next_{0};
};

// Windows has no fork.
#ifdef _WIN32
int process() { return 1; }
#else
pid_t process() { return getpid(); }
#endif

// The process's pool. It is never destroyed, because its threads wait until the process ends. A forked process does
// not inherit the threads, so it creates its own pool.
Pool& pool() {
  static std::mutex making;
  static Pool* made = nullptr;
  static decltype(process()) maker = 0;
  const std::lock_guard<std::mutex> lock(making);
  if (maker != process()) {
    made = new Pool;
    maker = process();
  }
  return *made;
}

}  // namespace

void run_on_threads(std::size_t count, std::size_t threads, const std::function<void(std::size_t)>& task) {
  const std::size_t helpers = std::min(threads, count) - (count > 0 && threads > 0 ? 1 : 0);
  if (helpers > 0) {
    Pool& shared = pool();
    const std::unique_lock<std::mutex> lock(shared.in_use, std::try_to_lock);
    if (lock.owns_lock()) return shared.run(count, helpers, task);
  }
  for (std::size_t i = 0; i < count; ++i) task(i);
}

}  // namespace monoloc
