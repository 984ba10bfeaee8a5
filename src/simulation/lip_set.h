#pragma once

#include <cstdint>
#include <vector>

#include "kernel.h"
#include "lip_row.h"
#include "solve_set.h"

namespace soft_volume::core {

/// Contact between the lips of incisions in a solve: a penalty without friction, k A max(0, -gap) along the normal of
/// the deformed lips (lip_row.h), gathered per vertex so that the threads do not change the bits.
///
/// An explicit step would have to be shortened for lips that are stiff enough. So they answer to where they would be at
/// the end of it: with u* the displacements that all other forces and the velocities lead to, gap* of these, W the
/// matrix of what the contacts' forces add to the gaps in the step, and areas A,
///
///   hold p = max(0, -gap*) / (1 / (hold k) + D),   D_i = sum over j of |W_ij| A_j / A_i   over the contacts with gap*
///   < 0.
///
/// D - W has no negative eigenvalue, so this is backward Euler of a penalty with the compliance 1 / k + D - W: it never
/// shortens the stable step and takes energy out of an impact, none in. Even pressure is in the null space of D - W
/// where a cell has one cut and lips have not slid: in equilibrium it is carried by k exactly, whatever the step. What
/// varies from point to point of a cell's lip is carried more softly, by no less than about E A / h at 0.6 of the
/// stable step; and so are the lips of several cuts through one cell.
///
/// Backward Euler takes the penalty as it is, with its stiffness along the normal, and without the bound of its depth:
/// lips that meet in one of its long steps go deep before they part.
template <typename Real>
class LipSet {
 public:
  void build(const Lattice& lattice, const std::vector<LipContact>& contacts, const SolveSet<Real>& set);

  bool empty() const { return contacts_.empty(); }
  /// Adds to the forces that the view holds, on all vertices of the contacts, for a step by `rule`.
  void addForces(const KernelView<Real>& view, const AdvanceRule<Real>& rule, int threads);
  /// Adds those at the present displacements and keeps them for addProduct() and addDiagonal().
  void addPresentForces(const KernelView<Real>& view, int threads);
  /// Adds the stiffness of the contacts that were pressed, or nearly, at the last addPresentForces() times `direction`.
  void addProduct(const std::vector<Real> (&direction)[3], std::vector<Real> (&product)[3]) const;
  /// Adds its diagonal.
  void addDiagonal(std::vector<Real> (&diagonal)[3]) const;
  std::size_t bytes() const;

 private:
  struct Corner {
    std::uint32_t node;
    Real weight;
    Real along[2];
  };
  struct Contact {
    std::array<Vector3, 2> tangents = {Vector3::Zero(), Vector3::Zero()};
    double area_m2 = 0.0;
    double compliance_m_n = 0.0;
    double opening_n = 0.0;
    std::uint32_t corners_begin = 0;
  };
  /// A vertex that contacts hang on.
  struct Node {
    Vector3 displacement_m = Vector3::Zero();
    Vector3 ahead_m = Vector3::Zero();  ///< what the step adds to it without the contacts
    double yield_m_n = 0.0;             ///< how far a force moves it in the step
    double pressed_m3_n = 0.0;          ///< that times the area of the pressed contacts, by weight
    std::uint32_t vertex = 0;           ///< local
    std::uint32_t links_begin = 0;
  };
  struct Link {
    std::uint32_t contact;
    std::uint32_t corner;
  };
  /// Of a contact on its corners, to be taken by weight and by along[k].
  struct Force {
    Vector3 by_weight = Vector3::Zero();
    std::array<Vector3, 2> by_along = {Vector3::Zero(), Vector3::Zero()};
  };

  template <typename Pass>
  void overAll(std::size_t count, int threads, const Pass& pass) const;
  void readNode(const KernelView<Real>& view, const AdvanceRule<Real>* rule, Node& node) const;
  Vector3 gradient(std::size_t contact, const Corner& corner) const;
  void findDepth(std::size_t contact, double most_m);
  void setForce(std::size_t contact, double pressed_n);
  double stepForce(std::size_t contact) const;
  void gatherForces(const KernelView<Real>& view, int threads);

  double shortest_edge_m_ = 0.0;
  double most_m_ = 0.0;
  double reach_m_ = 0.0;
  std::vector<Contact> contacts_;  // and one more that ends the last one's corners
  std::vector<Corner> corners_;
  std::vector<Node> nodes_;  // likewise
  std::vector<Link> links_;
  std::vector<double> pulls_;  // per corner: length of the gap's gradient
  std::vector<LipState> states_;
  std::vector<double> depths_m_;     // how deep a contact would be when the step ends; 0: not pressed
  std::vector<std::uint8_t> stiff_;  // for backward Euler
  std::vector<Force> forces_n_;
};

}  // namespace soft_volume::core
