#include "reader_client.h"

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <cstring>
#include <new>
#include <system_error>

#include "reader_protocol.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr const char* kReaderName = "soft_volume_read_file";
constexpr std::size_t kLongestErrorText = 4096;

std::string besideThisProgram() {
  char path[PATH_MAX];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  const std::string program(path, length > 0 ? static_cast<std::size_t>(length) : 0);
  return program.substr(0, program.find_last_of('/') + 1) + kReaderName;
}

bool isProgram(const std::string& path) {
  return access(path.c_str(), X_OK) == 0;
}

std::string findReader(const std::string& path) {
  const char* chosen = std::getenv("SOFT_VOLUME_READER");
  if (chosen != nullptr && *chosen != '\0') {
    if (isProgram(chosen)) {
      return chosen;
    }
    throw FileError(path + ": the variable SOFT_VOLUME_READER names " + chosen + ", which cannot be executed");
  }
  const std::array<std::string, 3> places = {besideThisProgram(), SOFT_VOLUME_READER_BUILT,
                                             SOFT_VOLUME_READER_INSTALLED};
  const auto found = std::find_if(places.begin(), places.end(), isProgram);
  if (found == places.end()) {
    throw FileError(path + ": cannot be read because the program " + kReaderName + " is missing (looked for " +
                    places[0] + ", " + places[1] + " and " + places[2] +
                    "); build with SOFT_VOLUME_READER=ON or name it in the variable SOFT_VOLUME_READER");
  }
  return *found;
}

void checkExists(const std::string& path) {
  struct stat status;
  if (stat(path.c_str(), &status) != 0) {
    throw FileError(path + ": cannot be read: " + std::strerror(errno));
  }
}

std::string withMebibytes(std::uint64_t bytes) {
  return std::to_string(bytes >> 20) + " MiB";
}

/// One line of printable characters, whatever the child or a damaged file put there.
std::string printable(std::string text) {
  const auto unprintable = [](unsigned char c) { return c < 0x20 || c == 0x7F; };
  std::replace_if(text.begin(), text.end(), unprintable, ' ');
  text.erase(0, std::min(text.find_first_not_of(' '), text.size()));
  text.erase(text.find_last_not_of(' ') + 1);
  return text;
}

std::string describeEnd(int status) {
  if (status >= 0 && WIFSIGNALED(status)) {
    return std::string("ended by signal ") + std::to_string(WTERMSIG(status)) + ", " + strsignal(WTERMSIG(status));
  }
  if (status >= 0 && WIFEXITED(status)) {
    return "exit code " + std::to_string(WEXITSTATUS(status));
  }
  return "it ended early";
}

void checkGoodEnd(const std::string& path, ChildProcess& child) {
  const int status = child.wait();
  if (status > 0) {
    throw FileError(path + ": the reader failed after sending its data (" + describeEnd(status) + ")");
  }
}

}  // namespace

std::string ReaderClient::receiveText(std::uint64_t bytes) {
  const std::vector<char> text = receive<char>(bytes);
  return printable(std::string(text.begin(), text.end()));
}

void ReaderClient::refuse(const std::string& reason) const {
  throw FileError(path_ + ": " + reason);
}

void ReaderClient::receiveReply(void* reply, std::size_t size, const char* magic) {
  const std::size_t got = child_.read(reply, size);
  const char* bytes = static_cast<const char*>(reply);
  if (got >= sizeof kErrorMagic && std::memcmp(bytes, kErrorMagic, sizeof kErrorMagic) == 0) {
    throwReported(std::string(bytes + sizeof kErrorMagic, got - sizeof kErrorMagic));
  }
  if (got < size) {
    throwDied();
  }
  std::uint32_t version = 0;
  std::memcpy(&version, bytes + sizeof kErrorMagic, sizeof version);
  if (std::memcmp(bytes, magic, sizeof kErrorMagic) != 0 || version != kReaderProtocolVersion) {
    refuse(std::string("the reader's answer is not understood; ") + kReaderName + " is of another version");
  }
}

void ReaderClient::receiveAll(void* to, std::size_t size) {
  if (child_.read(to, size) < size) {
    throwDied();
  }
}

/// The sum of all parts keeps to the limit, too.
void ReaderClient::announce(std::uint64_t count, std::size_t size) {
  if (count > (limits_.memory_bytes - announced_) / size) {
    refuse("the reader's answer claims " + std::to_string(count) + " numbers, more than the limit of " +
           withMebibytes(limits_.memory_bytes) + " allows");
  }
  announced_ += count * size;
}

/// The child ended without a complete answer.
void ReaderClient::throwDied() {
  const std::string end = describeEnd(child_.wait());
  const std::string complaints = printable(child_.complaints());
  refuse("the reader died (" + end + (complaints.empty() ? "" : "; " + complaints) +
         "); the file is probably damaged, or it needs more memory than allowed");
}

void ReaderClient::throwReported(const std::string& beginning) {
  std::string text(kLongestErrorText, '\0');
  text.resize(child_.read(text.data(), text.size()));
  refuse(printable(beginning + text));
}

void readInChild(const std::string& path, const std::string& kind, const std::vector<std::string>& arguments,
                 const ReadLimits& limits, const std::function<void(ReaderClient&)>& receive) try {
  checkExists(path);
  std::vector<std::string> all = {kind, std::to_string(limits.memory_bytes), path};
  all.insert(all.end(), arguments.begin(), arguments.end());
  ChildProcess child(findReader(path), all, limits.time_s);
  ReaderClient client(child, path, limits);
  receive(client);
  checkGoodEnd(path, child);
} catch (const ChildProcess::TimeLimitReached&) {
  throw FileError(path + ": reading took longer than " + std::to_string(limits.time_s) +
                  " s and was stopped; the file may be damaged, not a regular file, or on a slow disk");
} catch (const InputError& error) {
  throw FileError(path + ": " + error.what());
} catch (const std::system_error& error) {
  throw FileError(path + ": " + error.what());
} catch (const std::bad_alloc&) {
  throw FileError(path + ": there is not enough memory for it; use a smaller file");
}

}  // namespace soft_volume::core
