#include "report_page.h"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>

#include "soft_volume/common/error.h"

namespace soft_volume::replay_program {
namespace {

constexpr char kStyle[] = R"(
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1c2430; background: #fff; margin: 0; }
main { max-width: 1160px; margin: 0 auto; padding: 20px 24px 60px; }
h1 { font-size: 25px; margin: 8px 0 14px; overflow-wrap: anywhere; }
h2 { font-size: 18px; margin: 34px 0 10px; padding-bottom: 4px; border-bottom: 1px solid #d7dce3; }
.verdict { border-left: 6px solid #8a94a3; background: #f4f6f9; padding: 12px 18px; border-radius: 4px; }
.verdict.good { border-color: #1a7f4b; background: #eef8f1; }
.verdict.bad { border-color: #b3261e; background: #fdf0ef; }
.verdict b { font-size: 18px; display: block; }
.verdict p { margin: 4px 0 0; overflow-wrap: anywhere; }
table { border-collapse: collapse; font-size: 13.5px; margin: 8px 0 4px; max-width: 100%; }
th, td { text-align: left; padding: 4px 14px 4px 0; border-bottom: 1px solid #e4e8ee; vertical-align: top;
  overflow-wrap: anywhere; }
th { color: #55606f; font-weight: 600; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.good td:first-child::before { content: "\2713\00a0"; color: #1a7f4b; font-weight: bold; }
tr.bad td:first-child::before { content: "\2717\00a0"; color: #b3261e; font-weight: bold; }
tr.bad td { background: #fdf0ef; }
code { font: 12.5px/1.4 "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(480px, 1fr)); gap: 14px; }
.plots img { width: 100%; height: auto; border: 1px solid #e4e8ee; border-radius: 4px; }
.frames { display: grid; gap: 4px 10px; margin: 14px 0; }
.frames figure { margin: 0; }
.frames img { width: 100%; display: block; border: 1px solid #d7dce3; }
.frames figcaption { font-size: 13px; color: #3c4654; padding: 3px 0; }
.moment { font-weight: 600; margin: 18px 0 -8px; }
span.scale { display: inline-block; width: 130px; height: 11px; border: 1px solid #8a94a3; vertical-align: -1px; }
li { overflow-wrap: anywhere; }
footer { margin-top: 40px; font-size: 12.5px; color: #6b7584; }
)";

std::string base64(const std::vector<std::uint8_t>& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve(bytes.size() / 3 * 4 + 4);
  for (std::size_t n = 0; n < bytes.size(); n += 3) {
    const std::size_t left = bytes.size() - n;
    const std::uint32_t group = std::uint32_t(bytes[n]) << 16 | (left > 1 ? std::uint32_t(bytes[n + 1]) << 8 : 0U) |
                                (left > 2 ? std::uint32_t(bytes[n + 2]) : 0U);
    text += kDigits[group >> 18];
    text += kDigits[group >> 12 & 63];
    text += left > 1 ? kDigits[group >> 6 & 63] : '=';
    text += left > 2 ? kDigits[group & 63] : '=';
  }
  return text;
}

}  // namespace

std::string escaped(const std::string& text) {
  std::string html;
  for (const char c : text) {
    switch (c) {
      case '&':
        html += "&amp;";
        break;
      case '<':
        html += "&lt;";
        break;
      case '>':
        html += "&gt;";
        break;
      case '"':
        html += "&quot;";
        break;
      default:
        html += c;
    }
  }
  return html;
}

std::string number(double value, int digits) {
  if (!std::isfinite(value))
    return "";
  char text[48];
  std::snprintf(text, sizeof text, "%.*g", digits, value);
  return text;
}

std::string count(std::uint64_t value) {
  std::string text = std::to_string(value);
  for (std::size_t place = text.size(); place > 3; place -= 3)
    text.insert(place - 3, "\xe2\x80\x89");  // thin space
  return text;
}

std::string dataUri(const std::string& type, const std::vector<std::uint8_t>& bytes) {
  return "data:" + type + ";base64," + base64(bytes);
}

std::vector<std::uint8_t> readBytesOf(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<std::uint8_t> bytes{std::istreambuf_iterator<char>(file), {}};
  if (!file || bytes.empty())
    throw core::FileError(path + ": cannot be read");
  return bytes;
}

Page::Page(const std::string& title) : title_(title) {
  body_ = "<h1>" + escaped(title) + "</h1>\n";
}

void Page::addHeading(const std::string& text) {
  body_ += "<h2>" + escaped(text) + "</h2>\n";
}

void Page::addVerdict(Mood mood, const std::string& headline, const std::vector<std::string>& lines) {
  const char* kind = mood == Mood::kGood ? " good" : mood == Mood::kBad ? " bad" : "";
  body_ += std::string("<div class=\"verdict") + kind + "\"><b>" + escaped(headline) + "</b>";
  for (const std::string& line : lines)
    body_ += "<p>" + escaped(line) + "</p>";
  body_ += "</div>\n";
}

void Page::addText(const std::string& text) {
  body_ += "<p>" + escaped(text) + "</p>\n";
}

void Page::addList(const std::vector<std::string>& lines) {
  body_ += "<ul>\n";
  for (const std::string& line : lines)
    body_ += "<li>" + escaped(line) + "</li>\n";
  body_ += "</ul>\n";
}

void Page::addTable(const std::vector<std::string>& header, const std::vector<Row>& rows,
                    std::size_t first_number_column) {
  const auto kind = [&](std::size_t column) { return column >= first_number_column ? " class=\"n\"" : ""; };
  body_ += "<table>\n<tr>";
  for (std::size_t n = 0; n < header.size(); ++n)
    body_ += std::string("<th") + kind(n) + ">" + escaped(header[n]) + "</th>";
  body_ += "</tr>\n";
  for (const Row& row : rows) {
    body_ += row.kind.empty() ? "<tr>" : "<tr class=\"" + row.kind + "\">";
    for (std::size_t n = 0; n < row.cells.size(); ++n)
      body_ += std::string("<td") + kind(n) + ">" + row.cells[n] + "</td>";
    body_ += "</tr>\n";
  }
  body_ += "</table>\n";
}

std::string Page::text() const {
  return "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>" + escaped(title_) +
         "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<main>\n" + body_ + "</main>\n</body>\n</html>\n";
}

}  // namespace soft_volume::replay_program
