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
  if (!first_.empty()) {
    throw ReadError("the file is damaged or not supported: " + message());
  }
}

/// VTK writes "ERROR: In file, line N\nClass (address): message"; only the message means something to a user.
std::string Reports::message() const {
  const std::size_t at = first_.find("): ");
  return at == std::string::npos ? first_ : first_.substr(at + 3);
}

vtkSmartPointer<Reports> startReports() {
  auto reports = vtkSmartPointer<Reports>::New();
  vtkOutputWindow::SetInstance(reports);
  return reports;
}

}  // namespace soft_volume::core::reader
