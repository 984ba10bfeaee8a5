#include "guarded_process.h"

#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "soft_volume/replay/replay_bag.h"

namespace soft_volume::replay_program {
namespace {

/// What a replay really needs is far below this.
void limitMemory(const std::vector<std::string>& bags) {
#ifndef __SANITIZE_ADDRESS__
  rlim_t most = rlim_t(4) << 30;
  for (const std::string& bag : bags) {
    std::error_code error;
    const std::uintmax_t bytes = std::filesystem::file_size(bag, error);
    most += 16 * (error ? 0 : bytes);
  }
  rlimit limit{};
  getrlimit(RLIMIT_AS, &limit);
  limit.rlim_cur = std::min(limit.rlim_max, most);
  setrlimit(RLIMIT_AS, &limit);
#else
  static_cast<void>(bags);
#endif
}

[[noreturn]] void runChild(const std::vector<std::string>& bags, const std::function<int()>& work) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  const rlimit no_core{0, 0};
  setrlimit(RLIMIT_CORE, &no_core);
  limitMemory(bags);
  const int code = work();
  std::fflush(nullptr);
  // Without destructors of static objects: libraries that were confused by a damaged bag need not end cleanly.
  _exit(code);
}

}  // namespace

int runGuarded(const std::vector<std::string>& bags, const std::function<int()>& work,
               const std::function<int(int signal)>& died) {
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child < 0)
    throw ReplayError(std::string("no process can be started: ") + std::strerror(errno));
  if (child == 0)
    runChild(bags, work);
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : died(WTERMSIG(status));
}

}  // namespace soft_volume::replay_program
