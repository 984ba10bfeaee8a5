#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <vector>

#include "cut_block.h"
#include "soft_volume/simulation/oracle.h"

namespace soft_volume::core::validate {

/// How the pieces of cut tissue are made stiff.
enum class PieceStiffness {
  kEmbedded,       ///< copies of their cells carry them (embedding.h)
  kComplete,       ///< springs between all vertices of a piece (dissertation section 4.4.2), stiffness fitted
  kCompleteEqual,  ///< the same springs, all of a piece equally stiff
};
const char* nameOf(PieceStiffness stiffness);

/// Springs between all vertices of a piece: n (n - 1) / 2 of them. The energy of their network under a uniform strain
/// is (V / 2) e : C : e with C = sum of k l^2 n n n n / V, symmetric in all indices.
struct PieceNetwork {
  struct Spring {
    std::uint32_t a;
    std::uint32_t b;
    double stiffness_n_m;
  };
  std::vector<Spring> springs;

  /// All springs equally stiff, such that the trace of C is that of isotropic tissue with nu = 1/4 (6 E).
  void addEqual(const std::vector<Vector3>& places_m, const std::vector<std::uint32_t>& vertices, double volume_m3,
                double youngs_modulus_pa);
  /// The stiffness, none of it negative, whose C is nearest to that of isotropic tissue with nu = 1/4, by least
  /// squares; scaled to its trace. Exact for a cube, where it is the isotropic rule.
  void addFitted(const std::vector<Vector3>& places_m, const std::vector<std::uint32_t>& vertices, double volume_m3,
                 double youngs_modulus_pa);
};

/// The equations of motion of cut tissue near rest, whatever makes it stiff: masses at nodes and forces between them,
/// and how the vertices of the cut mesh hang on the nodes. Refers to the tissue, which stays as it is.
class CutBody {
 public:
  CutBody(const CutBlock& tissue, PieceStiffness stiffness);

  std::size_t nodeCount() const { return masses_kg_.size(); }
  const Vector3& place(std::uint32_t node) const { return places_m_[node]; }
  const std::vector<double>& masses() const { return masses_kg_; }
  /// The part of the tissue that a node belongs to, named by its lowest node.
  std::uint32_t part(std::uint32_t node) const { return parts_[node]; }
  bool fixed(std::uint32_t node) const { return fixed_[node] != 0; }
  /// Nodes that carry a vertex of the mesh, and by how much.
  std::map<std::uint32_t, double> weightsOf(std::uint32_t vertex) const;
  const CutBlock& tissue() const { return *tissue_; }
  /// Pairs of a whole and cut cells alike.
  std::size_t springCount() const { return spring_count_; }

  void addForces(const std::vector<Vector3>& displacements_m, std::vector<Vector3>& forces_n) const;
  /// Derivative of the forces at rest, by central differences: exact to about 1e-8.
  Eigen::MatrixXd stiffness() const;
  /// The largest frequency of what is not fixed, by power iteration, rad/s.
  double largestFrequency() const;

 private:
  void makeEmbedded();
  void makeComplete(bool fitted);

  const CutBlock* tissue_;
  bool embedded_;
  std::vector<Vector3> places_m_;
  std::vector<double> masses_kg_;
  std::vector<std::uint32_t> parts_;
  std::vector<std::uint8_t> fixed_;
  std::size_t spring_count_ = 0;
  std::unique_ptr<OracleModel> model_;  // embedded
  PieceNetwork network_;                // complete
};

}  // namespace soft_volume::core::validate
