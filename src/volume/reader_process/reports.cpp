#include "reports.h"

#include <vtkObjectFactory.h>

#include "image.h"

namespace soft_volume::core::reader {

vtkStandardNewMacro(Reports);

void Reports::DisplayText(const char* text) {
  if (first_.empty()) {
    first_ = text;
  }
}

void Reports::throwIfAny() const {
  if (first_.empty())
    return;
  const std::string reason = message();
  const bool is_text = reason.find("Error reading ascii data") != std::string::npos;
  throw ReadError("the file is damaged or not supported: " + reason +
                  (is_text ? " (Words such as nan are no numbers to this reader: write them in binary.)" : ""));
}

/// VTK writes "ERROR: In file, line N\nClass (address): message" or "Generic Warning: In file, line N\nmessage"; only
/// the message means something to a user.
std::string Reports::message() const {
  if (first_.find("returned failure for request") != std::string::npos)
    return "its reader gave up without a reason";
  const std::size_t line_end = first_.find('\n');
  const std::size_t address_end = first_.find("): ");
  if (address_end != std::string::npos)
    return first_.substr(address_end + 3);
  return line_end == std::string::npos ? first_ : first_.substr(line_end + 1);
}

vtkSmartPointer<Reports> startReports() {
  auto reports = vtkSmartPointer<Reports>::New();
  vtkOutputWindow::SetInstance(reports);
  return reports;
}

}  // namespace soft_volume::core::reader
