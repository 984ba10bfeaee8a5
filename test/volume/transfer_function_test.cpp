#include "soft_volume/volume/transfer_function.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

TransferFunction makeFunction() {
  TransferFunction function;
  function.points = {
      {-100.0, {0.0F, 0.0F, 0.0F}, 0.0F}, {100.0, {1.0F, 0.5F, 0.0F}, 0.5F}, {300.0, {1.0F, 1.0F, 1.0F}, 0.25F}};
  return function;
}

void expectSample(const TransferFunction::Sample& sample, const Vector3f& colour, float opacity) {
  EXPECT_EQ(sample.colour, colour);
  EXPECT_EQ(sample.opacity, opacity);
}

TEST(TransferFunction, GoesThroughItsPoints) {
  const TransferFunction function = makeFunction();
  for (const TransferFunction::Point& point : function.points) {
    expectSample(function.evaluate(point.value), point.colour, point.opacity);
  }
}

TEST(TransferFunction, IsLinearBetweenPoints) {
  expectSample(makeFunction().evaluate(0.0), {0.5F, 0.25F, 0.0F}, 0.25F);
  expectSample(makeFunction().evaluate(250.0), {1.0F, 0.875F, 0.75F}, 0.3125F);
}

TEST(TransferFunction, ClampsOutsideAndHidesNaN) {
  expectSample(makeFunction().evaluate(-1e30), {0.0F, 0.0F, 0.0F}, 0.0F);
  expectSample(makeFunction().evaluate(HUGE_VAL), {1.0F, 1.0F, 1.0F}, 0.25F);
  EXPECT_EQ(makeFunction().evaluate(std::nan("")).opacity, 0.0F);
}

using Spoil = std::function<void(TransferFunction&)>;

void expectRefused(const Spoil& spoil, const std::string& part_of_message) {
  TransferFunction function = makeFunction();
  EXPECT_NO_THROW(function.validate());
  spoil(function);
  try {
    function.validate();
    ADD_FAILURE() << "accepted; expected a message about " << part_of_message;
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find(part_of_message), std::string::npos) << error.what();
  }
}

TEST(TransferFunction, NeedsTwoPoints) {
  expectRefused([](TransferFunction& f) { f.points.resize(1); }, "two points");
  expectRefused([](TransferFunction& f) { f.points.clear(); }, "two points");
}

TEST(TransferFunction, NeedsIncreasingFiniteValues) {
  expectRefused([](TransferFunction& f) { f.points[1].value = -100.0; }, "increase");
  expectRefused([](TransferFunction& f) { f.points[2].value = 50.0; }, "increase");
  expectRefused([](TransferFunction& f) { f.points[2].value = HUGE_VAL; }, "finite");
  expectRefused([](TransferFunction& f) { f.points[0].value = std::nan(""); }, "finite");
}

TEST(TransferFunction, NeedsColoursAndOpacitiesInTheUnitInterval) {
  for (const float bad : {-0.01F, 1.01F, std::nanf("")}) {
    expectRefused([bad](TransferFunction& f) { f.points[1].opacity = bad; }, "opacity");
    for (int channel = 0; channel < 3; ++channel) {
      expectRefused([=](TransferFunction& f) { f.points[2].colour[channel] = bad; }, "colour");
    }
  }
}

TEST(TransferFunction, NeedsAPositiveUnitDistance) {
  for (const double bad : {0.0, -0.001, double(HUGE_VAL), std::nan("")}) {
    expectRefused([bad](TransferFunction& f) { f.unit_distance_m = bad; }, "unit_distance_m");
  }
}

}  // namespace
}  // namespace soft_volume::core
