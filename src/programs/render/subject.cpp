#include "subject.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/grid_reader.h"
#include "soft_volume/grid/volume_grid.h"
#include "soft_volume/volume/volume_reader.h"
#include "view.h"

namespace soft_volume::core::render_program {
namespace {

/// So many voxels make a cell of a volume's texture, so that transparent parts can be skipped.
constexpr int kCellVoxels = 16;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return text;
}

bool isVolume(const std::string& path) {
  if (std::filesystem::is_directory(path))
    return true;
  const std::string name = lower(path);
  const auto ends = [&name](const std::string& suffix) {
    return name.size() > suffix.size() && name.compare(name.size() - suffix.size(), suffix.size(), suffix) == 0;
  };
  const std::array<const char*, 7> suffixes = {".nii", ".nii.gz", ".nrrd", ".nhdr", ".mhd", ".mha", ".vti"};
  return std::any_of(suffixes.begin(), suffixes.end(), ends);
}

/// Hounsfield units go far below 0 and above what other signed data reach.
bool looksLikeCt(const std::array<double, 2>& range) {
  return range[0] < -200.0 && range[1] > 200.0 && range[1] < 40000.0;
}

nlohmann::json boxJson(const Box3& box) {
  const auto list = [](const Vector3& p) { return nlohmann::json{p.x(), p.y(), p.z()}; };
  return {{"min", list(box.min())}, {"max", list(box.max())}};
}

nlohmann::json volumeFacts(const Volume& volume, const std::array<double, 2>& range) {
  const VolumeGeometry& g = volume.geometry();
  return {{"kind", "volume"},
          {"dims", {g.dims.x(), g.dims.y(), g.dims.z()}},
          {"spacing_m", {g.spacing_m.x(), g.spacing_m.y(), g.spacing_m.z()}},
          {"type", scalarName(volume.type())},
          {"range", range}};
}

const char* cellName(CellType type) {
  switch (type) {
    case CellType::kEmpty:
      return "empty cells";
    case CellType::kTetrahedron:
      return "tetrahedra";
    case CellType::kVoxel:
      return "voxels";
    case CellType::kHexahedron:
      return "hexahedra";
    case CellType::kWedge:
      return "wedges";
    case CellType::kPyramid:
      return "pyramids";
    case CellType::kPolyhedron:
      return "polyhedra";
  }
  return "other";
}

nlohmann::json gridFacts(const IrregularGrid& grid) {
  std::map<std::string, std::size_t> types;
  for (const CellType type : grid.cell_types)
    ++types[cellName(type)];
  return {{"cells", grid.cellCount()}, {"vertices", grid.vertexCount()}, {"cell_types", types}};
}

std::array<double, 2> finiteRange(const IrregularGrid& grid) {
  std::array<double, 2> range{HUGE_VAL, -HUGE_VAL};
  for (const float scalar : grid.point_scalars.empty() ? grid.cell_scalars : grid.point_scalars) {
    if (std::isfinite(scalar))
      range = {std::min<double>(range[0], scalar), std::max<double>(range[1], scalar)};
  }
  return range[0] <= range[1] ? range : std::array<double, 2>{0.0, 0.0};
}

GridFile openGrid(const Arguments& arguments) {
  GridReadOptions options;
  options.array = arguments.array;
  options.component = arguments.component < 0 ? GridReadOptions::kMagnitude : arguments.component;
  options.solution = arguments.solution;
  return readGrid(arguments.files.front(), options);
}

void takeGrid(IrregularGrid grid, Subject& subject) {
  subject.grid = std::move(grid);
  subject.bounds = boundsOf(subject.grid.points);
  subject.facts.update(gridFacts(subject.grid));
}

Subject gridSubject(const Arguments& arguments) {
  if (arguments.mode == Mode::kTexture)
    throw InputError("--mode texture is for volumes; a grid's scalars are drawn with scalar or colour");
  GridFile file = openGrid(arguments);
  const GridArray& taken = file.arrays.at(file.taken);
  Subject subject;
  subject.default_transfer_function = "viridis";
  subject.range = finiteRange(file.grid);
  subject.facts = {{"kind", "grid"},
                   {"array", taken.name},
                   {"at", taken.place == GridArray::Place::kPoints ? "points" : "cells"},
                   {"range", subject.range}};
  for (const std::string& note : file.notes)
    std::fprintf(stderr, "note: %s\n", note.c_str());
  subject.facts["notes"] = file.notes;
  takeGrid(std::move(file.grid), subject);
  return subject;
}

void checkVolumeArguments(const Arguments& arguments) {
  if (!arguments.array.empty() || arguments.component >= 0 || !arguments.solution.empty())
    throw InputError(arguments.files.front() +
                     ": is a volume, which has one array; --array, --component and a solution are for grids");
}

Subject volumeSubject(const Arguments& arguments) {
  checkVolumeArguments(arguments);
  Subject subject;
  const auto volume = std::make_shared<const Volume>(readVolume(arguments.files.front()));
  subject.range = volume->range();
  subject.bounds = volume->geometry().bounds();
  subject.view = patientView(volume->geometry());
  subject.shading = 0.7;
  subject.slices = 400;
  subject.default_transfer_function = looksLikeCt(subject.range) ? "ct_skin" : "mri_t1_head";
  subject.facts = volumeFacts(*volume, subject.range);
  if (arguments.mode.value_or(Mode::kTexture) == Mode::kTexture)
    subject.volume = volume;
  else
    takeGrid(gridOf(*volume), subject);
  return subject;
}

void printRange(const std::array<double, 2>& range) {
  std::printf("from %g to %g", range[0], range[1]);
}

void listVolume(const Arguments& arguments) {
  const Volume volume = readVolume(arguments.files.front());
  const VolumeGeometry& g = volume.geometry();
  std::printf("volume of %d x %d x %d voxels, %g x %g x %g mm, %s, ", g.dims.x(), g.dims.y(), g.dims.z(),
              1e3 * g.spacing_m.x(), 1e3 * g.spacing_m.y(), 1e3 * g.spacing_m.z(), scalarName(volume.type()).c_str());
  printRange(volume.range());
  std::printf("\n");
}

}  // namespace

Subject readSubject(const Arguments& arguments) {
  Subject subject = isVolume(arguments.files.front()) ? volumeSubject(arguments) : gridSubject(arguments);
  if (!arguments.labels.empty())
    subject.labels = std::make_shared<const Volume>(readVolume(arguments.labels));
  subject.facts["file"] = arguments.files.front();
  subject.facts["bounds"] = boxJson(subject.bounds);
  return subject;
}

void listArrays(const Arguments& arguments) {
  if (isVolume(arguments.files.front())) {
    listVolume(arguments);
    return;
  }
  const GridFile file = openGrid(arguments);
  std::printf("grid of %zu cells and %zu vertices:", file.grid.cellCount(), file.grid.vertexCount());
  const nlohmann::json types = gridFacts(file.grid)["cell_types"];
  for (const auto& [name, count] : types.items())
    std::printf(" %llu %s", count.get<unsigned long long>(), name.c_str());
  std::printf("\n");
  for (std::size_t n = 0; n < file.arrays.size(); ++n) {
    const GridArray& array = file.arrays[n];
    std::printf("%c %-24s at %s, %d component%s, ", n == file.taken ? '*' : ' ', array.name.c_str(),
                array.place == GridArray::Place::kPoints ? "points" : "cells", array.components,
                array.components == 1 ? "" : "s");
    printRange(array.range);
    std::printf("\n");
  }
  for (const std::string& note : file.notes)
    std::printf("note: %s\n", note.c_str());
}

void showSubject(const Subject& subject, Renderer& renderer) {
  if (subject.volume) {
    renderer.setVolume(subject.volume);
    renderer.setTopology(volumeTopology(subject.volume->geometry(), kCellVoxels));
  } else {
    renderer.setGrid(subject.grid);
  }
  if (subject.labels)
    renderer.setLabels(subject.labels);
}

}  // namespace soft_volume::core::render_program
