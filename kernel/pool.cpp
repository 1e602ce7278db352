#include "pool.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#ifdef _WIN32
static int process_id() { return 0; }  // no fork there
#else
#include <unistd.h>
static int process_id() { return static_cast<int>(getpid()); }
#endif

namespace raden {
namespace {

struct Job {
    const std::function<void(long, long)>& work;
    const long count, piece;
    std::atomic<long> next{0};

    void run() {
        for (;;) {
            const long first = next.fetch_add(piece);
            if (first >= count) return;
            work(first, std::min(first + piece, count));
        }
    }
};

// Never destroyed: its threads sleep until the process ends.
class Pool {
public:
    const int process = process_id();
    std::mutex in_use;  // one job at a time

    void run(Job& job, int helpers) {
        helpers = grown_to(helpers);
        {
            std::lock_guard<std::mutex> lock(state_);
            job_ = &job;
            wanted_ = running_ = helpers;
        }
        if (helpers > 0) start_.notify_all();
        job.run();
        std::unique_lock<std::mutex> lock(state_);
        running_ -= wanted_;  // who has not started need not
        wanted_ = 0;
        done_.wait(lock, [this] { return running_ == 0; });
        job_ = nullptr;
    }

private:
    int grown_to(int helpers) {
        while (threads_ < helpers) {
            try {
                std::thread([this] { serve(); }).detach();
            } catch (const std::system_error&) {
                break;  // no more threads to be had
            }
            ++threads_;
        }
        return std::min(helpers, threads_);
    }

    void serve() {
        std::unique_lock<std::mutex> lock(state_);
        for (;;) {
            start_.wait(lock, [this] { return wanted_ > 0; });
            --wanted_;
            Job* job = job_;
            lock.unlock();
            job->run();
            lock.lock();
            if (--running_ == 0) done_.notify_one();
        }
    }

    std::mutex state_;
    std::condition_variable start_, done_;
    Job* job_ = nullptr;
    int threads_ = 0, wanted_ = 0, running_ = 0;
};

// The pool of this process; a forked child has none of its parent's threads and gets its own.
Pool& pool() {
    static std::atomic<Pool*> current{nullptr};
    Pool* found = current.load();
    while (found == nullptr || found->process != process_id()) {
        Pool* fresh = new Pool;
        if (current.compare_exchange_strong(found, fresh)) return *fresh;
        delete fresh;
    }
    return *found;
}

}  // namespace

void share_out(long count, long piece, int threads, const std::function<void(long, long)>& work) {
    Job job{work, count, piece};
    const int helpers = threads - 1;
    if (helpers <= 0) return job.run();
    Pool& shared = pool();
    std::unique_lock<std::mutex> mine(shared.in_use, std::try_to_lock);
    if (mine.owns_lock())
        shared.run(job, helpers);
    else
        job.run();
}

}  // namespace raden
