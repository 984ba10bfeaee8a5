#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/tool/surface_cone.h"
#include "soft_volume/tool/trilinear.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// What is at a point of the deformed tissue: finds the deformed cell that a point lies in, maps it through the cell's
/// texture coordinates into the volume and samples the intensity there. This is how a tool touches the volume itself
/// instead of a surface mesh (dissertation, chapter 5: contact straight from the volume).
///
/// Hexahedra and voxels are trilinear. All other cells, polyhedra included, are made of cones (surface_cone.h) over
/// their faces: a quadrilateral shared with a hexahedron is bilinear, any other face is parted into the triangles at
/// its lowest vertex. So both cells of a face give it the same shape and leave no gap; kFaceTolerance of a
/// hexahedron's local coordinates, or of a piece's size, is for rounding alone. A cell with a dent so deep that its
/// centre does not see it reaches over it. Points and velocities are in the volume frame, metres and metres per second.
/// Queries allocate nothing and take no lock; any number of threads may query while none calls anything else.
///
/// Patches come more slowly than a hand feels. So that tissue does not jump from one to the next, a patch can begin
/// from where the one before shows its vertices, and be led to its own places by and by:
///
///     next.update(topology, patch);             // allocates; in any thread
///     next.beginFrom(shown, interval_s);        // allocates nothing; then `next` is what is shown
///     next.advance(dt_s);                       // once per tick; allocates nothing
class PatchContact {
 public:
  static constexpr std::uint32_t kNoCell = 0xffffffffU;
  /// Wide enough that rounding leaves no gap between two cells that share a face, narrow enough that nobody feels it.
  static constexpr double kFaceTolerance = 1e-6;

  /// A point in a cell of the patch.
  struct CellPoint {
    std::uint32_t cell = kNoCell;     ///< index into the patch's cells, not the topology's number
    Vector3 local = Vector3::Zero();  ///< trilinear coordinates in [0, 1]^3, or those of a cone
    std::uint32_t cone = 0;           ///< of the cell's cones
    bool found() const { return cell != kNoCell; }
  };

  /// What is at a point. Outside all cells there is air.
  struct Sample {
    CellPoint at;
    double intensity = 0.0;  ///< in the volume's unit; meaningless outside the cells
    bool tissue = false;     ///< inside a cell, and the intensity is at least the threshold (NaN is air)
  };

  /// Tissue is what has at least `tissue_threshold`, in the volume's own unit. `volume` must not be null or empty.
  PatchContact(std::shared_ptr<const Volume> volume, double tissue_threshold);

  /// Takes the cells of a new patch. Throws InputError and keeps the old patch when the new one does not fit the
  /// topology (session, revision, a number out of range, a cell's vertex that is missing) or is not finite. The
  /// topology must be valid (Topology::validate).
  void update(const Topology& topology, const GridPatch& patch);
  /// Forgets the patch: everything is air.
  void clear();
  /// Starts to move from where `shown` has its vertices now to where the newest patch has them, within `duration_s` >
  /// 0. Vertices of a cut begin where the tissue that they lie in is shown, and any others that `shown` lacks as far
  /// from their places as their neighbours do. Nothing happens when `shown` is empty or of another session. Call once
  /// after update(). The way is a delay, but going ahead by the patch's velocities made 30 patches a second swing.
  void beginFrom(const PatchContact& shown, double duration_s);
  /// Moves on along that way; the tissue rests at its end.
  void advance(double dt_s);

  bool empty() const { return cells_.empty(); }
  double threshold() const { return tissue_threshold_; }
  std::size_t cellCount() const { return cells_.size(); }
  /// Whether a face of the patch's cells, or of one of them, was opened by an incision.
  bool hasCuts() const { return has_cuts_; }
  bool isCut(std::uint32_t cell) const { return cells_[cell].cut; }
  /// Parts of a cell's surface that an incision opened.
  std::uint32_t cutFaceCount(std::uint32_t cell) const;
  /// Revision of the topology that the patch belongs to.
  std::uint32_t revision() const { return revision_; }
  /// Box of the deformed cells; empty without cells.
  const Box3& bounds() const { return bounds_; }
  /// Distance between two looks along a ray: half a voxel, but not finer than 1/16 of a cell [m].
  double marchStep() const { return march_step_m_; }
  /// Mean edge of the deformed hexahedra, or of the boxes around the cells where there are none [m]; 0 without cells.
  double meanEdge() const { return mean_edge_m_; }

  /// The cell that holds a point. On a common face any of the cells may answer; all give the same place. `hint` is the
  /// index of a cell to try first: it only saves time.
  CellPoint locate(const Vector3& point_m, std::uint32_t hint = kNoCell) const;
  Sample sample(const Vector3& point_m, std::uint32_t hint = kNoCell) const;
  /// The same in one cell alone.
  CellPoint locateIn(std::uint32_t cell, const Vector3& point_m) const;

  /// Deformed place of a point of a cell [m]. The functions below need a found point.
  Vector3 position(const CellPoint& at) const { return value(positions_m_, at); }
  /// Of the tissue as it is shown: the patch's own, or that of the way from the patch before.
  Vector3 velocity(const CellPoint& at) const { return value(velocities_m_s_, at); }
  /// Its place in the undeformed volume, volume frame [m].
  Vector3 volumePoint(const CellPoint& at) const { return value(places_m_, at); }
  /// Gradient of the intensity by the deformed position [1/m]: the volume's gradient under the inverse transpose of the
  /// deformation gradient. Zero in a cell without volume.
  Vector3 gradient(const CellPoint& at) const;
  /// The topology's number of a cell of the patch, and back; kNoCell when the patch lacks it.
  std::uint32_t cellId(std::uint32_t cell) const { return cells_[cell].id; }
  std::uint32_t cellOfId(std::uint32_t id) const;
  /// Whether the point is within a micrometre of a face of its cell that an incision opened.
  bool isAtCut(const CellPoint& at) const;
  /// Mean Young's modulus of the cells around a point [Pa]: of those with a middle within `radius_m`, or else of the
  /// cell that holds it; 0 where there is none.
  double youngsModulus(const Vector3& point_m, double radius_m) const;
  /// True when the grid goes on behind the face that the point is nearest to, but the patch does not: the patch is too
  /// small to say what is there.
  bool gridGoesOn(const CellPoint& at) const;

 private:
  // Cells know their points by slot alone, so that moving a patch is moving its vertices.
  struct Hexahedron {
    std::array<std::uint32_t, 8> corners;
    std::uint8_t missing_neighbours = 0;  // bit f: the cell behind face f is not in the patch
    std::uint8_t cuts = 0;                // bit f: an incision opened face f
  };
  struct Cone {
    SurfaceCone::Points points;
    double tolerance_m;
    bool missing_neighbour = false;
    bool cut = false;
  };
  struct Cell {
    Box3 box;
    Box3 place_box;
    std::uint32_t id = 0;
    float stiffness_pa = 0.0F;
    std::uint32_t first = 0;  // its hexahedron, or the first of its cones
    std::uint32_t cones = 0;
    std::uint32_t first_corner = 0;  // of those of a cell that is made of cones
    std::uint32_t corners = 0;
    bool cut = false;
    bool isHexahedron() const { return cones == 0; }
  };
  /// What is behind a face of a cell of the topology.
  struct Behind {
    std::int32_t neighbour;  // -1: none
    bool cut;
  };
  struct Loop {
    const std::uint32_t* vertices;
    std::size_t size;
  };

  void check(const Topology& topology, const GridPatch& patch);
  void checkCorners(const Topology& topology, std::uint32_t id) const;
  void countFaces(const Topology& topology);
  void placePoints(const Topology& topology, const GridPatch& patch);
  Behind behind(const Topology& topology, std::uint32_t id, std::size_t face) const;
  bool isMissing(const Behind& behind) const;
  void addCell(Cell cell);
  void addHexahedron(const Topology& topology, std::uint32_t id);
  void addCones(const Topology& topology, std::uint32_t id);
  void addCorners(const Topology& topology, std::uint32_t id, Cell& cell);
  void addFace(const Topology& topology, const Loop& loop, const Behind& behind, std::uint32_t centre,
               double tolerance_m);
  void measure();
  void boundCells(double margin_m);
  double widestWay() const;
  void boundPlaces();
  void reserveBins();
  void buildBins();
  bool countBins();
  void takeShown(const PatchContact& shown);
  void placeUnknown();
  void placeCutVertices(const PatchContact& shown);
  std::optional<Vector3> shownPlace(const Vector3& place_m, const Vector3& near_m) const;
  std::optional<Vector3> shownPlaceIn(const Cell& cell, const Vector3& place_m) const;
  template <typename Visit>
  void forCornersOf(const Cell& cell, const Visit& visit) const;
  SurfaceCone shapeOf(const Cone& cone) const { return {positions_m_, cone.points, cone.tolerance_m}; }
  Vector3 centreOf(const std::vector<Vector3>& field, const Cell& cell) const;
  static Trilinear trilinear(const std::vector<Vector3>& field, const Hexahedron& hexahedron);
  std::array<int, 3> binOf(const Vector3& point_m) const;
  std::size_t binIndex(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(bins_[0]) * (std::size_t(j) + std::size_t(bins_[1]) * std::size_t(k));
  }
  template <typename Visit>
  void forBinsOf(const Cell& cell, const Visit& visit) const;
  Vector3 value(const std::vector<Vector3>& field, const CellPoint& at) const;

  std::shared_ptr<const Volume> volume_;
  double tissue_threshold_;

  std::vector<Cell> cells_;  // increasing id
  std::vector<Hexahedron> hexahedra_;
  std::vector<Cone> cones_;
  std::vector<std::uint32_t> cell_corners_;
  bool has_cuts_ = false;
  std::uint64_t session_ = 0;
  std::uint32_t revision_ = 0;
  // The patch's vertices in its order, then the centres of cells that are made of cones.
  std::vector<std::uint32_t> vertex_ids_;  // of the former alone
  std::vector<Vector3> positions_m_;       // as shown
  std::vector<Vector3> places_m_;
  std::vector<Vector3> velocities_m_s_;

  // The way from the patch before: from_m_ at 0 s, to_m_ at duration_s_.
  std::vector<Vector3> from_m_;
  std::vector<Vector3> to_m_;
  std::vector<std::uint32_t> known_;  // per vertex: 1 when the patch before has it; scratch: neighbours that it has
  double duration_s_ = 0.0;           // 0: no way to go
  double gone_s_ = 0.0;
  Box3 bounds_;
  double march_step_m_ = 0.0;
  double mean_edge_m_ = 0.0;
  double margin_m_ = 0.0;  // by which the cells' boxes are wider than they have to be: so far vertices may move

  // A regular grid of bins over bounds_; bin b lists bin_cells_[bin_offsets_[b] .. bin_offsets_[b + 1]).
  std::array<int, 3> bins_{};
  Vector3 bins_per_m_ = Vector3::Zero();
  std::vector<std::uint32_t> bin_offsets_;
  std::vector<std::uint32_t> bin_cells_;

  // Of the grid with this session and revision: where a cell's faces begin.
  std::uint64_t counted_session_ = 0;
  std::uint32_t counted_revision_ = 0;
  std::vector<std::uint32_t> face_begins_;

  // Scratch of update(), kept so that it allocates once: slot in the patch per vertex and cell of the grid.
  std::vector<std::uint32_t> vertex_slots_;
  std::vector<std::uint32_t> cell_slots_;
  std::vector<std::uint32_t> bin_fill_;
};

}  // namespace soft_volume::core
