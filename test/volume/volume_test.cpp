#include "soft_volume/volume/volume.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

template <typename T>
std::vector<std::uint8_t> bytesOf(const std::vector<T>& values) {
  std::vector<std::uint8_t> bytes(values.size() * sizeof(T));
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

VolumeGeometry makeGeometry() {
  VolumeGeometry geometry;
  geometry.dims = {5, 4, 3};
  geometry.spacing_m = {0.25, 0.5, 2.0};  // powers of two: sums and products of the tests are exact
  geometry.origin_m = {1.0, -2.0, 3.0};
  geometry.direction << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  return geometry;
}

/// value = 3 + 2 i - 4 j + 8 k
template <typename T>
std::vector<T> linearValues(const VolumeGeometry& geometry) {
  std::vector<T> values;
  for (int k = 0; k < geometry.dims.z(); ++k) {
    for (int j = 0; j < geometry.dims.y(); ++j) {
      for (int i = 0; i < geometry.dims.x(); ++i) {
        values.push_back(static_cast<T>(3 + 2 * i - 4 * j + 8 * k));
      }
    }
  }
  return values;
}

template <typename T>
constexpr ScalarType typeOf();
template <>
constexpr ScalarType typeOf<std::int8_t>() {
  return ScalarType::kInt8;
}
template <>
constexpr ScalarType typeOf<std::int16_t>() {
  return ScalarType::kInt16;
}
template <>
constexpr ScalarType typeOf<std::int32_t>() {
  return ScalarType::kInt32;
}
template <>
constexpr ScalarType typeOf<float>() {
  return ScalarType::kFloat32;
}
template <>
constexpr ScalarType typeOf<double>() {
  return ScalarType::kFloat64;
}

template <typename T>
Volume linearVolume() {
  const VolumeGeometry geometry = makeGeometry();
  return Volume(geometry, typeOf<T>(), bytesOf(linearValues<T>(geometry)));
}

Vector3 toPatient(const VolumeGeometry& geometry, const Vector3& p_volume) {
  return geometry.origin_m + geometry.direction * p_volume;
}

/// Makes a volume of int16 from a geometry that a test has spoilt.
void makeWith(const VolumeGeometry& geometry, std::size_t byte_count = 120) {
  Volume(geometry, ScalarType::kInt16, std::vector<std::uint8_t>(byte_count));
}

TEST(Volume, AcceptsAUsableGeometry) {
  EXPECT_NO_THROW(makeWith(makeGeometry()));
}

TEST(Volume, AcceptsAMirroredGrid) {
  VolumeGeometry geometry = makeGeometry();
  geometry.direction.col(2) *= -1.0;
  EXPECT_NO_THROW(makeWith(geometry));
}

TEST(Volume, RefusesDimsBelowOne) {
  for (int axis = 0; axis < 3; ++axis) {
    for (const int bad : {0, -1}) {
      VolumeGeometry geometry = makeGeometry();
      geometry.dims[axis] = bad;
      EXPECT_THROW(makeWith(geometry, 0), InputError);
    }
  }
}

TEST(Volume, RefusesDimsWhoseProductOverflows) {
  VolumeGeometry geometry = makeGeometry();
  geometry.dims = Vector3i::Constant(1 << 30);  // 2^90 bytes wrap around to 0
  EXPECT_THROW(makeWith(geometry, 0), InputError);
}

TEST(Volume, RefusesUnusableSpacing) {
  const double kInfinity = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    for (const double bad : {0.0, -1.0, std::nan(""), kInfinity}) {
      VolumeGeometry geometry = makeGeometry();
      geometry.spacing_m[axis] = bad;
      EXPECT_THROW(makeWith(geometry), InputError) << bad;
    }
  }
}

TEST(Volume, RefusesAnOriginThatIsNotFinite) {
  VolumeGeometry geometry = makeGeometry();
  geometry.origin_m.y() = std::nan("");
  EXPECT_THROW(makeWith(geometry), InputError);
}

TEST(Volume, RefusesADirectionThatIsNotOrthonormal) {
  for (const double bad : {0.01, std::nan("")}) {
    VolumeGeometry geometry = makeGeometry();
    geometry.direction(0, 0) += bad;
    EXPECT_THROW(makeWith(geometry), InputError) << bad;
  }
}

TEST(Volume, RefusesDataOfAnotherSize) {
  EXPECT_THROW(makeWith(makeGeometry(), 119), InputError);
  EXPECT_THROW(makeWith(makeGeometry(), 121), InputError);
}

TEST(Volume, RefusesAnUnknownScalarType) {
  EXPECT_THROW(scalarSize(static_cast<ScalarType>(8)), InputError);
  EXPECT_THROW(Volume(makeGeometry(), static_cast<ScalarType>(200), {}), InputError);
}

TEST(Volume, KnowsItsScalarTypes) {
  const std::array<std::size_t, 8> sizes = {1, 1, 2, 2, 4, 4, 4, 8};
  const std::array<std::string, 8> names = {"int8",  "uint8",  "int16",   "uint16",
                                            "int32", "uint32", "float32", "float64"};
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(scalarSize(static_cast<ScalarType>(i)), sizes[std::size_t(i)]);
    EXPECT_EQ(scalarName(static_cast<ScalarType>(i)), names[std::size_t(i)]);
  }
}

TEST(Volume, ReadsEveryVoxelAndClampsIndices) {
  const Volume volume = linearVolume<std::int16_t>();
  EXPECT_EQ(volume.at(0, 0, 0), 3.0);
  EXPECT_EQ(volume.at(4, 3, 2), 3.0 + 8.0 - 12.0 + 16.0);
  EXPECT_EQ(volume.at(-7, 0, 0), volume.at(0, 0, 0));
  EXPECT_EQ(volume.at(4, 99, 2), volume.at(4, 3, 2));
}

template <typename T>
class LinearField : public testing::Test {};
using SignedTypes = testing::Types<std::int8_t, std::int16_t, std::int32_t, float, double>;
TYPED_TEST_SUITE(LinearField, SignedTypes);

double linearAt(const Vector3& p) {  // 3 + 2 i - 4 j + 8 k with the spacing of makeGeometry
  return 3.0 + 2.0 * p.x() / 0.25 - 4.0 * p.y() / 0.5 + 8.0 * p.z() / 2.0;
}

TYPED_TEST(LinearField, IsSampledExactly) {
  const Volume volume = linearVolume<TypeParam>();
  for (double x = 0.0; x <= 1.0; x += 0.125) {
    for (double y = 0.0; y <= 1.5; y += 0.125) {
      for (double z = 0.0; z <= 4.0; z += 0.5) {
        EXPECT_EQ(volume.sample({x, y, z}), linearAt({x, y, z}));
      }
    }
  }
}

TYPED_TEST(LinearField, HasItsExactGradientInside) {
  const Volume volume = linearVolume<TypeParam>();
  const Vector3 expected(2.0 / 0.25, -4.0 / 0.5, 8.0 / 2.0);
  EXPECT_EQ(volume.gradient({0.5, 0.75, 2.0}), expected);
  EXPECT_EQ(volume.gradient({0.375, 0.625, 1.5}), expected);
}

TEST(Volume, SamplesOutsideLikeTheBorder) {
  const Volume volume = linearVolume<std::int16_t>();
  EXPECT_EQ(volume.sample({-1.0, 0.0, 0.0}), volume.at(0, 0, 0));
  EXPECT_EQ(volume.sample({99.0, 99.0, 99.0}), volume.at(4, 3, 2));
  EXPECT_EQ(volume.gradient({-9.0, -9.0, -9.0}), Vector3(0, 0, 0));
}

TEST(Volume, SamplesAnUnusablePositionWithoutReadingElsewhere) {
  const Volume volume = linearVolume<std::int16_t>();
  const double kInfinity = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(std::isfinite(volume.sample(Vector3::Constant(std::nan("")))));
  EXPECT_TRUE(std::isfinite(volume.sample(Vector3::Constant(1e300))));
  EXPECT_EQ(volume.sample(Vector3::Constant(kInfinity)), volume.at(4, 3, 2));
}

TEST(Volume, OfOneVoxelIsConstant) {
  VolumeGeometry geometry;
  geometry.dims = {1, 1, 1};
  const Volume volume(geometry, ScalarType::kUInt8, {42});
  EXPECT_EQ(volume.sample({0.3, -0.2, 5.0}), 42.0);
  EXPECT_EQ(volume.gradient({0, 0, 0}), Vector3(0, 0, 0));
}

TEST(Volume, KnowsItsRange) {
  EXPECT_EQ(linearVolume<std::int16_t>().range(), (std::array<double, 2>{-9.0, 27.0}));
  EXPECT_EQ(Volume().range(), (std::array<double, 2>{0.0, 0.0}));
}

TEST(Volume, LeavesWhatIsNotFiniteOutOfItsRange) {
  VolumeGeometry geometry;
  geometry.dims = {2, 2, 1};
  const float kInfinity = std::numeric_limits<float>::infinity();
  const Volume some(geometry, ScalarType::kFloat32, bytesOf<float>({std::nanf(""), -2.0F, kInfinity, 7.0F}));
  EXPECT_EQ(some.range(), (std::array<double, 2>{-2.0, 7.0}));
  EXPECT_TRUE(std::isnan(some.at(0, 0, 0)));
  const Volume none(geometry, ScalarType::kFloat32, bytesOf<float>(std::vector<float>(4, kInfinity)));
  EXPECT_EQ(none.range(), (std::array<double, 2>{0.0, 0.0}));
}

TEST(Volume, HasAHashOfGeometryTypeAndScalars) {
  const VolumeGeometry geometry = makeGeometry();
  const std::vector<std::uint8_t> data = bytesOf(linearValues<std::int16_t>(geometry));
  const std::uint64_t hash = Volume(geometry, ScalarType::kInt16, data).hash();
  EXPECT_EQ(hash, Volume(geometry, ScalarType::kInt16, data).hash());
  EXPECT_NE(hash, Volume(geometry, ScalarType::kUInt16, data).hash());
  std::vector<std::uint8_t> other_data = data;
  other_data[17] ^= 1;
  EXPECT_NE(hash, Volume(geometry, ScalarType::kInt16, other_data).hash());
  VolumeGeometry other = geometry;
  other.dims = {4, 5, 3};
  EXPECT_NE(hash, Volume(other, ScalarType::kInt16, data).hash());
  other = geometry;
  other.spacing_m.z() *= 1.0 + 1e-15;
  EXPECT_NE(hash, Volume(other, ScalarType::kInt16, data).hash());
  other = geometry;
  other.direction.col(0) *= -1.0;
  EXPECT_NE(hash, Volume(other, ScalarType::kInt16, data).hash());
}

TEST(Volume, HasTheSameHashForBothZeros) {
  VolumeGeometry geometry;
  geometry.dims = {1, 1, 1};
  const std::uint64_t hash = Volume(geometry, ScalarType::kUInt8, {1}).hash();
  geometry.origin_m = {-0.0, 0.0, -0.0};
  EXPECT_EQ(Volume(geometry, ScalarType::kUInt8, {1}).hash(), hash);
}

TEST(Region, KeepsValuesAndPatientCoordinates) {
  const Volume volume = linearVolume<std::int16_t>();
  const Vector3i begin(1, 0, 1), stride(2, 3, 1);
  const Volume part = volume.region(begin, {5, 4, 3}, stride);
  ASSERT_EQ(part.geometry().dims, Vector3i(2, 2, 2));
  for (int k = 0; k < 2; ++k) {
    for (int j = 0; j < 2; ++j) {
      for (int i = 0; i < 2; ++i) {
        const Vector3i whole = begin + Vector3i(i, j, k).cwiseProduct(stride);
        EXPECT_EQ(part.at(i, j, k), volume.at(whole.x(), whole.y(), whole.z()));
        const Vector3 in_part = part.geometry().spacing_m.cwiseProduct(Vector3(i, j, k));
        const Vector3 in_whole = volume.geometry().spacing_m.cwiseProduct(whole.cast<double>());
        EXPECT_EQ(toPatient(part.geometry(), in_part), toPatient(volume.geometry(), in_whole));
      }
    }
  }
}

TEST(Region, OfTheWholeVolumeIsTheVolume) {
  const Volume volume = linearVolume<float>();
  EXPECT_EQ(volume.region({0, 0, 0}, {5, 4, 3}, {1, 1, 1}).hash(), volume.hash());
}

TEST(Region, LargerStrideThanRegionKeepsOneVoxel) {
  const Volume part = linearVolume<double>().region({2, 1, 0}, {4, 3, 3}, {10, 10, 10});
  EXPECT_EQ(part.geometry().dims, Vector3i(1, 1, 1));
  EXPECT_EQ(part.at(0, 0, 0), 3.0 + 4.0 - 4.0);
}

TEST(Region, OutsideOrEmptyIsRefused) {
  const Volume volume = linearVolume<std::int16_t>();
  const Vector3i one(1, 1, 1);
  EXPECT_THROW(volume.region({-1, 0, 0}, {5, 4, 3}, one), InputError);
  EXPECT_THROW(volume.region({0, 0, 0}, {5, 5, 3}, one), InputError);
  EXPECT_THROW(volume.region({0, 2, 0}, {5, 2, 3}, one), InputError);
  EXPECT_THROW(volume.region({0, 3, 0}, {5, 2, 3}, one), InputError);
  EXPECT_THROW(volume.region({0, 0, 0}, {5, 4, 3}, {1, 0, 1}), InputError);
}

TEST(VolumeGeometry, TextureCoordinatesGoThereAndBack) {
  const VolumeGeometry geometry = makeGeometry();
  EXPECT_EQ(geometry.toTexture({0, 0, 0}), Vector3(0.1, 0.125, 0.5 / 3.0));
  const Vector3 p(0.3, 0.7, 1.1);
  EXPECT_LT((geometry.fromTexture(geometry.toTexture(p)) - p).norm(), 1e-15);
  EXPECT_EQ(geometry.bounds().max(), Vector3(4.5 * 0.25, 3.5 * 0.5, 2.5 * 2.0));
}

}  // namespace
}  // namespace soft_volume::core
