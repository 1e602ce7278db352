// Threads that share out a range of tiles.
#pragma once
#include <functional>

namespace raden {

// Calls work(first, last) on pieces of 0…count, from `threads` threads including this one; returns
// when all is done. A second caller at the same time, and a child after fork, are served too.
void share_out(long count, long piece, int threads, const std::function<void(long, long)>& work);

}  // namespace raden
