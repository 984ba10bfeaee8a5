#pragma once

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// In which space colours are mixed.
enum class ColourSpace { kRgb, kHsv, kHsvNoWrap, kLab, kDiverging, kStep };

/// The colour at part t (0 to 1) of the way from a to b; all colours are sRGB in [0, 1]. Lab is CIE's of 1976 under
/// D65. Diverging is that of Moreland, "Diverging color maps for scientific visualization" (ISVC 2009), which goes
/// through white where the ends have different hues. Step is b from the
/// beginning on, as in VTK.
Vector3 mixColours(const Vector3& a, const Vector3& b, double t, ColourSpace space);

}  // namespace soft_volume::core
