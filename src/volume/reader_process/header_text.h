#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace soft_volume::core::reader {

/// The text header of a MetaImage or NRRD file, key to value; keys in lower case, values as written. VTK's readers drop
/// parts of it (orientation, patient axes, units), and do not compare the size of the data file with it.
struct HeaderText {
  std::map<std::string, std::string> values;
  std::uint64_t data_offset = 0;  ///< first byte after the header, for data in the same file

  bool has(const std::string& key) const { return values.count(key) != 0; }
  /// Empty when absent.
  std::string value(const std::string& key) const;
  std::string lowerCaseValue(const std::string& key) const;
};

/// "Key = value" lines up to and including ElementDataFile. Throws ReadError when that line is missing.
HeaderText readMetaImageHeader(const std::string& path);
/// "key: value" lines up to the first empty line or the end of the file. Throws ReadError when it is no NRRD.
HeaderText readNrrdHeader(const std::string& path);

/// All numbers in a text; brackets and commas count as blanks.
std::vector<double> numbersIn(const std::string& text);
std::string lowerCase(std::string text);
bool endsWith(const std::string& text, const std::string& end);
/// `name` beside `path`, unless it is absolute.
std::string beside(const std::string& path, const std::string& name);
/// Throws ReadError when the file is missing or shorter than needed.
void checkFileHolds(const std::string& path, std::uint64_t offset, std::uint64_t byte_count);
/// VTK's XML readers never end on arrays of absurdly many components. Throws ReadError when an array claims more than
/// 4096 of them, or none.
void checkXmlComponents(const std::string& path);
/// The same as checkFileHolds for gzip data from `offset` on, counted after decompression; checks its checksum too,
/// which readers that stop after the last voxel never see.
void checkGzipHolds(const std::string& path, std::uint64_t offset, std::uint64_t byte_count);

}  // namespace soft_volume::core::reader
