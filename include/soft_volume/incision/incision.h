#pragma once

#include <array>

#include "soft_volume/common/named_choice.h"

namespace soft_volume::core {

enum class IncisionMethod {
  kPieces,  ///< cells are split where the blade passes (section 4.4.2)
  kFaces,   ///< tissue parts along the faces nearest to the blade (section 4.4.1)
};

template <>
inline constexpr std::array<NamedChoice<IncisionMethod>, 2> kChoices<IncisionMethod>{
    {{"pieces", IncisionMethod::kPieces}, {"faces", IncisionMethod::kFaces}}};

/// How an incision acts. Defaults are those of the scene file.
struct IncisionSettings {
  IncisionMethod method = IncisionMethod::kPieces;
  /// Rest lengths across the lips, in the cells along the cut, are shortened to this fraction so that the cut opens
  /// (section 4.4.2, last paragraph).
  double rest_fraction = 1.0;
  /// Outward force on the lips of a cut, per rest area, that pulls them apart (the same paragraph).
  double opening_pressure_pa = 0.0;
};

}  // namespace soft_volume::core
