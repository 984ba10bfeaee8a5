// Runs the real soft_volume_replay on bags that are spoiled at random: each is an error or a found difference, never a
// death of the program, nor memory that the bag's size does not justify.
//
// SOFT_VOLUME_FUZZ_VARIANTS says how many bags (default 100), SOFT_VOLUME_FUZZ_SEED which,
// SOFT_VOLUME_FUZZ_KEEP a folder for those that were not noticed.

#include <fcntl.h>
#include <gtest/gtest.h>
#include <rosbag/view.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/SimulationStats.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"
#include "soft_volume/common/hash.h"

namespace soft_volume {
namespace {

using Bytes = std::vector<char>;

/// Of a whole bag the program takes some 20 MB.
constexpr long kMostRss_kB = 150000;

Bytes readFile(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

void writeFile(const std::string& file, const Bytes& bytes) {
  std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

struct Outcome {
  int code = -1;  ///< negative: died of a signal
  long rss_kB = 0;
  std::string output;
};

/// What `arguments` name is done to the bag.
Outcome runReplay(const std::string& bag, const std::vector<std::string>& arguments, const std::string& log) {
  const pid_t child = fork();
  if (child == 0) {
    const int out = open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    dup2(out, STDOUT_FILENO);
    dup2(out, STDERR_FILENO);
    std::vector<std::string> words = {"timeout", "60", SOFT_VOLUME_BIN_DIR "/soft_volume_replay", bag, "--no-progress"};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> pointers;
    for (std::string& word : words)
      pointers.push_back(word.data());
    pointers.push_back(nullptr);
    execvp("timeout", pointers.data());
    _exit(127);
  }
  int status = 0;
  rusage usage{};
  wait4(child, &status, 0, &usage);
  const Bytes output = readFile(log);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status), usage.ru_maxrss,
          std::string(output.begin(), output.end())};
}

/// What comes after the header, which no hash covers: a number that each transport counts, a stamp, a frame's name.
std::vector<std::uint8_t> withoutHeader(const std::vector<std::uint8_t>& bytes) {
  std::uint32_t frame_bytes = 0;
  if (bytes.size() < 16)
    return bytes;
  std::memcpy(&frame_bytes, bytes.data() + 12, sizeof(frame_bytes));
  return {bytes.begin() + static_cast<long>(std::min<std::size_t>(std::size_t(16) + frame_bytes, bytes.size())),
          bytes.end()};
}

/// Also where its name or its checksum is spoiled.
template <typename Message>
bool isOf(const RawMessage& raw) {
  return raw.type == ros::message_traits::datatype<Message>() || raw.md5sum == ros::message_traits::md5sum<Message>();
}

/// Everything that a replay compares, as rosbag gives it. Left out are receipt times, names of topics, which may be
/// remapped, and statistics, whose times nothing can confirm. Read in a child process, because a damaged bag may kill
/// the reader; 0 when it does.
std::uint64_t contentHash(const std::string& bag) {
  int channel[2];
  if (pipe(channel) != 0)
    return 0;
  const pid_t child = fork();
  if (child == 0) {
    std::uint64_t hash = 1;
    try {
      std::map<std::string, std::vector<std::uint64_t>> messages;
      rewriteBag(bag, "/dev/null", [&](RawMessage& raw) {
        if (!isOf<RenderStats>(raw) && !isOf<SimulationStats>(raw))
          messages[raw.type].push_back(core::hashVector(withoutHeader(raw.bytes)));
        return false;
      });
      for (auto& entry : messages) {
        std::sort(entry.second.begin(), entry.second.end());
        hash = core::hashVector(entry.second, core::hashBytes(entry.first.data(), entry.first.size(), hash));
      }
    } catch (const std::exception&) {
      hash = 0;
    }
    _exit(write(channel[1], &hash, sizeof(hash)) == sizeof(hash) ? 0 : 1);
  }
  close(channel[1]);
  std::uint64_t hash = 0;
  if (read(channel[0], &hash, sizeof(hash)) != sizeof(hash))
    hash = 0;
  close(channel[0]);
  waitpid(child, nullptr, 0);
  return hash;
}

class Spoiler {
 public:
  explicit Spoiler(unsigned seed) : random_(seed) {}

  std::size_t below(std::size_t end) { return std::uniform_int_distribution<std::size_t>(0, end - 1)(random_); }

  /// Spoils the bytes of a file in a way that it names.
  std::string spoil(Bytes& bytes) {
    switch (below(7)) {
      case 0:
        bytes[below(bytes.size())] ^= static_cast<char>(1 << below(8));
        return "one bit";
      case 1:
        for (std::size_t n = 0; n < 16; ++n)
          bytes[below(bytes.size())] = static_cast<char>(below(256));
        return "16 bytes";
      case 2:
        bytes.resize(below(bytes.size()));
        return "cut tail";
      case 3:
        putLength(bytes, below(bytes.size() - 4));
        return "a huge count";
      case 4:
        return spoilField(bytes);
      case 5: {
        const std::size_t from = below(bytes.size());
        std::fill_n(bytes.begin() + static_cast<long>(from), std::min<std::size_t>(below(5000), bytes.size() - from),
                    0);
        return "a hole";
      }
      default: {
        const std::size_t from = below(bytes.size() - 2);
        const std::size_t size = std::min<std::size_t>(1 + below(5000), bytes.size() - from - 1);
        bytes.erase(bytes.begin() + static_cast<long>(from), bytes.begin() + static_cast<long>(from + size));
        return "a piece left out";
      }
    }
  }

  void putLength(Bytes& bytes, std::size_t at) {
    constexpr std::uint32_t kLengths[] = {0xffffffff, 0x7fffffff, 0x10000000, 100000000, 1000000, 0};
    std::memcpy(bytes.data() + at, &kLengths[below(6)], 4);
  }

 private:
  /// A field of a record's or a connection's header: its value, or the length before its name.
  std::string spoilField(Bytes& bytes) {
    const std::vector<std::string> names = {
        "md5sum=",  "type=", "topic=",     "op=",  "conn=",        "size=",
        "count=",   "time=", "index_pos=", "ver=", "compression=", "message_definition=",
        "latching="};
    const std::string& name = names[below(names.size())];
    std::vector<std::size_t> places;
    for (auto at = bytes.begin();; ++at) {
      at = std::search(at, bytes.end(), name.begin(), name.end());
      if (at == bytes.end())
        break;
      places.push_back(static_cast<std::size_t>(at - bytes.begin()));
    }
    if (places.empty())
      return "nothing";
    const std::size_t at = places[below(places.size())];
    if (at >= 4 && below(3) == 0) {
      putLength(bytes, at - 4);
      return "length of " + name;
    }
    bytes[std::min(at + name.size() + below(4), bytes.size() - 1)] ^= static_cast<char>(1 + below(255));
    return name;
  }

  std::mt19937 random_;
};

int variants() {
  const char* const wanted = std::getenv("SOFT_VOLUME_FUZZ_VARIANTS");
  return wanted == nullptr ? 100 : std::atoi(wanted);
}

unsigned seed() {
  const char* const wanted = std::getenv("SOFT_VOLUME_FUZZ_SEED");
  return wanted == nullptr ? 1 : static_cast<unsigned>(std::atoi(wanted));
}

class BagFuzz : public testing::Test {
 protected:
  void SetUp() override {
    // In a child, because threads that a run starts do not survive the forks below.
    const pid_t child = fork();
    if (child == 0) {
      RunSettings run;
      run.steps = 220;
      run.deltas = true;
      for (const bool compress : {false, true})
        recordBag(whole(compress), run, compress);
      _exit(0);
    }
    waitpid(child, nullptr, 0);
  }

  std::string whole(bool compress) const { return folder_ / (compress ? "lz4.bag" : "plain.bag"); }
  std::string spoiled() const { return folder_ / "spoiled.bag"; }

  /// What the program prints of a bag, without the time that it took.
  static std::string told(const Outcome& outcome) { return outcome.output.substr(0, outcome.output.rfind(" (")); }

  /// Noticed is what is an error or a difference, or at least changes what the program counts, such as an input at the
  /// edge of the recording that the journal does not know.
  void judge(const std::string& how, bool compressed) {
    const std::string log = folder_ / "log";
    const Outcome outcome = runReplay(spoiled(), {"--check"}, log);
    most_rss_kB_ = std::max(most_rss_kB_, outcome.rss_kB);
    const bool ended = outcome.code >= 0 && outcome.code <= 2;
    deaths_ += outcome.output.find("died with signal") != std::string::npos ? 1 : 0;
    ++codes_[outcome.code];
    const bool noticed = outcome.code != 0 || contentHash(spoiled()) == contentHash(whole(compressed)) ||
                         told(outcome) != told(runReplay(whole(compressed), {"--check"}, log));
    if (ended && outcome.rss_kB < kMostRss_kB && noticed)
      return;
    unnoticed_ += noticed ? 0 : 1;
    keep();
    EXPECT_TRUE(noticed) << how << " changed what the bag holds, and nobody said so\n" << outcome.output;
    EXPECT_TRUE(ended) << how << " ended with " << outcome.code << "\n" << outcome.output;
    EXPECT_LT(outcome.rss_kB, kMostRss_kB) << how << "\n" << outcome.output;
  }

  void keep() {
    const char* const folder = std::getenv("SOFT_VOLUME_FUZZ_KEEP");
    if (folder == nullptr)
      return;
    const std::string kept = std::string(folder) + "/" + std::to_string(++kept_) + ".bag";
    std::filesystem::copy_file(spoiled(), kept, std::filesystem::copy_options::overwrite_existing);
    std::printf("kept as %s\n", kept.c_str());
  }

  void tell() const {
    int bags = 0;
    for (const auto& code : codes_)
      bags += code.second;
    std::printf("%d bags:", bags);
    for (const auto& code : codes_)
      std::printf(" %d with exit code %d,", code.second, code.first);
    std::printf(" %d readers died, %d changes unnoticed, at most %ld kB\n", deaths_, unnoticed_, most_rss_kB_);
  }

  const TestFolder folder_;
  std::map<int, int> codes_;
  int deaths_ = 0;
  int unnoticed_ = 0;
  int kept_ = 0;
  long most_rss_kB_ = 0;
};

TEST_F(BagFuzz, SpoiledFilesAreErrorsOrDifferences) {
  Spoiler spoiler(seed());
  const Bytes bags[] = {readFile(whole(false)), readFile(whole(true))};
  ASSERT_NE(contentHash(whole(false)), 0U);
  for (int n = 0; n < variants() / 2; ++n) {
    Bytes bytes = bags[n % 2];
    const std::string how = spoiler.spoil(bytes);
    writeFile(spoiled(), bytes);
    judge(how, n % 2 == 1);
  }
  tell();
}

/// The file holds together, but a message in it does not.
TEST_F(BagFuzz, SpoiledMessagesAreErrorsOrDifferences) {
  Spoiler spoiler(seed() + 1000);
  std::size_t messages = 0;
  rewriteBag(whole(false), "/dev/null", [&](RawMessage&) { return ++messages > 0 && false; });
  for (int n = 0; n < variants() / 2; ++n) {
    std::string how;
    std::size_t left = spoiler.below(messages);
    rewriteBag(whole(false), spoiled(), [&](RawMessage& raw) {
      if (left-- != 0 || raw.bytes.size() < 8)
        return true;
      Bytes bytes(raw.bytes.begin(), raw.bytes.end());
      how = raw.type + ", ";
      if (spoiler.below(2) == 0) {
        spoiler.putLength(bytes, spoiler.below(bytes.size() - 4));
        how += "a huge count";
      } else {
        how += spoiler.spoil(bytes);
      }
      raw.bytes.assign(bytes.begin(), bytes.end());
      return true;
    });
    judge(how, false);
  }
  tell();
}

TEST_F(BagFuzz, EveryOptionReadsSpoiledBagsWithoutDying) {
  Spoiler spoiler(seed() + 2000);
  const Bytes bag = readFile(whole(false));
  const std::vector<std::vector<std::string>> options = {{"--against", whole(false)},
                                                         {"--frames", folder_ / "frames"},
                                                         {"--export-csv", folder_ / "csv"},
                                                         {"--export-vtu", folder_ / "vtu"},
                                                         {"--resimulate", "--output", folder_ / "again.bag"},
                                                         {"--report", folder_ / "report.html", "--check"}};
  for (int n = 0; n < variants() / 5; ++n) {
    Bytes bytes = bag;
    const std::string how = spoiler.spoil(bytes);
    writeFile(spoiled(), bytes);
    const auto& option = options[static_cast<std::size_t>(n) % options.size()];
    const Outcome outcome = runReplay(spoiled(), option, folder_ / "log");
    EXPECT_TRUE(outcome.code >= 0 && outcome.code <= 2) << option[0] << ", " << how << "\n" << outcome.output;
    EXPECT_LT(outcome.rss_kB, kMostRss_kB) << option[0] << ", " << how;
    if (outcome.output.find("died with signal") != std::string::npos) {
      ++deaths_;
      std::printf("%s, %s: %s\n", option[0].c_str(), how.c_str(), outcome.output.c_str());
      keep();
    }
    ++codes_[outcome.code];
    most_rss_kB_ = std::max(most_rss_kB_, outcome.rss_kB);
  }
  tell();
}

}  // namespace
}  // namespace soft_volume
