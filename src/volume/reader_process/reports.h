#pragma once

#include <vtkOutputWindow.h>
#include <vtkSmartPointer.h>

#include <string>

namespace soft_volume::core::reader {

/// Receives every error and warning of every VTK object. A VTK reader that reports one goes on and returns whatever it
/// has, often zeros, so the first report rejects the file.
class Reports : public vtkOutputWindow {
 public:
  static Reports* New();
  vtkTypeMacro(Reports, vtkOutputWindow);
  void DisplayText(const char* text) override;
  bool mentions(const std::string& words) const { return first_.find(words) != std::string::npos; }
  /// Throws ReadError.
  void throwIfAny() const;

 private:
  std::string message() const;

  std::string first_;
};

/// Reports from now on.
vtkSmartPointer<Reports> startReports();

}  // namespace soft_volume::core::reader
