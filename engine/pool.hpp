// Threads that share numbered jobs. Which thread takes a job does not matter to its result.

#pragma once

#include <cstddef>

namespace loopcal {

using Job = void (*)(void* context, int number, double* workspace);

// Runs jobs 0 .. count-1, each once, on up to `threads` threads (the caller is one of them), each
// with a workspace of `room` doubles. If another call is running, the caller does all of its own.
// The caller asks now and then whether it is interrupted; the jobs that nobody has begun are then left.
// `interrupted` may run jobs itself: they are done apart.
void run_jobs(Job job, void* context, int count, int threads, std::size_t room, bool (*interrupted)());

}  // namespace loopcal
