#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstddef>
#include <string>
#include <vector>

namespace soft_volume::core {

/// A program whose standard output we read, with a deadline. The child is ended and waited for in the destructor at the
/// latest, so neither a running process nor a zombie stays behind. Used by one thread at a time; several objects in
/// several threads do not disturb each other (nothing of ours runs between fork and exec, and no signal handler or
/// process-wide setting is touched).
class ChildProcess {
 public:
  /// Thrown by the calls that wait.
  struct TimeLimitReached {};

  /// Starts `program` with `arguments`; the deadline is `time_limit_s` from now. Throws std::system_error when it
  /// cannot start.
  ChildProcess(const std::string& program, const std::vector<std::string>& arguments, double time_limit_s);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  /// Reads until `size` bytes have arrived or the child closed its output; returns the number of bytes.
  std::size_t read(void* to, std::size_t size);
  /// Waits for the end and returns waitpid's status, or -1 when the process's parent ignores its children.
  int wait();
  /// The last few hundred bytes that the child wrote to its standard error.
  const std::string& complaints() const { return complaints_; }

 private:
  int millisecondsLeft() const;
  void awaitInput();
  void collectComplaints();
  void end();

  std::chrono::steady_clock::time_point deadline_;
  pid_t pid_ = -1;
  int output_ = -1;
  int errors_ = -1;
  std::string complaints_;
};

}  // namespace soft_volume::core
