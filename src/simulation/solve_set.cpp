#include "solve_set.h"

#include <algorithm>

#include "soft_volume/simulation/prestress.h"

namespace soft_volume::core {
namespace {

template <typename T>
std::size_t bytesOf(const std::vector<T>& values) {
  return values.capacity() * sizeof(T);
}

std::size_t padded(std::size_t count, std::size_t lanes) {
  return (count + lanes - 1) / lanes * lanes;
}

void sortUnique(std::vector<std::uint32_t>& values) {
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
}

/// Blocks with at least one of the vertices, which are increasing.
std::vector<std::uint32_t> blocksOf(const std::vector<std::uint32_t>& vertices, std::size_t lanes) {
  std::vector<std::uint32_t> blocks;
  for (const std::uint32_t v : vertices) {
    const auto block = static_cast<std::uint32_t>(v / lanes);
    if (blocks.empty() || blocks.back() != block)
      blocks.push_back(block);
  }
  return blocks;
}

}  // namespace

template <typename Real>
void SolveSet<Real>::build(const SpringModel& model, const std::vector<std::uint32_t>& active_cells,
                           bool with_frontier) {
  for (std::size_t n = 0; n < kDirections; ++n) {
    for (int d = 0; d < 3; ++d)
      view_.offset[n][d] = static_cast<Real>(model.offsets_m[n][d]);
    view_.length[n] = static_cast<Real>(model.offsets_m[n].norm());
    view_.linear[n] = static_cast<Real>(model.linear[n]);
  }
  numberVertices(model, active_cells, with_frontier);
  numberCells(model.has_volume_energy);
  resizeVertexArrays();
  packRows(model);
  packCells(model);
  makeView(model);
}

template <typename Real>
void SolveSet<Real>::numberVertices(const SpringModel& model, const std::vector<std::uint32_t>& active_cells,
                                    bool with_frontier) {
  const auto fixed = [&](std::uint32_t v) { return isFixed(*lattice_, model.rule, v); };
  constexpr std::uint32_t kMarked = kAbsent - 1;
  for (const std::uint32_t v : vertices_) {
    if (v < local_vertex_.size())
      local_vertex_[v] = kAbsent;
  }
  local_vertex_.resize(lattice_->vertexCount(), kAbsent);
  vertices_.clear();
  const auto add = [&](std::uint32_t v) {
    if (local_vertex_[v] == kAbsent) {
      local_vertex_[v] = kMarked;
      vertices_.push_back(v);
    }
  };
  const auto addAround = [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      if (fixed(vertices_[n]))
        continue;
      index_->forEachCell(vertices_[n], [&](const CellCorner& at) {
        for (const std::uint32_t v : lattice_->cells[at.cell])
          add(v);
      });
    }
  };
  for (const std::uint32_t cell : active_cells) {
    for (const std::uint32_t v : lattice_->cells[cell])
      add(v);
  }
  const std::size_t inside = vertices_.size();
  addAround(0, inside);
  const std::size_t with_ring = vertices_.size();
  if (with_frontier)
    addAround(inside, with_ring);

  std::vector<std::uint32_t> moving, frontier;
  for (std::size_t n = 0; n < with_ring; ++n) {
    if (!fixed(vertices_[n]))
      (n < inside ? moving : frontier).push_back(vertices_[n]);
  }
  sortUnique(vertices_);
  for (std::size_t n = 0; n < vertices_.size(); ++n)
    local_vertex_[vertices_[n]] = static_cast<std::uint32_t>(n);
  const auto localise = [&](std::vector<std::uint32_t>& from, std::vector<std::uint32_t>& to) {
    to.clear();
    for (const std::uint32_t v : from)
      to.push_back(local_vertex_[v]);
    std::sort(to.begin(), to.end());
  };
  localise(moving, moving_);
  if (!with_frontier)
    frontier.clear();
  localise(frontier, frontier_);
  moving_blocks_ = blocksOf(moving_, kLanes<Real>);
  frontier_blocks_ = blocksOf(frontier_, kLanes<Real>);
}

template <typename Real>
void SolveSet<Real>::numberCells(bool with_volume_energy) {
  for (const std::uint32_t cell : cells_) {
    if (cell != kAbsent)
      local_cell_[cell] = kAbsent;
  }
  local_cell_.resize(lattice_->cellCount(), kAbsent);
  cells_.clear();
  const auto addCells = [&](const std::vector<std::uint32_t>& vertices) {
    const std::size_t before = cells_.size();
    for (const std::uint32_t v : vertices) {
      index_->forEachCell(vertices_[v], [&](const CellCorner& at) {
        if (local_cell_[at.cell] == kAbsent) {
          local_cell_[at.cell] = 0;
          cells_.push_back(at.cell);
        }
      });
    }
    std::sort(cells_.begin() + static_cast<std::ptrdiff_t>(before), cells_.end());
  };
  addCells(moving_);
  guarded_cells_ = cells_.size();
  // The cells of the frontier follow in blocks of their own; they only push back by their volume.
  cells_.resize(padded(cells_.size(), kLanes<Real>), kAbsent);
  if (with_volume_energy)
    addCells(frontier_);
  for (std::size_t n = 0; n < cells_.size(); ++n) {
    if (cells_[n] != kAbsent)
      local_cell_[cells_[n]] = static_cast<std::uint32_t>(n);
  }
}

template <typename Real>
void SolveSet<Real>::resizeVertexArrays() {
  // One block more than needed: a contiguous load may start in the last block.
  const std::size_t size = padded(vertices_.size(), kLanes<Real>) + kLanes<Real>;
  for (auto* arrays : {displacement_, velocity_, force_, move_, external_}) {
    for (int d = 0; d < 3; ++d)
      arrays[d].assign(size, Real(0));
  }
  for (auto* array : {&nearest_squared_, &move_squared_, &mass_, &inverse_mass_, &damping_rate_, &vertex_stiffness_})
    array->assign(size, Real(0));
}

template <typename Real>
void SolveSet<Real>::packRows(const SpringModel& model) {
  const std::size_t blocks = padded(vertices_.size(), kLanes<Real>) / kLanes<Real>;
  entries_.clear();
  stiffness_.clear();
  indices_.clear();
  stretched_.clear();
  entry_begin_.assign(1, 0);
  std::vector<std::uint8_t> has_row(vertices_.size(), 0);
  for (const std::uint32_t v : frontier_)
    has_row[v] = 1;
  for (const std::uint32_t v : moving_)
    has_row[v] = 2;
  std::vector<VertexRow> rows(kLanes<Real>);
  for (std::uint32_t block = 0; block < blocks; ++block) {
    for (std::size_t lane = 0; lane < kLanes<Real>; ++lane) {
      const std::size_t v = block * kLanes<Real> + lane;
      rows[lane].springs.clear();
      if (v >= vertices_.size() || has_row[v] == 0)
        continue;
      makeRow(*lattice_, *index_, model, vertices_[v], rows[lane]);
      mass_[v] = static_cast<Real>(rows[lane].mass_kg);
      inverse_mass_[v] = has_row[v] == 2 ? static_cast<Real>(1.0 / rows[lane].mass_kg) : Real(0);
      damping_rate_[v] = static_cast<Real>(rows[lane].damping_rate_per_s);
      vertex_stiffness_[v] = static_cast<Real>(rows[lane].stiffness_n_m());
    }
    packBlock(model, block, rows);
    entry_begin_.push_back(static_cast<std::uint32_t>(entries_.size()));
  }
}

template <typename Real>
void SolveSet<Real>::packBlock(const SpringModel& model, std::uint32_t block, const std::vector<VertexRow>& rows) {
  std::vector<std::size_t> next(kLanes<Real>, 0);
  std::vector<const MergedSpring*> springs(kLanes<Real>);
  for (std::uint8_t direction = 0; direction < kDirections; ++direction) {
    // Beside an incision a vertex may have two neighbours in one direction: they take an entry each.
    for (bool any = true; any;) {
      any = false;
      for (std::size_t lane = 0; lane < kLanes<Real>; ++lane) {
        const VertexRow& row = rows[lane];
        const MergedSpring* spring = next[lane] < row.springs.size() ? &row.springs[next[lane]] : nullptr;
        springs[lane] = spring != nullptr && spring->direction == direction ? spring : nullptr;
        next[lane] += springs[lane] != nullptr ? 1 : 0;
        any = any || springs[lane] != nullptr;
      }
      if (any)
        addEntry(model, block, direction, springs);
    }
  }
}

template <typename Real>
void SolveSet<Real>::addStiffness(const std::vector<const MergedSpring*>& springs, SpringEntry& entry) {
  entry.stiffness = static_cast<std::uint32_t>(stiffness_.size());
  const auto of = [](const MergedSpring* spring) {
    return spring != nullptr ? static_cast<Real>(spring->stiffness_n_m) : Real(0);
  };
  entry.uniform = std::all_of(springs.begin(), springs.end(),
                              [&](const MergedSpring* spring) { return of(spring) == of(springs[0]); });
  for (std::size_t lane = 0; lane < (entry.uniform ? 1 : springs.size()); ++lane)
    stiffness_.push_back(of(springs[lane]));
}

template <typename Real>
void SolveSet<Real>::addEntry(const SpringModel& model, std::uint32_t block, std::uint8_t direction,
                              const std::vector<const MergedSpring*>& springs) {
  const std::size_t size = displacement_[0].size();
  const bool edge =
      direction == 4 || direction == 10 || direction == 12 || direction == 14 || direction == 16 || direction == 22;
  SpringEntry entry = {};
  entry.stretched = SpringEntry::kUnstretched;
  entry.direction = direction;
  entry.edge = edge;
  entry.contiguous = 1;
  std::int64_t first = -1;
  bool stretched = false;
  for (std::size_t lane = 0; lane < springs.size(); ++lane) {
    if (springs[lane] == nullptr)
      continue;
    const std::int64_t base = std::int64_t(local_vertex_[springs[lane]->neighbour]) - std::int64_t(lane);
    entry.contiguous = entry.contiguous && base >= 0 && (first < 0 || base == first) ? 1 : 0;
    first = base;
    stretched = stretched || springs[lane]->stretched;
  }
  if (entry.contiguous && std::size_t(first) + kLanes<Real> <= size) {
    entry.index = static_cast<std::uint32_t>(first);
  } else {
    entry.contiguous = 0;
    entry.index = static_cast<std::uint32_t>(indices_.size());
    for (std::size_t lane = 0; lane < springs.size(); ++lane) {
      indices_.push_back(springs[lane] != nullptr ? local_vertex_[springs[lane]->neighbour]
                                                  : static_cast<std::uint32_t>(block * kLanes<Real> + lane));
    }
  }
  addStiffness(springs, entry);
  if (stretched) {
    entry.stretched = static_cast<std::uint32_t>(stretched_.size());
    const double rest = model.offsets_m[direction].norm();
    for (const MergedSpring* spring : springs)
      stretched_.push_back(static_cast<Real>(spring != nullptr ? spring->rest_length_m : rest));
    for (const MergedSpring* spring : springs) {
      const double length = spring != nullptr ? spring->rest_length_m : rest;
      stretched_.push_back(static_cast<Real>(rest * rest - length * length));
    }
  }
  entries_.push_back(entry);
}

template <typename Real>
void SolveSet<Real>::packCells(const SpringModel& model) {
  const std::size_t stride = padded(cells_.size(), kLanes<Real>) + kLanes<Real>;  // the last block stays empty
  view_.cell_stride = stride;
  corners_.assign(8 * stride, 0);
  for (int c = 0; c < 8; ++c) {
    for (std::size_t n = 0; n < cells_.size(); ++n) {
      if (cells_[n] != kAbsent)
        corners_[c * stride + n] = local_vertex_[lattice_->cells[cells_[n]][static_cast<std::size_t>(c)]];
    }
  }
  const std::size_t blocks = stride / kLanes<Real>;
  cells_contiguous_.assign(blocks, 1);
  for (std::size_t block = 0; block < blocks; ++block) {
    for (std::size_t at = 0; at < 8 * kLanes<Real>; ++at) {
      const std::uint32_t* index = &corners_[at / kLanes<Real> * stride + block * kLanes<Real>];
      if (index[at % kLanes<Real>] != index[0] + at % kLanes<Real>)
        cells_contiguous_[block] = 0;
    }
  }
  width_bound_.assign(stride, Real(-1));
  volume_modulus_.clear();
  volume_stretch_.clear();
  corner_force_.clear();
  cell_of_.clear();
  more_begin_.clear();
  more_cells_.clear();
  if (!model.has_volume_energy)
    return;
  volume_modulus_.assign(stride, Real(0));
  volume_stretch_.assign(stride, Real(1));
  for (std::size_t n = 0; n < cells_.size(); ++n) {
    if (cells_[n] == kAbsent)
      continue;
    volume_modulus_[n] =
        static_cast<Real>(lattice_->shares[cells_[n]] * model.materials[lattice_->materials[cells_[n]]].volume_pa);
    double stretch = lattice_->rest_stretch[cells_[n]].prod();
    if (!model.prestress.empty())
      stretch *= model.prestress.volume(*lattice_, cells_[n]);
    volume_stretch_[n] = static_cast<Real>(stretch);
  }
  corner_force_.assign(24 * stride, Real(0));
  packCellsOfVertices();
}

template <typename Real>
void SolveSet<Real>::packCellsOfVertices() {
  const std::size_t vertex_stride = displacement_[0].size();
  const auto place = [](std::size_t cell) {
    return static_cast<std::uint32_t>(cell / kLanes<Real> * 24 * kLanes<Real> + cell % kLanes<Real>);
  };
  const std::uint32_t empty = place(view_.cell_stride - 1);
  cell_of_.assign(8 * vertex_stride, empty);
  more_.clear();
  for (const auto* list : {&moving_, &frontier_}) {
    for (const std::uint32_t v : *list) {
      index_->forEachCell(vertices_[v], [&](const CellCorner& at) {
        std::uint32_t& slot = cell_of_[at.corner * vertex_stride + v];
        const std::uint32_t cell = place(local_cell_[at.cell]);
        if (slot == empty)
          slot = cell;
        else
          more_.push_back({v, cell + 3U * at.corner * static_cast<std::uint32_t>(kLanes<Real>)});
      });
    }
  }
  if (!more_.empty())
    packMoreCells(empty);
}

/// Rows of one cell more for each vertex of a block.
template <typename Real>
void SolveSet<Real>::packMoreCells(std::uint32_t empty) {
  constexpr std::size_t lanes = kLanes<Real>;
  // A vertex's cells stay in the order of the lattice, whatever else is in the solve: sums have the same bits.
  std::stable_sort(more_.begin(), more_.end(), [](const auto& a, const auto& b) { return a[0] < b[0]; });
  more_begin_.assign(1, 0);
  std::size_t n = 0;
  for (std::size_t block = 0; block < padded(vertices_.size(), lanes) / lanes; ++block) {
    std::array<std::size_t, lanes> row;
    row.fill(more_cells_.size() / lanes);
    for (; n < more_.size() && more_[n][0] / lanes == block; ++n) {
      const std::size_t lane = more_[n][0] % lanes;
      more_cells_.resize(std::max(more_cells_.size(), (row[lane] + 1) * lanes), empty);
      more_cells_[row[lane]++ * lanes + lane] = more_[n][1];
    }
    more_begin_.push_back(static_cast<std::uint32_t>(more_cells_.size() / lanes));
  }
}

template <typename Real>
void SolveSet<Real>::makeView(const SpringModel& model) {
  for (int d = 0; d < 3; ++d) {
    view_.displacement[d] = displacement_[d].data();
    view_.velocity[d] = velocity_[d].data();
    view_.force[d] = force_[d].data();
    view_.move[d] = move_[d].data();
    view_.external[d] = external_[d].data();
    view_.spacing[d] = static_cast<Real>(lattice_->spacing_m[d]);
  }
  view_.nearest_squared = nearest_squared_.data();
  view_.move_squared = move_squared_.data();
  view_.mass = mass_.data();
  view_.inverse_mass = inverse_mass_.data();
  view_.damping_rate = damping_rate_.data();
  view_.entry_begin = entry_begin_.data();
  view_.entries = entries_.data();
  view_.stiffness = stiffness_.data();
  view_.indices = indices_.data();
  view_.stretched = stretched_.data();
  view_.corners = corners_.data();
  view_.cells_contiguous = cells_contiguous_.data();
  view_.width_bound = width_bound_.data();
  view_.volume_modulus = model.has_volume_energy ? volume_modulus_.data() : nullptr;
  view_.volume_stretch = volume_stretch_.data();
  view_.corner_force = model.has_volume_energy ? corner_force_.data() : nullptr;
  view_.cell_of = cell_of_.data();
  view_.more_begin = more_begin_.empty() ? nullptr : more_begin_.data();
  view_.more_cells = more_cells_.data();
  view_.vertex_stride = displacement_[0].size();
}

template <typename Real>
std::size_t SolveSet<Real>::vertexBytes() const {
  std::size_t bytes = bytesOf(local_vertex_) + bytesOf(vertices_) + bytesOf(moving_) + bytesOf(frontier_);
  for (const auto* arrays : {displacement_, velocity_, force_, move_, external_}) {
    for (int d = 0; d < 3; ++d)
      bytes += bytesOf(arrays[d]);
  }
  for (const auto* array :
       {&nearest_squared_, &move_squared_, &mass_, &inverse_mass_, &damping_rate_, &vertex_stiffness_})
    bytes += bytesOf(*array);
  return bytes;
}

template <typename Real>
std::size_t SolveSet<Real>::springBytes() const {
  return bytesOf(entry_begin_) + bytesOf(entries_) + bytesOf(stiffness_) + bytesOf(indices_);
}

template <typename Real>
std::size_t SolveSet<Real>::cellBytes() const {
  return bytesOf(local_cell_) + bytesOf(cells_) + bytesOf(corners_) + bytesOf(cells_contiguous_) +
         bytesOf(width_bound_);
}

template <typename Real>
std::size_t SolveSet<Real>::volumeEnergyBytes() const {
  return bytesOf(volume_modulus_) + bytesOf(volume_stretch_) + bytesOf(corner_force_) + bytesOf(cell_of_) +
         bytesOf(more_) + bytesOf(more_begin_) + bytesOf(more_cells_);
}

template class SolveSet<float>;
template class SolveSet<double>;

}  // namespace soft_volume::core
