#pragma once

#include <vtkDataArray.h>
#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include <string>
#include <vector>

#include "soft_volume/grid/grid_reader.h"

namespace soft_volume::core::reader {

/// One file's arrays over all its blocks, and the one that becomes the scalars.
class GridArrays {
 public:
  /// Throws ReadError when an array does not have one entry per point or cell, when there is no array, or when the one
  /// asked for is not there.
  GridArrays(const std::vector<vtkSmartPointer<vtkDataSet>>& blocks, const GridReadOptions& options);

  const std::vector<GridArray>& all() const { return all_; }
  std::size_t taken() const { return taken_; }
  const GridArray& takenArray() const { return all_[taken_]; }
  /// The taken array in one block. Throws ReadError when the block lacks it.
  vtkDataArray* in(vtkDataSet* block) const;
  /// A scalar of that array; NaN where it is not a finite float.
  float value(vtkDataArray* array, vtkIdType at) const;

 private:
  void add(const GridArray& array);
  std::size_t choose(vtkDataSet* first_block, const GridReadOptions& options) const;
  std::size_t active(vtkDataSet* block, GridArray::Place place) const;
  std::size_t named(const std::string& name) const;

  std::vector<GridArray> all_;
  std::size_t taken_ = 0;
  int component_ = GridReadOptions::kMagnitude;
};

}  // namespace soft_volume::core::reader
