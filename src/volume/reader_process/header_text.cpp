#include "header_text.h"

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "image.h"

namespace soft_volume::core::reader {
namespace {

/// Longer lines are binary data, not a header.
constexpr std::size_t kLongestLine = 1 << 16;
constexpr int kMostLines = 10000;

std::string trimmed(const std::string& text) {
  const char* const kBlanks = " \t\r\n";
  const std::size_t begin = text.find_first_not_of(kBlanks);
  return begin == std::string::npos ? "" : text.substr(begin, text.find_last_not_of(kBlanks) - begin + 1);
}

std::ifstream open(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    throw ReadError("cannot be opened");
  }
  return file;
}

/// Like std::getline, but does not swallow a whole binary file as one line.
bool readLine(std::istream& file, std::string& line) {
  line.clear();
  int c = 0;
  while ((c = file.get()) != EOF && c != '\n' && line.size() < kLongestLine) {
    line.push_back(static_cast<char>(c));
  }
  return c != EOF || !line.empty();
}

void store(HeaderText& header, const std::string& line, const std::string& separator) {
  const std::size_t at = line.find(separator);
  if (at != std::string::npos) {
    header.values[lowerCase(trimmed(line.substr(0, at)))] = trimmed(line.substr(at + separator.size()));
  }
}

/// Decompresses from `offset` to the end and returns the number of bytes.
std::uint64_t gzipBytes(const std::string& path, std::uint64_t offset) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0 || lseek(file, static_cast<off_t>(offset), SEEK_SET) < 0) {
    throw ReadError("the data file " + path + " cannot be read");
  }
  const gzFile stream = gzdopen(file, "rb");
  std::vector<char> block(1 << 16);
  std::uint64_t total = 0;
  int got = 0;
  while ((got = gzread(stream, block.data(), unsigned(block.size()))) > 0) {
    total += static_cast<std::uint64_t>(got);
  }
  if (gzclose(stream) != Z_OK || got < 0) {
    throw ReadError("the compressed data is damaged or cut off; copy the file again");
  }
  return total;
}

[[noreturn]] void throwTooShort(std::uint64_t claimed, std::uint64_t there) {
  throw ReadError("the file is too short: the header claims " + std::to_string(claimed) +
                  " bytes of voxels, but only " + std::to_string(there) + " are there; copy the file again");
}

/// Room for an attribute that two blocks of a file share.
constexpr std::size_t kLongestClaim = 256;

/// Looks at every NumberOfComponents="..." of a text.
void checkComponentClaims(const std::string& text) {
  constexpr long kMost = 4096;
  const std::string attribute = "NumberOfComponents";
  for (std::size_t at = text.find(attribute); at != std::string::npos; at = text.find(attribute, at + 1)) {
    const std::size_t open_quote = text.find_first_of("\"'", at);
    const std::size_t close_quote =
        open_quote == std::string::npos ? open_quote : text.find_first_of("\"'", open_quote + 1);
    if (close_quote == std::string::npos)
      return;  // cut by the end of the block, and seen again with the next one
    const std::string claim = text.substr(open_quote + 1, std::min(close_quote - open_quote - 1, std::size_t(32)));
    const long components = std::strtol(claim.c_str(), nullptr, 10);
    if (components < 1 || components > kMost)
      throw ReadError("an array claims " + claim + " components; it may have 1 to " + std::to_string(kMost));
  }
}

}  // namespace

std::string HeaderText::value(const std::string& key) const {
  const auto found = values.find(key);
  return found == values.end() ? "" : found->second;
}

std::string HeaderText::lowerCaseValue(const std::string& key) const {
  return lowerCase(value(key));
}

HeaderText readMetaImageHeader(const std::string& path) {
  std::ifstream file = open(path);
  HeaderText header;
  std::string line;
  for (int count = 0; count < kMostLines && readLine(file, line); ++count) {
    store(header, line, "=");
    if (header.has("elementdatafile")) {
      header.data_offset = file.eof() ? std::uint64_t(std::filesystem::file_size(path)) : std::uint64_t(file.tellg());
      return header;
    }
  }
  throw ReadError("is no MetaImage: the line ElementDataFile is missing");
}

HeaderText readNrrdHeader(const std::string& path) {
  std::ifstream file = open(path);
  HeaderText header;
  std::string line;
  if (!readLine(file, line) || line.rfind("NRRD", 0) != 0) {
    throw ReadError("is no NRRD file: it does not begin with NRRD");
  }
  for (int count = 0; count < kMostLines && readLine(file, line) && !trimmed(line).empty(); ++count) {
    if (file.eof() || line.find('\0') != std::string::npos) {  // VTK 9.1 would read such a line for ever
      throw ReadError("the header is cut off or damaged; it must end with a line break");
    }
    if (line[0] != '#' && line.find(":=") == std::string::npos) {
      store(header, line, ":");
    }
  }
  header.data_offset = file.eof() ? std::uint64_t(std::filesystem::file_size(path)) : std::uint64_t(file.tellg());
  return header;
}

std::vector<double> numbersIn(const std::string& text) {
  std::string plain = text;
  std::replace_if(
      plain.begin(), plain.end(), [](char c) { return c == '(' || c == ')' || c == ','; }, ' ');
  std::istringstream stream(plain);
  stream.imbue(std::locale::classic());
  std::vector<double> numbers;
  for (double number = 0.0; stream >> number;) {
    numbers.push_back(number);
  }
  return numbers;
}

std::string lowerCase(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : static_cast<char>(c);
  });
  return text;
}

bool endsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

std::string beside(const std::string& path, const std::string& name) {
  return (std::filesystem::path(path).parent_path() / name).string();
}

void checkFileHolds(const std::string& path, std::uint64_t offset, std::uint64_t byte_count) {
  std::error_code error;
  const std::uint64_t size = std::filesystem::file_size(path, error);
  if (error) {
    throw ReadError("the data file " + path + " cannot be read: " + error.message());
  }
  if (size < offset || size - offset < byte_count) {
    throwTooShort(byte_count, size < offset ? 0 : size - offset);
  }
}

void checkXmlComponents(const std::string& path) {
  std::ifstream file = open(path);
  std::string text;
  std::vector<char> block(1 << 20);
  bool is_xml = true;
  while (is_xml && (file.read(block.data(), std::streamsize(block.size())), file.gcount() > 0)) {
    text.append(block.data(), std::size_t(file.gcount()));
    is_xml = text.find("<AppendedData") == std::string::npos;  // raw bytes follow
    if (!is_xml)
      text.resize(text.find("<AppendedData"));
    checkComponentClaims(text);
    text.erase(0, text.size() - std::min(text.size(), kLongestClaim));
  }
}

void checkGzipHolds(const std::string& path, std::uint64_t offset, std::uint64_t byte_count) {
  const std::uint64_t there = gzipBytes(path, offset);
  if (there < byte_count) {
    throwTooShort(byte_count, there);
  }
}

}  // namespace soft_volume::core::reader
