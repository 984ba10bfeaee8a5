#include "child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <system_error>

extern char** environ;

namespace soft_volume::core {
namespace {

constexpr std::size_t kComplaintsKept = 600;
constexpr int kPipeBytes = 1 << 20;  // fewer turns than with the default of 64 KiB

struct Pipe {
  int read_end = -1;
  int write_end = -1;

  Pipe() {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) {
      throw std::system_error(errno, std::generic_category(), "cannot make a pipe to the volume reader");
    }
    read_end = ends[0];
    write_end = ends[1];
  }
  ~Pipe() {
    closeEnd(read_end);
    closeEnd(write_end);
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;

  static void closeEnd(int end) {
    if (end >= 0) {
      close(end);
    }
  }
  int takeReadEnd() {
    const int end = read_end;
    read_end = -1;
    return end;
  }
};

/// What the child starts with: our pipes, no other file of this process, and default signals (roscpp ignores SIGPIPE).
class SpawnSettings {
 public:
  SpawnSettings(int output, int errors) {
    posix_spawn_file_actions_init(&actions_);
    posix_spawn_file_actions_addopen(&actions_, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_adddup2(&actions_, output, 1);
    posix_spawn_file_actions_adddup2(&actions_, errors, 2);
    posix_spawn_file_actions_addclosefrom_np(&actions_, 3);
    posix_spawnattr_init(&attributes_);
    sigset_t signals;
    sigemptyset(&signals);
    posix_spawnattr_setsigmask(&attributes_, &signals);
    sigfillset(&signals);
    posix_spawnattr_setsigdefault(&attributes_, &signals);
    posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  }
  ~SpawnSettings() {
    posix_spawn_file_actions_destroy(&actions_);
    posix_spawnattr_destroy(&attributes_);
  }
  SpawnSettings(const SpawnSettings&) = delete;
  SpawnSettings& operator=(const SpawnSettings&) = delete;

  const posix_spawn_file_actions_t* actions() const { return &actions_; }
  const posix_spawnattr_t* attributes() const { return &attributes_; }

 private:
  posix_spawn_file_actions_t actions_;
  posix_spawnattr_t attributes_;
};

pid_t start(const std::string& program, const std::vector<std::string>& arguments, int output, int errors) {
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) {
    argv.push_back(const_cast<char*>(argument.c_str()));
  }
  argv.push_back(nullptr);
  const SpawnSettings settings(output, errors);
  pid_t pid = -1;
  const int error = posix_spawn(&pid, program.c_str(), settings.actions(), settings.attributes(), argv.data(), environ);
  if (error != 0) {
    throw std::system_error(error, std::generic_category(), "cannot start " + program);
  }
  return pid;
}

std::chrono::steady_clock::time_point deadlineIn(double seconds) {
  constexpr double kLongest = 1e8;  // three years: no overflow in the clock's integers
  const double bounded = seconds > 0.0 ? std::min(seconds, kLongest) : 0.0;
  return std::chrono::steady_clock::now() +
         std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(bounded));
}

}  // namespace

ChildProcess::ChildProcess(const std::string& program, const std::vector<std::string>& arguments, double time_limit_s)
    : deadline_(deadlineIn(time_limit_s)) {
  Pipe output;
  Pipe errors;
  fcntl(output.read_end, F_SETPIPE_SZ, kPipeBytes);  // a refusal only costs speed
  fcntl(errors.read_end, F_SETFL, O_NONBLOCK);
  pid_ = start(program, arguments, output.write_end, errors.write_end);
  output_ = output.takeReadEnd();
  errors_ = errors.takeReadEnd();
}

ChildProcess::~ChildProcess() {
  end();
  Pipe::closeEnd(output_);
  Pipe::closeEnd(errors_);
}

std::size_t ChildProcess::read(void* to, std::size_t size) {
  std::size_t done = 0;
  while (done < size) {
    awaitInput();
    const ssize_t got = ::read(output_, static_cast<std::uint8_t*>(to) + done, size - done);
    if (got == 0) {
      break;
    }
    if (got > 0) {
      done += static_cast<std::size_t>(got);
    } else if (errno != EINTR) {
      throw std::system_error(errno, std::generic_category(), "cannot read from the volume reader");
    }
  }
  return done;
}

int ChildProcess::wait() {
  constexpr int kNapMs = 1;
  int status = 0;
  pid_t ended = 0;
  while ((ended = waitpid(pid_, &status, WNOHANG)) == 0 || (ended < 0 && errno == EINTR)) {
    if (millisecondsLeft() == 0) {
      throw TimeLimitReached();
    }
    collectComplaints();  // a child that cannot write them would never end
    poll(nullptr, 0, kNapMs);
  }
  pid_ = -1;
  collectComplaints();
  return ended < 0 ? -1 : status;
}

int ChildProcess::millisecondsLeft() const {
  using std::chrono::milliseconds;
  const auto left = std::chrono::ceil<milliseconds>(deadline_ - std::chrono::steady_clock::now()).count();
  return static_cast<int>(std::clamp<long>(left, 0, 1000 * 1000));
}

/// Returns when the output has bytes or its end; keeps the error pipe empty meanwhile, so that the child never blocks.
void ChildProcess::awaitInput() {
  while (true) {
    pollfd files[2] = {{output_, POLLIN, 0}, {errors_, POLLIN, 0}};
    const int left = millisecondsLeft();
    if (left == 0) {
      throw TimeLimitReached();
    }
    if (poll(files, 2, left) < 0 && errno != EINTR) {
      throw std::system_error(errno, std::generic_category(), "cannot wait for the volume reader");
    }
    if (files[1].revents != 0) {
      collectComplaints();
    }
    if (files[0].revents != 0) {
      return;
    }
  }
}

void ChildProcess::collectComplaints() {
  char text[4096];
  ssize_t got = 0;
  while (errors_ >= 0 && (got = ::read(errors_, text, sizeof text)) > 0) {
    complaints_.append(text, static_cast<std::size_t>(got));
    if (complaints_.size() > kComplaintsKept) {
      complaints_.erase(0, complaints_.size() - kComplaintsKept);
    }
  }
  if (got == 0) {  // the end: a closed pipe would wake up poll for ever
    Pipe::closeEnd(errors_);
    errors_ = -1;
  }
}

void ChildProcess::end() {
  if (pid_ < 0) {
    return;
  }
  kill(pid_, SIGKILL);
  while (waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) {
  }
  pid_ = -1;
}

}  // namespace soft_volume::core
