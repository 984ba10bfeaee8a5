#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "child_process.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {

/// The parent's side of `soft_volume_read_file`: receives the parts of an answer, and turns all that goes wrong into a
/// FileError with the file's path. What comes is checked like any input, because the child parsed a foreign file and
/// may have been damaged by it.
class ReaderClient {
 public:
  ReaderClient(ChildProcess& child, const std::string& path, const ReadLimits& limits)
      : child_(child), path_(path), limits_(limits) {}

  /// The answer's fixed beginning, a struct that starts with magic and version (reader_protocol.h).
  template <typename Reply>
  Reply receiveReply(const char (&magic)[8]) {
    Reply reply;
    receiveReply(&reply, sizeof reply, magic);
    return reply;
  }

  /// Grows with the bytes that arrive, so that a false claim costs nothing.
  template <typename T>
  std::vector<T> receive(std::uint64_t count) {
    announce(count, sizeof(T));
    std::vector<T> data;
    while (data.size() < count) {
      const std::size_t have = data.size();
      data.resize(std::min<std::size_t>(count, std::max(kFirstBlock / sizeof(T), 2 * have)));
      receiveAll(data.data() + have, (data.size() - have) * sizeof(T));
    }
    return data;
  }
  std::string receiveText(std::uint64_t bytes);

  [[noreturn]] void refuse(const std::string& reason) const;

 private:
  static constexpr std::size_t kFirstBlock = std::size_t(1) << 20;

  void receiveReply(void* reply, std::size_t size, const char* magic);
  void receiveAll(void* to, std::size_t size);
  void announce(std::uint64_t count, std::size_t size);
  [[noreturn]] void throwDied();
  [[noreturn]] void throwReported(const std::string& beginning);

  ChildProcess& child_;
  const std::string& path_;
  const ReadLimits& limits_;
  std::uint64_t announced_ = 0;  ///< bytes of all parts so far
};

/// Starts the reader on a file: `kind` and `arguments` as reader_protocol.h says. Calls `receive`, then waits for the
/// child's good end. Throws FileError only.
void readInChild(const std::string& path, const std::string& kind, const std::vector<std::string>& arguments,
                 const ReadLimits& limits, const std::function<void(ReaderClient&)>& receive);

}  // namespace soft_volume::core
