#include "pool.hpp"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#ifndef _WIN32
#include <pthread.h>
#endif

namespace loopcal {
namespace {

// Doubles on a cache line's boundary.
class Workspace {
public:
    double* at_least(std::size_t room) {
        if (room > size_) {
            memory_.reset(new double[room + 8]);
            size_ = room;
        }
        const auto address = reinterpret_cast<std::uintptr_t>(memory_.get());
        return reinterpret_cast<double*>((address + 63) / 64 * 64);
    }

private:
    std::unique_ptr<double[]> memory_;
    std::size_t size_ = 0;
};

struct Task {
    Job job;
    void* context;
    int count;
    std::atomic<int> next{0};

    void work(double* workspace) {
        for (int number; (number = next.fetch_add(1, std::memory_order_relaxed)) < count;)
            job(context, number, workspace);
    }

    // the same for the caller, who looks up every 50 ms
    void work(double* workspace, bool (*interrupted)()) {
        auto asked = std::chrono::steady_clock::now();
        for (int number; (number = next.fetch_add(1, std::memory_order_relaxed)) < count;) {
            job(context, number, workspace);
            const auto now = std::chrono::steady_clock::now();
            if (now - asked < std::chrono::milliseconds(50)) continue;
            if (interrupted()) next.store(count, std::memory_order_relaxed);
            asked = now;
        }
    }
};

// Never destroyed: its threads sleep until the process ends.
class Pool {
public:
    std::mutex running;  // held by the call that has the threads

    void run(Task& task, int threads, std::size_t room, bool (*interrupted)()) {
        while (static_cast<int>(workspaces_.size()) < threads)
            workspaces_.push_back(std::make_unique<Workspace>());
        for (int i = 0; i < threads; i++) workspaces_[i]->at_least(room);
        while (started_ < threads - 1) {
            std::thread(&Pool::serve, this, started_ + 1, generation_.load()).detach();
            started_++;
        }
        {
            std::lock_guard lock(mutex_);
            task_ = &task;
            room_ = room;
            helpers_ = threads - 1;
            generation_.fetch_add(1);
        }
        woken_.notify_all();
        task.work(workspaces_[0]->at_least(room), interrupted);
        std::unique_lock lock(mutex_);
        task_ = nullptr;
        idle_.wait(lock, [&] { return busy_ == 0; });
    }

private:
    void serve(int number, std::uint64_t seen) {
        for (;;) {
            wait_for_news(seen);
            std::unique_lock lock(mutex_);
            woken_.wait(lock, [&] { return generation_.load() != seen; });
            seen = generation_.load();
            if (!task_ || number > helpers_) continue;
            Task& task = *task_;
            double* const workspace = workspaces_[number]->at_least(room_);
            busy_++;
            lock.unlock();
            task.work(workspace);
            lock.lock();
            if (--busy_ == 0) idle_.notify_one();
        }
    }

    // The next block mostly follows at once: look out for it a little before falling asleep.
    void wait_for_news(std::uint64_t seen) const {
        const auto until = std::chrono::steady_clock::now() + std::chrono::microseconds(50);
        while (generation_.load() == seen && std::chrono::steady_clock::now() < until)
            std::this_thread::yield();
    }

    std::mutex mutex_;
    std::condition_variable woken_, idle_;
    std::atomic<std::uint64_t> generation_{0};
    Task* task_ = nullptr;
    std::size_t room_ = 0;
    int busy_ = 0, helpers_ = 0, started_ = 0;
    std::vector<std::unique_ptr<Workspace>> workspaces_;
};

std::atomic<Pool*> pool{nullptr};

Pool& the_pool() {
    Pool* found = pool.load();
    if (!found) {
        Pool* const fresh = new Pool;
        if (pool.compare_exchange_strong(found, fresh)) {
            found = fresh;
#ifndef _WIN32
            // A forked child has the memory but not the threads: it begins with a new pool.
            static std::once_flag once;
            std::call_once(once, [] { pthread_atfork(nullptr, nullptr, [] { pool.store(nullptr); }); });
#endif
        } else {
            delete fresh;
        }
    }
    return *found;
}

// Whether this thread is running jobs; a signal handler that `interrupted` lets run may come here again.
thread_local bool inside = false;

struct Inside {
    Inside() { inside = true; }
    ~Inside() { inside = false; }
};

}  // namespace

void run_jobs(Job job, void* context, int count, int threads, std::size_t room, bool (*interrupted)()) {
    Task task{job, context, count};
    if (inside) {  // pool and workspace are in use by the call that was interrupted
        Workspace other;
        return task.work(other.at_least(room), interrupted);
    }
    const Inside mark;
    threads = threads < count / 2 ? threads : count / 2;  // to wake another pays from two jobs on
    if (threads > 1) {
        Pool& shared = the_pool();
        std::unique_lock lock(shared.running, std::try_to_lock);
        if (lock) return shared.run(task, threads, room, interrupted);
    }
    thread_local Workspace own;
    task.work(own.at_least(room), interrupted);
}

}  // namespace loopcal
