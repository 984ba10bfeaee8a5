#include "curve.h"

#include <cmath>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

template <typename Y>
Y between(const CurveNode<Y>& a, const CurveNode<Y>& b, double value) {
  const double t = (value - a.value) / (b.value - a.value);
  return Y(a.y + t * (b.y - a.y));
}

/// The limit from below.
template <typename Y>
Y before(const Curve<Y>& curve, double value) {
  const auto node =
      std::lower_bound(curve.begin(), curve.end(), value, [](const CurveNode<Y>& n, double v) { return n.value < v; });
  if (node == curve.begin())
    return node->y;
  return node == curve.end() ? curve.back().y : between(*(node - 1), *node, value);
}

/// The limit from above.
template <typename Y>
Y after(const Curve<Y>& curve, double value) {
  const auto node =
      std::upper_bound(curve.begin(), curve.end(), value, [](double v, const CurveNode<Y>& n) { return v < n.value; });
  if (node == curve.begin())
    return node->y;
  return node == curve.end() ? curve.back().y : between(*(node - 1), *node, value);
}

std::vector<double> valuesOf(const ColourCurve& colours, const OpacityCurve& opacities) {
  std::vector<double> values;
  for (const auto& node : colours)
    values.push_back(node.value);
  for (const auto& node : opacities)
    values.push_back(node.value);
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  return values;
}

/// Files print few digits, so a colour may exceed 1 by a rounding.
double withoutRounding(double part) {
  return part > 1.0 && part < 1.0 + 1e-5 ? 1.0 : part < 0.0 && part > -1e-5 ? 0.0 : part;
}

TransferFunction::Point makePoint(double value, const Vector3& colour, double opacity) {
  return {value, colour.unaryExpr(&withoutRounding).cast<float>(), static_cast<float>(withoutRounding(opacity))};
}

}  // namespace

template <typename Y>
void checkCurve(const Curve<Y>& curve, const std::string& place) {
  if (curve.empty())
    throw FileError(place + " has no points");
  for (std::size_t n = 0; n < curve.size(); ++n) {
    if (!std::isfinite(curve[n].value))
      throw FileError(place + ", point " + std::to_string(n + 1) + ": the value is not a finite number");
    if (n > 0 && curve[n].value < curve[n - 1].value) {
      throw FileError(place + ", point " + std::to_string(n + 1) + ": values must increase, but " +
                      std::to_string(curve[n].value) + " follows " + std::to_string(curve[n - 1].value));
    }
  }
}

template void checkCurve(const OpacityCurve&, const std::string&);
template void checkCurve(const ColourCurve&, const std::string&);

std::vector<TransferFunction::Point> joinCurves(const ColourCurve& colours, const OpacityCurve& opacities) {
  const std::vector<double> values = valuesOf(colours, opacities);
  const double step = 1e-6 * (values.back() - values.front());
  std::vector<TransferFunction::Point> points;
  for (std::size_t n = 0; n < values.size(); ++n) {
    const double value = values[n];
    points.push_back(makePoint(value, before(colours, value), before(opacities, value)));
    const TransferFunction::Point next = makePoint(value, after(colours, value), after(opacities, value));
    const bool same = next.colour == points.back().colour && next.opacity == points.back().opacity;
    if (same || step == 0.0)
      continue;
    points.push_back(next);
    points.back().value += n + 1 < values.size() ? std::min(step, 0.25 * (values[n + 1] - value)) : step;
  }
  return points;
}

}  // namespace soft_volume::core
