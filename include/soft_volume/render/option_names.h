#pragma once

#include <array>

#include "soft_volume/common/named_choice.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {

// The names of the choices of RenderOptions, Renderer and Camera.

template <>
inline constexpr std::array<NamedChoice<Backend>, 3> kChoices<Backend>{
    {{"gl", Backend::kGl}, {"native", Backend::kNative}, {"exact", Backend::kExact}}};

template <>
inline constexpr std::array<NamedChoice<Lookup>, 2> kChoices<Lookup>{
    {{"scalar", Lookup::kScalar}, {"colour", Lookup::kColour}}};

template <>
inline constexpr std::array<NamedChoice<Projection>, 2> kChoices<Projection>{
    {{"perspective", Projection::kPerspective}, {"parallel", Projection::kParallel}}};

}  // namespace soft_volume::core
