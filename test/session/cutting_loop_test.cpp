// A scalpel and a simulation in one loop: what the hand does while it cuts goes into new surface.

#include <gtest/gtest.h>

#include "small_scene.h"
#include "soft_volume/grid/cell_shape.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

constexpr double kToughness = 40.0;  // J/m^2
constexpr double kTip = 0.0215;      // height of the blade's tip
constexpr double kLength = 0.048;
constexpr double kPeriod = 0.001;
constexpr int kStepsPerPatch = 4;

Scene toughScene() {
  Scene scene = smallScene();
  scene.materials[0].cut_resistance_j_m2 = kToughness;
  scene.materials[0].youngs_modulus_pa = 20000.0;
  for (ToolConfig& tool : scene.tools)
    tool.coupling.device_damping_n_s_m = 1.0;  // so that the spring that renders it takes little of the work
  return scene;
}

/// Area that incisions opened, at rest, of one of both lips [m^2].
double openedArea(const Topology& topology) {
  std::vector<Vector3> points;
  for (const Vector3f& p : topology.rest_positions)
    points.push_back(p.cast<double>());
  double area = 0.0;
  std::size_t at = 0;
  for (std::size_t c = 0; c < topology.cellCount(); ++c) {
    forEachFace(topology.cell_types[c], &topology.connectivity[topology.cell_offsets[c]],
                [&](std::size_t, const std::uint32_t* loop, std::size_t size) {
                  if (topology.cut_faces[at++] != 0)
                    area += 0.25 * areaVector(points, {loop, loop + size}).norm();
                });
  }
  return area;
}

/// A hand that leads the blade at a constant speed, whatever it feels.
class CuttingLoop {
 public:
  CuttingLoop() : session_(toughScene(), smallVolume(), nullptr, 5, 1), tool_(*session_.scene().findTool("scalpel")) {
    tool_.setVolume(session_.volume());
    tool_.setTopology(std::make_shared<const Topology>(session_.topology()));
    input_.buttons.set(tool_.config().cut_button);
  }

  void stroke(const Vector3& from, const Vector3& to, double speed_m_s) {
    const int steps = int(std::lround((to - from).norm() / (speed_m_s * kPeriod)));
    for (int n = 0; n <= steps; ++n)
      step(from + double(n) / steps * (to - from));
  }
  double work() const { return work_j_; }
  double largestForce() const { return largest_n_; }
  int refused() const { return refused_; }
  const Session& session() const { return session_; }

 private:
  void step(const Vector3& tip) {
    if (session_.steps() % kStepsPerPatch == 0) {
      tool_.setTopology(std::make_shared<const Topology>(session_.topology()));
      tool_.setPatch(session_.patch("scalpel", tip, tool_.config().patch_radius_m));
    }
    const Vector3 before = input_.pose.position_m;
    input_.pose.position_m = tip;
    input_.time_s = input_.pose_time_s = session_.steps() * kPeriod;
    const ToolOutput output = tool_.update(input_);
    if (session_.steps() > 0)
      work_j_ -= 0.5 * (force_n_ + output.device_force_n).dot(tip - before);
    force_n_ = output.device_force_n;
    largest_n_ = std::max(largest_n_, force_n_.norm());
    refused_ += output.cut && !session_.apply(toCommand("scalpel", *output.cut)).applied ? 1 : 0;
    refused_ += output.force && !session_.apply(toCommand("scalpel", *output.force)).applied ? 1 : 0;
    session_.step();
  }

  Session session_;
  Tool tool_;
  ToolInput input_;
  Vector3 force_n_ = Vector3::Zero();
  double work_j_ = 0.0;
  double largest_n_ = 0.0;
  int refused_ = 0;
};

TEST(CuttingLoop, TheHandsWorkIsTheFractureEnergy) {
  for (const double speed : {0.03, 0.08}) {
    CuttingLoop loop;
    const double x = 0.0211;
    loop.stroke({x, -0.016, kTip}, {x, 0.060, kTip}, speed);
    const Topology topology = loop.session().topology();
    const double area = openedArea(topology);
    float top = 0.0F;
    for (const Vector3f& p : topology.rest_positions)
      top = std::max(top, p.z());
    const double depth = top - kTip;
    EXPECT_NEAR(area, kLength * depth, 0.06 * kLength * depth);
    EXPECT_EQ(loop.refused(), 0);
    const double energy = kToughness * area;
    // The first quad is cut, and felt, when the blade is half a cell on: a twelfth of this stroke.
    EXPECT_NEAR(loop.work(), energy, 0.15 * energy) << speed;
    EXPECT_NEAR(loop.largestForce(), kToughness * depth, 0.35 * kToughness * depth) << speed;
    std::cout << "[ work     ] " << speed << " m/s: work " << 1e3 * loop.work() << " mJ, fracture energy "
              << 1e3 * energy << " mJ, area " << 1e6 * area << " mm^2, largest force " << loop.largestForce() << " N\n";
  }
}

/// Deformed middle of a piece's vertices, and its box at rest.
struct Middle {
  Vector3 deformed_m = Vector3::Zero();
  Box3 rest_box_m;
};

Middle middleOf(const Session& session, const std::vector<Vector3>& positions_m, std::uint32_t piece) {
  Middle middle;
  const auto vertices = session.tissue().mesh().verticesOf(piece);
  for (const std::uint32_t v : vertices) {
    middle.deformed_m += positions_m[v] / double(vertices.size());
    middle.rest_box_m.extend(session.tissue().mesh().restPositions()[v]);
  }
  return middle;
}

TEST(CuttingLoop, EveryPieceIsFeltWhereItIs) {
  CuttingLoop loop;
  loop.stroke({0.0211, -0.016, kTip}, {0.0211, 0.060, kTip}, 0.08);
  loop.stroke({0.0211, 0.060, kTip}, {-0.016, 0.060, 0.06}, 0.5);
  loop.stroke({-0.016, 0.060, 0.06}, {-0.016, 0.019, kTip}, 0.5);
  loop.stroke({-0.016, 0.019, kTip}, {0.060, 0.027, kTip}, 0.08);
  const Session& session = loop.session();
  const Topology topology = session.topology();
  topology.validate();
  PatchContact contact(session.volume(), 75.0);
  contact.update(topology, session.patch("probe", {0.024, 0.024, 0.02}, 0.1));
  EXPECT_EQ(contact.cellCount(), topology.cellCount());
  EXPECT_GT(std::count(topology.cell_types.begin(), topology.cell_types.end(), CellType::kPolyhedron), 40);
  const auto positions_m = session.drawnPositions();
  double moved = 0.0;
  for (std::uint32_t piece = 0; piece < topology.cellCount(); ++piece) {
    const Middle middle = middleOf(session, positions_m, piece);
    const auto at = contact.locateIn(contact.cellOfId(piece), middle.deformed_m);
    ASSERT_TRUE(at.found()) << "piece " << piece;
    EXPECT_LT(middle.rest_box_m.exteriorDistance(contact.volumePoint(at)), 1e-6);
    moved = std::max(moved, (contact.volumePoint(at) - middle.deformed_m).norm());
  }
  EXPECT_GT(moved, 1e-4);
}

/// A block cut in two that stand on fixed ground; one half is held away, and a probe goes in between.
class OpenIncision {
 public:
  static constexpr double kPlane = 0.0211;

  OpenIncision()
      : session_(thinProbeScene(), smallVolume(), nullptr, 6, 1), probe_(*session_.scene().findTool("probe")) {
    ToolCutCommand cut;
    cut.header = header("scalpel");
    cut.quads = {{Vector3(kPlane, -0.01, -0.01), Vector3(kPlane, -0.01, 0.06), Vector3(kPlane, 0.06, 0.06),
                  Vector3(kPlane, 0.06, -0.01)}};
    cut.lifted = true;
    EXPECT_TRUE(session_.apply(cut).applied);
    held_piece_ = pieceAt({kPlane - 0.002, 0.024, 0.028});
    probe_.setVolume(session_.volume());
    probe_.setTopology(std::make_shared<const Topology>(session_.topology()));
    for (int n = 0; n < 600; ++n)
      step({kPlane - 0.002, 0.024, 0.06});
  }
  const ToolOutput& lead(const Vector3& to, int steps) {
    const Vector3 from = input_.pose.position_m;
    for (int n = 1; n <= steps; ++n)
      step(from + double(n) / steps * (to - from));
    return output_;
  }
  /// Middle of the upper part of a half: -1 or 1.
  Vector3 half(int side) const {
    const auto positions_m = session_.drawnPositions();
    Vector3 sum = Vector3::Zero();
    double count = 0.0;
    for (std::uint32_t piece = 0; piece < session_.tissue().mesh().pieces().size(); ++piece) {
      const Middle middle = middleOf(session_, positions_m, piece);
      const Vector3 rest = middle.rest_box_m.center();
      if (rest.z() < 0.02 || (rest.x() < kPlane) != (side < 0))
        continue;
      sum += middle.deformed_m;
      count += 1.0;
    }
    return sum / count;
  }
  bool isOnPositiveSide(std::uint32_t piece) const {
    return middleOf(session_, session_.drawnPositions(), piece).rest_box_m.center().x() > kPlane;
  }

 private:
  static Scene thinProbeScene() {
    Scene scene = smallScene();
    scene.tools[0].tip_radius_m = 0.001;
    return scene;
  }
  ToolCommandHeader header(const std::string& tool_id) {
    ToolCommandHeader header;
    header.session = session_.id();
    header.revision = session_.lattice().revision;
    header.step = session_.steps();
    header.tool_id = tool_id;
    header.sequence = ++sequence_;
    return header;
  }
  /// The piece whose box at rest holds a point.
  std::uint32_t pieceAt(const Vector3& rest_m) const {
    std::uint32_t piece = 0;
    while (!middleOf(session_, session_.drawnPositions(), piece).rest_box_m.contains(rest_m))
      ++piece;
    return piece;
  }
  void holdTheOtherHalf() {
    ToolForceCommand hold;
    hold.header = header("scalpel");
    hold.hold_steps = 50;
    hold.force_n = Vector3(-0.1, 0.0, 0.0);
    hold.point_m = Vector3(kPlane - 0.002, 0.024, 0.030);
    hold.footprint_radius_m = 0.02;
    hold.cells = {held_piece_};
    EXPECT_TRUE(session_.apply(hold).applied);
  }
  void step(const Vector3& tip) {
    holdTheOtherHalf();
    if (session_.steps() % kStepsPerPatch == 0)
      probe_.setPatch(session_.patch("probe", tip, 0.03));
    input_.pose.position_m = tip;
    input_.time_s = input_.pose_time_s = session_.steps() * kPeriod;
    output_ = probe_.update(input_);
    if (output_.force) {
      EXPECT_TRUE(session_.apply(toCommand("probe", *output_.force)).applied);
    }
    session_.step();
  }

  Session session_;
  Tool probe_;
  ToolInput input_;
  ToolOutput output_;
  std::uint64_t sequence_ = 0;
  std::uint32_t held_piece_ = 0;
};

TEST(CuttingLoop, AProbeInAnOpenIncisionPressesOneLip) {
  OpenIncision incision;
  ToolOutput output = incision.lead({OpenIncision::kPlane - 0.002, 0.024, 0.022}, 300);
  EXPECT_FALSE(output.contact.touching);
  incision.lead({OpenIncision::kPlane - 0.002, 0.024, 0.022}, 300);
  const Vector3 held = incision.half(-1);
  const Vector3 free = incision.half(1);
  output = incision.lead({OpenIncision::kPlane + 0.006, 0.024, 0.022}, 400);
  ASSERT_TRUE(output.contact.touching);
  EXPECT_TRUE(incision.isOnPositiveSide(output.contact.cell));
  EXPECT_LT(output.device_force_n.x(), -0.05);
  EXPECT_GT(incision.half(1).x() - free.x(), 0.0003);
  EXPECT_LT((incision.half(-1) - held).norm(), 0.02 * (incision.half(1) - free).norm());
}

}  // namespace
}  // namespace soft_volume::core
