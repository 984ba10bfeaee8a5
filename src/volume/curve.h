#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "soft_volume/volume/transfer_function.h"

namespace soft_volume::core {

/// A curve that is linear between its nodes and constant outside; nodes of equal value make a step.
template <typename Y>
struct CurveNode {
  double value;
  Y y;
};
template <typename Y>
using Curve = std::vector<CurveNode<Y>>;

using OpacityCurve = Curve<double>;
using ColourCurve = Curve<Vector3>;

/// Throws FileError, which begins with `place`, unless there is a node and the values are finite and do not decrease.
template <typename Y>
void checkCurve(const Curve<Y>& curve, const std::string& place);

/// A point wherever one of the curves has a node. A step becomes two points a millionth of the curves' width apart.
std::vector<TransferFunction::Point> joinCurves(const ColourCurve& colours, const OpacityCurve& opacities);

}  // namespace soft_volume::core
