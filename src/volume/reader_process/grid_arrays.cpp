#include "grid_arrays.h"

#include <vtkCellData.h>
#include <vtkPointData.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "header_text.h"
#include "image.h"

namespace soft_volume::core::reader {
namespace {

constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
using Place = GridArray::Place;

vtkDataSetAttributes* attributesOf(vtkDataSet* block, Place place) {
  return place == Place::kPoints ? static_cast<vtkDataSetAttributes*>(block->GetPointData()) : block->GetCellData();
}

std::string nameOf(vtkDataArray* array) {
  const char* name = array->GetName();
  return name != nullptr && *name != '\0' ? name : "unnamed";
}

void checkLength(vtkDataArray* array, vtkIdType needed, Place place) {
  if (array->GetNumberOfTuples() != needed) {
    throw ReadError("the array " + nameOf(array) + " has " + std::to_string(array->GetNumberOfTuples()) +
                    " entries for " + std::to_string(needed) + (place == Place::kPoints ? " points" : " cells"));
  }
}

GridArray describe(vtkDataArray* array, Place place) {
  GridArray description;
  description.name = nameOf(array);
  description.place = place;
  description.components = array->GetNumberOfComponents();
  double range[2] = {0.0, 0.0};
  array->GetFiniteRange(range, description.components == 1 ? 0 : -1);
  if (range[0] <= range[1])
    description.range = {range[0], range[1]};
  return description;
}

/// Not VTK's marks of ghosts, nor arrays of text.
std::vector<vtkDataArray*> numbersOf(vtkDataSet* block, Place place) {
  vtkDataSetAttributes* attributes = attributesOf(block, place);
  std::vector<vtkDataArray*> arrays;
  for (int i = 0; i < attributes->GetNumberOfArrays(); ++i) {
    vtkDataArray* array = attributes->GetArray(i);
    if (array != nullptr && array->GetNumberOfComponents() > 0 &&
        nameOf(array) != vtkDataSetAttributes::GhostArrayName())
      arrays.push_back(array);
  }
  return arrays;
}

/// "density (points), momentum (points, 3 components)"
std::string listOf(const std::vector<GridArray>& arrays) {
  std::string list;
  for (const GridArray& array : arrays) {
    list += (list.empty() ? "" : ", ") + array.name + (array.place == Place::kPoints ? " (points" : " (cells");
    list += array.components > 1 ? ", " + std::to_string(array.components) + " components)" : ")";
  }
  return list;
}

}  // namespace

GridArrays::GridArrays(const std::vector<vtkSmartPointer<vtkDataSet>>& blocks, const GridReadOptions& options)
    : component_(options.component) {
  for (const Place place : {Place::kPoints, Place::kCells}) {
    for (vtkDataSet* block : blocks) {
      for (vtkDataArray* array : numbersOf(block, place)) {
        checkLength(array, place == Place::kPoints ? block->GetNumberOfPoints() : block->GetNumberOfCells(), place);
        add(describe(array, place));
      }
    }
  }
  if (all_.empty())
    throw ReadError("holds no scalars: neither its points nor its cells have an array of numbers");
  taken_ = choose(blocks.front(), options);
  if (component_ < GridReadOptions::kMagnitude || component_ >= takenArray().components) {
    throw ReadError("component " + std::to_string(component_) + " of the array " + takenArray().name +
                    " does not exist; it has " + std::to_string(takenArray().components) + ", counted from 0");
  }
}

/// The same array of another block only widens the range.
void GridArrays::add(const GridArray& array) {
  const auto same = std::find_if(all_.begin(), all_.end(), [&](const GridArray& other) {
    return other.name == array.name && other.place == array.place;
  });
  if (same == all_.end()) {
    all_.push_back(array);
    return;
  }
  if (same->components != array.components)
    throw ReadError("the array " + array.name + " appears with different numbers of components");
  same->range = {std::min(same->range[0], array.range[0]), std::max(same->range[1], array.range[1])};
}

std::size_t GridArrays::choose(vtkDataSet* first_block, const GridReadOptions& options) const {
  if (!options.array.empty())
    return named(options.array);
  const std::size_t at_points = active(first_block, Place::kPoints);
  const std::size_t chosen = at_points != kNone ? at_points : active(first_block, Place::kCells);
  return chosen != kNone ? chosen : 0;
}

std::size_t GridArrays::active(vtkDataSet* block, Place place) const {
  vtkDataArray* scalars = attributesOf(block, place)->GetScalars();
  for (std::size_t i = 0; scalars != nullptr && i < all_.size(); ++i) {
    if (all_[i].place == place && all_[i].name == nameOf(scalars))
      return i;
  }
  return kNone;
}

std::size_t GridArrays::named(const std::string& name) const {
  for (const bool exactly : {true, false}) {
    for (std::size_t i = 0; i < all_.size(); ++i) {
      if (exactly ? all_[i].name == name : lowerCase(all_[i].name) == lowerCase(name))
        return i;
    }
  }
  throw ReadError("has no array '" + name + "'; it has " + listOf(all_));
}

vtkDataArray* GridArrays::in(vtkDataSet* block) const {
  for (vtkDataArray* array : numbersOf(block, takenArray().place)) {
    if (nameOf(array) == takenArray().name)
      return array;
  }
  throw ReadError("one of its blocks lacks the array " + takenArray().name + "; choose one that all have");
}

float GridArrays::value(vtkDataArray* array, vtkIdType at) const {
  double value = 0.0;
  if (array->GetNumberOfComponents() == 1 || component_ != GridReadOptions::kMagnitude) {
    value = array->GetComponent(at, std::max(component_, 0));
  } else {
    double squares = 0.0;
    for (int c = 0; c < array->GetNumberOfComponents(); ++c)
      squares += array->GetComponent(at, c) * array->GetComponent(at, c);
    value = std::sqrt(squares);
  }
  const auto single = static_cast<float>(value);
  return std::isfinite(single) ? single : std::numeric_limits<float>::quiet_NaN();
}

}  // namespace soft_volume::core::reader
