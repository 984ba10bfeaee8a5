#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace soft_volume::replay_program {

/// Text that a page shows as it is.
std::string escaped(const std::string& text);

/// `%.3g` and the like; empty for a number that is not finite.
std::string number(double value, int digits = 3);
/// With a thin space between groups of three digits.
std::string count(std::uint64_t value);

/// A file's content as a data URI, so that the page needs no other file. Throws core::FileError.
std::string dataUri(const std::string& type, const std::vector<std::uint8_t>& bytes);
std::vector<std::uint8_t> readBytesOf(const std::string& path);

/// A page under construction. Texts that are given as `html` are taken as they are, others are escaped.
class Page {
 public:
  /// `good`: the colour of the verdict.
  enum class Mood { kGood, kBad, kPlain };

  explicit Page(const std::string& title);
  void addHeading(const std::string& text);
  void addVerdict(Mood mood, const std::string& headline, const std::vector<std::string>& lines);
  void addText(const std::string& text);
  void addList(const std::vector<std::string>& lines);
  void addHtml(const std::string& html) { body_ += html; }

  /// Cells are html. `classes` holds a class of every column, such as "number"; those of rows are optional.
  struct Row {
    std::vector<std::string> cells;
    std::string kind;  ///< class of the row: "good", "bad" or empty
  };
  void addTable(const std::vector<std::string>& header, const std::vector<Row>& rows, std::size_t first_number_column);

  std::string text() const;

 private:
  std::string title_;
  std::string body_;
};

}  // namespace soft_volume::replay_program
