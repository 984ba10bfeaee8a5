#include "plot.h"

#include <csignal>
#include <cstdio>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

/// A gnuplot that ends before it has read the whole script would otherwise end us too.
class WithoutPipeSignal {
 public:
  WithoutPipeSignal() : previous_(std::signal(SIGPIPE, SIG_IGN)) {}
  ~WithoutPipeSignal() { std::signal(SIGPIPE, previous_); }
  WithoutPipeSignal(const WithoutPipeSignal&) = delete;
  WithoutPipeSignal& operator=(const WithoutPipeSignal&) = delete;

 private:
  void (*previous_)(int);
};

constexpr int kShellFindsNoProgram = 127 << 8;  // as pclose() returns it

}  // namespace

void plotWithGnuplot(const std::string& script) {
  const WithoutPipeSignal guard;
  FILE* gnuplot = popen("exec gnuplot", "w");
  if (gnuplot == nullptr)
    throw Error("gnuplot cannot be started for lack of memory or processes");
  const bool written = std::fwrite(script.data(), 1, script.size(), gnuplot) == script.size();
  const int status = pclose(gnuplot);
  if (status == kShellFindsNoProgram)
    throw Error("gnuplot is missing: install it (on Debian the package gnuplot-nox), or plot nothing");
  if (!written || status != 0)
    throw Error("gnuplot refused the plot; its own message is above. Is the folder writable?");
}

}  // namespace soft_volume::core
