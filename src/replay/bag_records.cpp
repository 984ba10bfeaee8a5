#include "bag_records.h"

#include <fcntl.h>
#include <roslz4/lz4s.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <vector>

#include "bag_file.h"
#include "soft_volume/replay/replay_bag.h"

namespace soft_volume {
namespace {

constexpr char kMagic[] = "#ROSBAG V2.0\n";
constexpr std::uint32_t kLargestHeader = 64 << 20;
// Record types.
constexpr std::uint8_t kMessage = 2;
constexpr std::uint8_t kFileHeader = 3;
constexpr std::uint8_t kIndex = 4;
constexpr std::uint8_t kChunk = 5;
constexpr std::uint8_t kConnection = 7;
constexpr std::uint32_t kIndexEntryBytes = 12;
/// lz4 cannot pack better than 255 to 1; the rest is its frame.
constexpr std::uint64_t kLargestRatio = 256;

using Fields = std::map<std::string, std::string>;

bool exists(const std::string& path) {
  std::error_code error;
  return std::filesystem::is_regular_file(path, error);
}

/// Our recorder holds a lock on what it writes.
bool isBeingWritten(const std::string& path) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0)
    return false;
  const bool locked = flock(file, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
  close(file);
  return locked;
}

/// What may be meant by a bag that is not there.
std::string hint(const std::string& path) {
  const std::string active = path + ".active";
  if (exists(active) && isBeingWritten(active))
    return "; a recorder is writing '" + active + "': stop it first (Ctrl-C or `rosnode kill`)";
  if (exists(active)) {
    return ", but its recorder was killed and left '" + active + "': run `rosbag reindex '" + active +
           "'`, then give that file; all but the last second is in it";
  }
  if (const std::string kept = path + ".interrupted"; exists(kept)) {
    return ", but its recorder was killed, and the next one kept what it left as '" + kept +
           "': run `rosbag reindex '" + kept + "'`, then give that file; all but the last second is in it";
  }
  if (exists(partFile(path, 0)))
    return ", but it was recorded in parts: give one of them, such as '" + partFile(path, 0) + "'";
  return "";
}

class RecordReader {
 public:
  explicit RecordReader(const std::string& path) : path_(path), file_(path, std::ios::binary) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(path, error))
      throw ReplayError(path + ": there is no such bag file" + hint(path));
    size_ = std::filesystem::file_size(path, error);
    if (!file_ || error)
      throw ReplayError(path + ": the bag cannot be read");
    if (size_ == 0)
      throw ReplayError(path + ": the file is empty");
  }

  BagRecords walk() {
    readMagic();
    readFileHeader();
    while (position_ < size_)
      readRecord();
    return {size_, largest_chunk_};
  }

 private:
  [[noreturn]] void damaged(const std::string& what) const {
    if (largest_chunk_ == 0) {
      throw ReplayError(path_ + ": the bag holds no whole message (" + what +
                        "); if its recorder was killed when it had just begun, nothing is lost but this file");
    }
    throw ReplayError(path_ + ": the bag is damaged or cut short at byte " + std::to_string(position_) + " (" + what +
                      "); `rosbag reindex` may save what comes before");
  }

  void readMagic() {
    std::string magic(sizeof(kMagic) - 1, '\0');
    file_.read(magic.data(), static_cast<std::streamsize>(magic.size()));
    if (magic.compare(0, 8, kMagic, 8) != 0)
      throw ReplayError(path_ + ": this is not a bag");
    if (magic != kMagic)
      throw ReplayError(path_ + ": only bags of format 2.0 can be read; `rosbag fix` converts older ones");
    position_ = magic.size();
  }

  void readFileHeader() {
    const Fields fields = readHeader();
    if (number<std::uint8_t>(fields, "op") != kFileHeader)
      damaged("it has no file header");
    const auto index_position = number<std::uint64_t>(fields, "index_pos");
    skip(readNumber());
    if (index_position == 0) {
      throw ReplayError(path_ + (isBeingWritten(path_)
                                     ? ": a recorder is writing this bag; stop it first (Ctrl-C or `rosnode kill`)"
                                     : ": the bag has no index, its recorder was killed; run `rosbag reindex '" +
                                           path_ + "'` first, which adds the index and keeps a copy as it was"));
    }
    if (index_position > size_)
      damaged("its index is missing");
  }

  void readRecord() {
    const Fields fields = readHeader();
    const auto type = number<std::uint8_t>(fields, "op");
    const std::uint32_t data_bytes = readNumber();
    if (data_bytes > size_ - position_)
      damaged("a record is longer than the file");
    if (type == kChunk) {
      checkChunk(fields, data_bytes);
    } else if (type == kIndex) {
      checkIndex(fields, data_bytes);
    } else {
      std::vector<char> data(data_bytes);
      read(data.data(), data_bytes);
      if (type == kConnection)
        parseHeader(data.data(), data_bytes);
    }
  }

  void checkChunk(const Fields& fields, std::uint32_t data_bytes) {
    chunk_bytes_ = number<std::uint32_t>(fields, "size");
    const auto compression = fields.find("compression");
    if (compression == fields.end())
      damaged("a chunk does not say how it is compressed");
    const bool fits = compression->second == "bz2" || (compression->second == "none" && chunk_bytes_ == data_bytes) ||
                      (compression->second == "lz4" && chunk_bytes_ <= kLargestRatio * data_bytes);
    if (!fits)
      damaged("a chunk's size cannot be right");
    largest_chunk_ = std::max<std::uint64_t>(largest_chunk_, chunk_bytes_);
    std::vector<char> data(data_bytes);
    read(data.data(), data_bytes);
    messages_.clear();
    messages_known_ = compression->second != "bz2";
    if (messages_known_)
      checkContent(compression->second == "lz4" ? unpack(data) : data);
  }

  std::vector<char> unpack(std::vector<char>& packed) const {
    std::vector<char> content(chunk_bytes_);
    unsigned int bytes = chunk_bytes_;
    const int result =
        roslz4_buffToBuffDecompress(packed.data(), static_cast<unsigned int>(packed.size()), content.data(), &bytes);
    if (result != ROSLZ4_OK || bytes != chunk_bytes_)
      damaged("a chunk cannot be unpacked");
    return content;
  }

  /// The records within a chunk, in whose headers rosbag believes every length.
  void checkContent(const std::vector<char>& content) {
    const auto number_at = [&](std::size_t at) {
      std::uint32_t value = 0;
      if (content.size() - at < sizeof(value))
        damaged("a chunk ends within a record");
      std::memcpy(&value, content.data() + at, sizeof(value));
      return value;
    };
    for (std::size_t at = 0; at < content.size();) {
      const std::size_t begin = at;
      const std::uint32_t header_bytes = number_at(at);
      at += sizeof(header_bytes);
      if (header_bytes > content.size() - at)
        damaged("a header is longer than its chunk");
      const Fields fields = parseHeader(content.data() + at, header_bytes);
      at += header_bytes;
      const std::uint32_t data_bytes = number_at(at);
      at += sizeof(data_bytes);
      if (data_bytes > content.size() - at)
        damaged("a message is longer than its chunk");
      const auto type = number<std::uint8_t>(fields, "op");
      const auto connection = number<std::uint32_t>(fields, "conn");
      if (type == kConnection)
        parseHeader(content.data() + at, data_bytes);
      if (type == kMessage)
        messages_.emplace(static_cast<std::uint32_t>(begin), connection);
      at += data_bytes;
    }
  }

  void checkIndex(const Fields& fields, std::uint32_t data_bytes) {
    const auto count = number<std::uint32_t>(fields, "count");
    const auto connection = number<std::uint32_t>(fields, "conn");
    if (data_bytes != std::uint64_t(count) * kIndexEntryBytes)
      damaged("an index has a wrong size");
    std::vector<char> data(data_bytes);
    read(data.data(), data_bytes);
    for (std::uint32_t n = 0; n < count; ++n) {
      std::uint32_t offset = 0;
      std::memcpy(&offset, data.data() + n * kIndexEntryBytes + 8, sizeof(offset));
      if (offset >= chunk_bytes_)
        damaged("an index points outside its chunk");
      const auto message = messages_.find(offset);
      if (messages_known_ && (message == messages_.end() || message->second != connection))
        damaged("an index points to no message of its connection");
    }
  }

  Fields readHeader() {
    const std::uint32_t bytes = readNumber();
    if (bytes > kLargestHeader || bytes > size_ - position_)
      damaged("a header is longer than the file");
    std::vector<char> text(bytes);
    read(text.data(), bytes);
    return parseHeader(text.data(), bytes);
  }

  Fields parseHeader(const char* begin, std::size_t bytes) const {
    Fields fields;
    for (std::size_t at = 0; at < bytes;) {
      std::uint32_t length = 0;
      if (bytes - at < sizeof(length))
        damaged("a header does not end where it should");
      std::memcpy(&length, begin + at, sizeof(length));
      at += sizeof(length);
      if (length > bytes - at)
        damaged("a header field is not complete");
      const char* const field = begin + at;
      const char* const equals = std::find(field, field + length, '=');
      if (equals == field + length)
        damaged("a header field is not complete");
      fields[std::string(field, equals)] = std::string(equals + 1, field + length);
      at += length;
    }
    return fields;
  }

  template <typename T>
  T number(const Fields& fields, const char* name) const {
    const auto field = fields.find(name);
    if (field == fields.end() || field->second.size() != sizeof(T))
      damaged(std::string("no field ") + name);
    T value;
    std::memcpy(&value, field->second.data(), sizeof(T));
    return value;
  }

  std::uint32_t readNumber() {
    std::uint32_t value = 0;
    read(reinterpret_cast<char*>(&value), sizeof(value));
    return value;
  }

  void read(char* data, std::uint64_t bytes) {
    if (bytes > size_ - position_)
      damaged("the file ends within a record");
    file_.read(data, static_cast<std::streamsize>(bytes));
    if (!file_)
      damaged("it cannot be read");
    position_ += bytes;
  }

  void skip(std::uint64_t bytes) {
    if (bytes > size_ - position_)
      damaged("the file ends within a record");
    file_.seekg(static_cast<std::streamoff>(bytes), std::ios::cur);
    position_ += bytes;
  }

  std::string path_;
  std::ifstream file_;
  std::uint64_t size_ = 0;
  std::uint64_t position_ = 0;
  std::uint32_t chunk_bytes_ = 0;
  std::map<std::uint32_t, std::uint32_t> messages_;  ///< of the chunk: offset to connection
  bool messages_known_ = false;
  std::uint64_t largest_chunk_ = 0;
};

}  // namespace

BagRecords checkBagRecords(const std::string& path) {
  return RecordReader(path).walk();
}

}  // namespace soft_volume
