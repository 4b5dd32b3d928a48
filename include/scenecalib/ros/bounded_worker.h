#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

namespace scenecalib {

/// One thread that runs tasks in the order they were given, from a queue of bounded length. It is
/// the single owner of whatever its tasks touch.
class BoundedWorker {
 public:
  explicit BoundedWorker(std::size_t capacity) : capacity_(capacity), thread_([this] { Run(); }) {}
  ~BoundedWorker() { Finish(); }
  BoundedWorker(const BoundedWorker&) = delete;
  BoundedWorker& operator=(const BoundedWorker&) = delete;

  /// Waits for room (offline: nothing is lost).
  void Push(std::function<void()> task) {
    std::unique_lock<std::mutex> lock(mutex_);
    has_room_.wait(lock, [this] { return tasks_.size() < capacity_; });
    tasks_.push_back(std::move(task));
    has_task_.notify_one();
  }

  /// Refuses when there is no room (live: a callback never waits).
  bool TryPush(std::function<void()> task) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (tasks_.size() >= capacity_) return false;
    tasks_.push_back(std::move(task));
    has_task_.notify_one();
    return true;
  }

  /// Runs a task after everything that was given before, whatever the room, and waits for it.
  void RunInTurn(const std::function<void()>& task) {
    std::mutex done_mutex;
    std::condition_variable done_changed;
    bool done = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      tasks_.push_back([&] {
        task();
        const std::lock_guard<std::mutex> done_lock(done_mutex);
        done = true;
        done_changed.notify_one();
      });
      has_task_.notify_one();
    }
    std::unique_lock<std::mutex> done_lock(done_mutex);
    done_changed.wait(done_lock, [&] { return done; });
  }

  /// Runs what is queued, then ends the thread. Nothing may be pushed afterwards.
  void Finish() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      finishing_ = true;
      has_task_.notify_one();
    }
    if (thread_.joinable()) thread_.join();
  }

 private:
  void Run() {
    while (true) {
      std::function<void()> task;
      {
        std::unique_lock<std::mutex> lock(mutex_);
        has_task_.wait(lock, [this] { return finishing_ || !tasks_.empty(); });
        if (tasks_.empty()) return;
        task = std::move(tasks_.front());
        tasks_.pop_front();
        has_room_.notify_one();
      }
      task();
    }
  }

  const std::size_t capacity_;
  std::mutex mutex_;
  std::condition_variable has_task_;
  std::condition_variable has_room_;
  std::deque<std::function<void()>> tasks_;
  bool finishing_ = false;
  std::thread thread_;  // last: it uses the members above
};

}  // namespace scenecalib
