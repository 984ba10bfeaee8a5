#include "grid_cells.h"

#include <vtkCellArray.h>
#include <vtkCellType.h>
#include <vtkDataSetAttributes.h>
#include <vtkGenericCell.h>
#include <vtkIdList.h>
#include <vtkIdTypeArray.h>
#include <vtkImageData.h>
#include <vtkMatrix3x3.h>
#include <vtkNew.h>
#include <vtkRectilinearGrid.h>
#include <vtkStructuredGrid.h>
#include <vtkUnsignedCharArray.h>
#include <vtkUnstructuredGrid.h>

#include <algorithm>
#include <array>
#include <limits>
#include <utility>

#include "face_stream.h"
#include "image.h"

namespace soft_volume::core::reader {
namespace {

constexpr std::uint64_t kMostNumbers = std::numeric_limits<std::uint32_t>::max();
constexpr int kGhostCell =
    vtkDataSetAttributes::DUPLICATECELL | vtkDataSetAttributes::HIDDENCELL | vtkDataSetAttributes::REFINEDCELL;

enum class Fate { kKept, kLinearised, kFaces, kFaceStream, kFlat, kShapeless, kUnknown };

/// What becomes of a VTK cell type. Cells of higher order list their corners first, in the order of the linear type.
struct TypeRule {
  Fate fate = Fate::kUnknown;
  CellType type = CellType::kPolyhedron;
  vtkIdType corners = 0;
  const char* plural = "";  ///< for notes and errors
};

using TypeRules = std::array<TypeRule, 256>;

void setCurved(TypeRules& rules) {
  const auto set = [&rules](int vtk_type, CellType type, const char* plural) {
    const vtkIdType corners = type == CellType::kTetrahedron ? 4
                              : type == CellType::kPyramid   ? 5
                              : type == CellType::kWedge     ? 6
                                                             : 8;
    rules[std::size_t(vtk_type)] = {Fate::kLinearised, type, corners, plural};
  };
  set(VTK_QUADRATIC_TETRA, CellType::kTetrahedron, "quadratic tetrahedra");
  set(VTK_HIGHER_ORDER_TETRAHEDRON, CellType::kTetrahedron, "higher-order tetrahedra");
  set(VTK_LAGRANGE_TETRAHEDRON, CellType::kTetrahedron, "Lagrange tetrahedra");
  set(VTK_BEZIER_TETRAHEDRON, CellType::kTetrahedron, "Bezier tetrahedra");
  set(VTK_QUADRATIC_HEXAHEDRON, CellType::kHexahedron, "quadratic hexahedra");
  set(VTK_TRIQUADRATIC_HEXAHEDRON, CellType::kHexahedron, "triquadratic hexahedra");
  set(VTK_BIQUADRATIC_QUADRATIC_HEXAHEDRON, CellType::kHexahedron, "biquadratic-quadratic hexahedra");
  set(VTK_HIGHER_ORDER_HEXAHEDRON, CellType::kHexahedron, "higher-order hexahedra");
  set(VTK_LAGRANGE_HEXAHEDRON, CellType::kHexahedron, "Lagrange hexahedra");
  set(VTK_BEZIER_HEXAHEDRON, CellType::kHexahedron, "Bezier hexahedra");
  set(VTK_QUADRATIC_WEDGE, CellType::kWedge, "quadratic wedges");
  set(VTK_QUADRATIC_LINEAR_WEDGE, CellType::kWedge, "quadratic-linear wedges");
  set(VTK_BIQUADRATIC_QUADRATIC_WEDGE, CellType::kWedge, "biquadratic-quadratic wedges");
  set(VTK_HIGHER_ORDER_WEDGE, CellType::kWedge, "higher-order wedges");
  set(VTK_LAGRANGE_WEDGE, CellType::kWedge, "Lagrange wedges");
  set(VTK_BEZIER_WEDGE, CellType::kWedge, "Bezier wedges");
  set(VTK_QUADRATIC_PYRAMID, CellType::kPyramid, "quadratic pyramids");
  set(VTK_TRIQUADRATIC_PYRAMID, CellType::kPyramid, "triquadratic pyramids");
  set(VTK_HIGHER_ORDER_PYRAMID, CellType::kPyramid, "higher-order pyramids");
  set(VTK_LAGRANGE_PYRAMID, CellType::kPyramid, "Lagrange pyramids");
  set(VTK_BEZIER_PYRAMID, CellType::kPyramid, "Bezier pyramids");
}

TypeRules makeRules() {
  TypeRules rules;
  rules[VTK_TETRA] = {Fate::kKept, CellType::kTetrahedron, 4, "tetrahedra"};
  rules[VTK_VOXEL] = {Fate::kKept, CellType::kVoxel, 8, "voxels"};
  rules[VTK_HEXAHEDRON] = {Fate::kKept, CellType::kHexahedron, 8, "hexahedra"};
  rules[VTK_WEDGE] = {Fate::kKept, CellType::kWedge, 6, "wedges"};
  rules[VTK_PYRAMID] = {Fate::kKept, CellType::kPyramid, 5, "pyramids"};
  rules[VTK_POLYHEDRON] = {Fate::kFaceStream, CellType::kPolyhedron, 0, "polyhedra"};
  rules[VTK_PENTAGONAL_PRISM] = {Fate::kFaces, CellType::kPolyhedron, 10, "pentagonal prisms"};
  rules[VTK_HEXAGONAL_PRISM] = {Fate::kFaces, CellType::kPolyhedron, 12, "hexagonal prisms"};
  setCurved(rules);
  for (const int shapeless : {VTK_CONVEX_POINT_SET, VTK_PARAMETRIC_TETRA_REGION, VTK_PARAMETRIC_HEX_REGION})
    rules[std::size_t(shapeless)].fate = Fate::kShapeless;
  for (const int flat : {VTK_EMPTY_CELL,
                         VTK_VERTEX,
                         VTK_POLY_VERTEX,
                         VTK_LINE,
                         VTK_POLY_LINE,
                         VTK_TRIANGLE,
                         VTK_TRIANGLE_STRIP,
                         VTK_POLYGON,
                         VTK_PIXEL,
                         VTK_QUAD,
                         VTK_QUADRATIC_EDGE,
                         VTK_QUADRATIC_TRIANGLE,
                         VTK_QUADRATIC_QUAD,
                         VTK_QUADRATIC_POLYGON,
                         VTK_BIQUADRATIC_QUAD,
                         VTK_QUADRATIC_LINEAR_QUAD,
                         VTK_BIQUADRATIC_TRIANGLE,
                         VTK_CUBIC_LINE,
                         VTK_PARAMETRIC_CURVE,
                         VTK_PARAMETRIC_SURFACE,
                         VTK_PARAMETRIC_TRI_SURFACE,
                         VTK_PARAMETRIC_QUAD_SURFACE,
                         VTK_HIGHER_ORDER_EDGE,
                         VTK_HIGHER_ORDER_TRIANGLE,
                         VTK_HIGHER_ORDER_QUAD,
                         VTK_HIGHER_ORDER_POLYGON,
                         VTK_LAGRANGE_CURVE,
                         VTK_LAGRANGE_TRIANGLE,
                         VTK_LAGRANGE_QUADRILATERAL,
                         VTK_BEZIER_CURVE,
                         VTK_BEZIER_TRIANGLE,
                         VTK_BEZIER_QUADRILATERAL})
    rules[std::size_t(flat)].fate = Fate::kFlat;
  return rules;
}

const TypeRule& ruleOf(int vtk_type) {
  static const TypeRules rules = makeRules();
  return rules[std::size_t(vtk_type & 0xFF)];
}

[[noreturn]] void refuseCell(vtkIdType cell, const std::string& what) {
  throw ReadError("cell " + std::to_string(cell) + " " + what);
}

// --- What VTK's readers do not check, and its cells would follow out of their arrays

template <typename Offsets>
bool areOffsets(Offsets* offsets, vtkIdType connectivity) {
  const auto* begin = offsets->GetPointer(0);
  const auto* end = begin + offsets->GetNumberOfValues();
  return begin != end && *begin == 0 && std::is_sorted(begin, end) && *(end - 1) <= connectivity;
}

void checkUnstructured(vtkUnstructuredGrid* grid) {
  vtkCellArray* cells = grid->GetCells();
  if (cells == nullptr || grid->GetCellTypesArray() == nullptr)
    return;  // no cells at all
  const vtkIdType numbers = cells->GetConnectivityArray()->GetNumberOfValues();
  const bool good = cells->IsStorage64Bit() ? areOffsets(cells->GetOffsetsArray64(), numbers)
                                            : areOffsets(cells->GetOffsetsArray32(), numbers);
  if (!good)
    throw ReadError("the offsets of its cells are damaged: they decrease or lead out of the connectivity");
  if (grid->GetCellTypesArray()->GetNumberOfValues() != cells->GetNumberOfCells())
    throw ReadError("has not one type for every cell");
}

void checkPointCount(double held, const int* dims) {
  if (held != double(dims[0]) * double(dims[1]) * double(dims[2]))
    throw ReadError("has another number of points than its dimensions claim");
}

void checkBlock(vtkDataSet* block) {
  if (auto* unstructured = vtkUnstructuredGrid::SafeDownCast(block))
    checkUnstructured(unstructured);
  if (auto* structured = vtkStructuredGrid::SafeDownCast(block))
    checkPointCount(double(structured->GetNumberOfPoints()), structured->GetDimensions());
  if (auto* rectilinear = vtkRectilinearGrid::SafeDownCast(block)) {
    checkPointCount(double(rectilinear->GetXCoordinates()->GetNumberOfTuples()) *
                        double(rectilinear->GetYCoordinates()->GetNumberOfTuples()) *
                        double(rectilinear->GetZCoordinates()->GetNumberOfTuples()),
                    rectilinear->GetDimensions());
  }
  if (std::uint64_t(block->GetNumberOfPoints()) >= kMostNumbers)
    throw ReadError("has more than four thousand million points");
}

/// The boxes of a regular grid are voxels unless it is turned; those of a rectilinear grid become hexahedra as those of
/// curvilinear ones are.
bool keepsVoxels(vtkDataSet* block) {
  auto* image = vtkImageData::SafeDownCast(block);
  return vtkUnstructuredGrid::SafeDownCast(block) != nullptr ||
         (image != nullptr && image->GetDirectionMatrix()->IsIdentity());
}

/// Takes the cells of one block one after the other.
class CellCollector {
 public:
  CellCollector(vtkDataSet* block, CellTally& tally)
      : block_(block),
        unstructured_(vtkUnstructuredGrid::SafeDownCast(block)),
        keeps_voxels_(keepsVoxels(block)),
        cell_ghosts_(marks(block->GetCellGhostArray(), block->GetNumberOfCells())),
        point_ghosts_(marks(block->GetPointGhostArray(), block->GetNumberOfPoints())),
        tally_(tally) {}

  void add(vtkIdType cell) {
    if (cell_ghosts_ != nullptr && (cell_ghosts_[cell] & kGhostCell) != 0) {
      ++tally_.hidden;
      return;
    }
    const int vtk_type = block_->GetCellType(cell);
    const TypeRule& rule = ruleOf(vtk_type);
    switch (rule.fate) {
      case Fate::kUnknown:
        refuseCell(cell, "is of the type " + std::to_string(vtk_type) + ", which VTK does not define");
      case Fate::kFlat:
        ++(isBlanked(vtk_type) ? tally_.hidden : tally_.flat);
        return;
      case Fate::kShapeless:
        ++tally_.shapeless;
        return;
      case Fate::kFaceStream:
        return addPolyhedron(cell, storedFaces(cell));
      case Fate::kFaces:
      case Fate::kLinearised:
      case Fate::kKept:
        return addByVertices(cell, vtk_type, rule);
    }
  }

  BlockCells take() { return std::move(cells_); }

 private:
  static const unsigned char* marks(vtkUnsignedCharArray* array, vtkIdType count) {
    return array != nullptr && array->GetNumberOfValues() == count ? array->GetPointer(0) : nullptr;
  }

  /// Structured grids call a cell empty when it or one of its points is blanked.
  bool isBlanked(int vtk_type) const { return vtk_type == VTK_EMPTY_CELL && unstructured_ == nullptr; }

  bool isHidden(vtkIdType point) const {
    return point_ghosts_ != nullptr && (point_ghosts_[point] & vtkDataSetAttributes::HIDDENPOINT) != 0;
  }

  std::uint32_t checkedVertex(vtkIdType cell, vtkIdType vertex) const {
    if (vertex < 0 || vertex >= block_->GetNumberOfPoints()) {
      refuseCell(cell, "names point " + std::to_string(vertex) + " of a grid with " +
                           std::to_string(block_->GetNumberOfPoints()) + " points");
    }
    return static_cast<std::uint32_t>(vertex);
  }

  void addByVertices(vtkIdType cell, int vtk_type, const TypeRule& rule) {
    block_->GetCellPoints(cell, vertices_);
    const vtkIdType count = vertices_->GetNumberOfIds();
    if (count < rule.corners || (rule.fate != Fate::kLinearised && count != rule.corners)) {
      refuseCell(cell, "has " + std::to_string(count) + " vertices where " + rule.plural + " have " +
                           std::to_string(rule.corners));
    }
    bool hidden = false;
    for (vtkIdType i = 0; i < count; ++i)
      hidden |= isHidden(checkedVertex(cell, vertices_->GetId(i)));
    if (hidden) {
      ++tally_.hidden;
    } else if (rule.fate == Fate::kFaces) {
      addPolyhedron(cell, facesOf(cell));
    } else {
      tally_.linearised[vtk_type] += rule.fate == Fate::kLinearised ? 1 : 0;
      addCorners(cell, rule);
    }
  }

  void addCorners(vtkIdType cell, const TypeRule& rule) {
    const std::size_t begin = cells_.connectivity.size();
    for (vtkIdType i = 0; i < rule.corners; ++i)
      cells_.connectivity.push_back(static_cast<std::uint32_t>(vertices_->GetId(i)));
    if (rule.type == CellType::kVoxel && !keeps_voxels_) {
      std::swap(cells_.connectivity[begin + 2], cells_.connectivity[begin + 3]);
      std::swap(cells_.connectivity[begin + 6], cells_.connectivity[begin + 7]);
      return endCell(cell, CellType::kHexahedron);
    }
    endCell(cell, rule.type);
  }

  void addPolyhedron(vtkIdType cell, Faces faces) {
    for (const auto& face : faces) {
      if (std::any_of(face.begin(), face.end(), [this](std::uint32_t v) { return isHidden(v); })) {
        ++tally_.hidden;
        return;
      }
    }
    const auto point = [this](std::uint32_t vertex) {
      Vector3 place;
      block_->GetPoint(vertex, place.data());
      return place;
    };
    if (!closeFaces(faces, point)) {
      ++tally_.open;
      return;
    }
    appendFaceStream(faces, cells_.connectivity);
    endCell(cell, CellType::kPolyhedron);
  }

  void endCell(vtkIdType cell, CellType type) {
    if (cells_.connectivity.size() > kMostNumbers)
      throw ReadError("has more cells than the 32-bit numbers of this program can name; split it");
    cells_.types.push_back(type);
    cells_.ends.push_back(static_cast<std::uint32_t>(cells_.connectivity.size()));
    cells_.numbers.push_back(cell);
  }

  /// Of a prism, from VTK's own table.
  Faces facesOf(vtkIdType cell) {
    block_->GetCell(cell, generic_cell_);
    Faces faces(static_cast<std::size_t>(generic_cell_->GetNumberOfFaces()));
    for (std::size_t f = 0; f < faces.size(); ++f) {
      vtkIdList* vertices = generic_cell_->GetFace(static_cast<int>(f))->GetPointIds();
      for (vtkIdType i = 0; i < vertices->GetNumberOfIds(); ++i)
        faces[f].push_back(static_cast<std::uint32_t>(vertices->GetId(i)));
    }
    return faces;
  }

  /// Of a polyhedron, from its face stream, which may be cut off or lead anywhere.
  Faces storedFaces(vtkIdType cell) const {
    vtkIdTypeArray* stream = unstructured_ != nullptr ? unstructured_->GetFaces() : nullptr;
    vtkIdTypeArray* begins = unstructured_ != nullptr ? unstructured_->GetFaceLocations() : nullptr;
    if (stream == nullptr || begins == nullptr || begins->GetNumberOfValues() <= cell)
      refuseCell(cell, "is a polyhedron without faces");
    vtkIdType at = begins->GetValue(cell);
    const auto next = [&] {
      if (at < 0 || at >= stream->GetNumberOfValues())
        refuseCell(cell, "is a polyhedron whose faces lead out of the file's list of faces");
      return stream->GetValue(at++);
    };
    Faces faces;
    for (vtkIdType left = next(); left > 0; --left) {
      std::vector<std::uint32_t> face;
      for (vtkIdType corners = next(); corners > 0; --corners)
        face.push_back(checkedVertex(cell, next()));
      faces.push_back(std::move(face));
    }
    return faces;
  }

  vtkDataSet* block_;
  vtkUnstructuredGrid* unstructured_;
  bool keeps_voxels_;
  const unsigned char* cell_ghosts_;
  const unsigned char* point_ghosts_;
  CellTally& tally_;
  vtkNew<vtkIdList> vertices_;
  vtkNew<vtkGenericCell> generic_cell_;
  BlockCells cells_;
};

void addNote(std::vector<std::string>& notes, std::size_t count, const std::string& text) {
  if (count > 0)
    notes.push_back(std::to_string(count) + " " + text);
}

}  // namespace

std::vector<std::string> CellTally::notes() const {
  std::vector<std::string> notes;
  for (const auto& [vtk_type, count] : linearised)
    addNote(notes, count, std::string(ruleOf(vtk_type).plural) + " were linearised: only their corners count");
  addNote(notes, hidden, "blanked or ghost cells were left out");
  addNote(notes, flat, "points, lines or surfaces were left out: only cells with a volume are drawn");
  addNote(notes, open, "polyhedra were left out because their faces do not close");
  addNote(notes, shapeless, "cells without faces (convex point sets) were left out: write them as polyhedra");
  return notes;
}

BlockCells cellsOf(vtkDataSet* block, CellTally& tally) {
  checkBlock(block);
  CellCollector collector(block, tally);
  for (vtkIdType cell = 0; cell < block->GetNumberOfCells(); ++cell)
    collector.add(cell);
  return collector.take();
}

}  // namespace soft_volume::core::reader
