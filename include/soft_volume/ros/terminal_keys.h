#pragma once

#include <termios.h>

#include <optional>
#include <string>

namespace soft_volume {

/// The keys of the terminal that a program was started in, one by one and without echo; the terminal is as before once
/// this is gone. A pipe in place of a terminal works, too. One thread at a time.
class TerminalKeys {
 public:
  TerminalKeys();
  ~TerminalKeys();
  TerminalKeys(const TerminalKeys&) = delete;
  TerminalKeys& operator=(const TerminalKeys&) = delete;

  /// What was pressed since the last call; does not wait.
  std::string read();

 private:
  std::optional<termios> before_;
  bool ended_ = false;
};

}  // namespace soft_volume
