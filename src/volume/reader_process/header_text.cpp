#include "header_text.h"

#include <algorithm>
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
    throw ReadError("the file is too short: the header claims " + std::to_string(byte_count) +
                    " bytes of voxels, but only " + std::to_string(size < offset ? 0 : size - offset) +
                    " are there; copy the file again");
  }
}

}  // namespace soft_volume::core::reader
