#include "soft_volume/ros/terminal_keys.h"

#include <poll.h>
#include <unistd.h>

namespace soft_volume {

TerminalKeys::TerminalKeys() {
  termios settings;
  if (tcgetattr(STDIN_FILENO, &settings) != 0)
    return;
  before_ = settings;
  settings.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  settings.c_cc[VMIN] = 0;
  settings.c_cc[VTIME] = 0;
  tcsetattr(STDIN_FILENO, TCSANOW, &settings);
}

TerminalKeys::~TerminalKeys() {
  if (before_)
    tcsetattr(STDIN_FILENO, TCSANOW, &*before_);
}

std::string TerminalKeys::read() {
  std::string keys;
  char buffer[64];
  pollfd input{STDIN_FILENO, POLLIN, 0};
  while (!ended_ && poll(&input, 1, 0) > 0) {
    const ssize_t count = ::read(STDIN_FILENO, buffer, sizeof(buffer));
    if (count > 0)
      keys.append(buffer, static_cast<std::size_t>(count));
    else
      ended_ = true;
  }
  return keys;
}

}  // namespace soft_volume
