#pragma once

#include <soft_volume/JournalEntry.h>

#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <unordered_map>
#include <vector>

namespace soft_volume {

/// The tools' messages that a bag holds, by what the journal says about each. Only hashes are kept.
class RecordedInputs {
 public:
  enum class Match {
    kSame,
    kDiffers,     ///< the recorded message has other bytes
    kMissing,     ///< it is not recorded, although earlier and later ones are
    kOutOfRange,  ///< the recording of this tool had not begun or was over
  };

  /// Takes the serialised message of a tool; it need not be readable.
  void add(const std::string& type, std::vector<std::uint8_t> bytes);
  /// Looks for the message that a journal entry was made from.
  Match match(const JournalEntry& entry);
  /// For an entry out of range, after all entries were matched: whether a recorded message that no entry asked for was
  /// computed from a pose of the same time. Then its tool, session or sequence number is not as it was.
  bool wasAltered(const JournalEntry& entry) const;
  /// Recorded messages that no entry asked for.
  std::uint64_t unmatched() const;

 private:
  /// Type, tool and session: within these, sequence numbers grow.
  using Stream = std::tuple<std::string, std::string, std::uint64_t>;
  struct Recorded {
    std::uint64_t messages = 0;
    std::uint64_t asked_for = 0;
  };

  std::map<Stream, std::map<std::uint64_t, std::uint64_t>> sequences_;  ///< sequence to number of messages
  std::map<std::string, std::unordered_multimap<std::uint64_t, std::uint64_t>> stamps_;  ///< by type: ns to hash
  std::map<std::string, std::unordered_map<std::uint64_t, Recorded>> hashes_;            ///< by type: hash
};

}  // namespace soft_volume
