#include "soft_volume/render/image_io.h"

#include <gtest/gtest.h>
#include <png.h>
#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <vector>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

/// Smooth in x and y, different in every channel.
Image makeImage(int width, int height) {
  Image image{width, height, {}};
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      for (const int level : {u * 255 / width, v * 255 / height, (u + v) * 255 / (width + height)}) {
        image.rgb.push_back(std::uint8_t(level));
      }
    }
  }
  return image;
}

std::string temporaryPath(const std::string& name) {
  return testing::TempDir() + "soft_volume_image_io_" + name;
}

TEST(Png, KeepsEveryPixel) {
  const std::string path = temporaryPath("keeps.png");
  const Image image = makeImage(37, 23);
  writePng(path, image);
  const Image back = readPng(path);
  EXPECT_EQ(back.width, 37);
  EXPECT_EQ(back.height, 23);
  EXPECT_EQ(back.rgb, image.rgb);
  std::remove(path.c_str());
}

/// The numbers are labels or depths, so no display curve may touch them.
TEST(Png, Keeps16BitsOfGrey) {
  const std::string path = temporaryPath("grey16.png");
  const std::vector<std::uint16_t> pixels = {0, 1, 255, 256, 30000, 65535};
  writePng16(path, 3, 2, pixels);
  std::ifstream file(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  EXPECT_EQ(bytes[24], 16);  // IHDR: bits of a channel
  EXPECT_EQ(bytes[25], 0);   // IHDR: grey without alpha
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  ASSERT_NE(png_image_begin_read_from_file(&png, path.c_str()), 0);
  png.format = PNG_FORMAT_LINEAR_Y;
  std::vector<std::uint16_t> back(6);
  ASSERT_NE(png_image_finish_read(&png, nullptr, back.data(), 0, nullptr), 0);
  EXPECT_EQ(back, pixels);
  EXPECT_THROW(writePng16(path, 2, 2, pixels), InputError);
  EXPECT_THROW(writePng16(path, 0, 0, {}), InputError);
  EXPECT_THROW(writePng16("/no/such/folder/a.png", 3, 2, pixels), FileError);
  std::remove(path.c_str());
}

TEST(Png, ErrorsNameTheFile) {
  const Image image = makeImage(8, 8);
  EXPECT_THROW(writePng("/no/such/folder/a.png", image), FileError);
  EXPECT_THROW(readPng("/no/such/folder/a.png"), FileError);
  EXPECT_THROW(writePng(temporaryPath("empty.png"), Image{}), InputError);
  const std::string path = temporaryPath("truncated.png");
  writePng(path, image);
  std::ifstream file(path, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  std::ofstream(path, std::ios::binary) << bytes.substr(0, bytes.size() / 2);
  try {
    readPng(path);
    FAIL() << "a truncated file was read";
  } catch (const FileError& error) {
    EXPECT_EQ(std::string(error.what()).find(path), 0U);
  }
  std::remove(path.c_str());
}

TEST(Jpeg, DecodesToNearlyTheSamePixels) {
  const Image image = makeImage(64, 48);
  std::vector<std::uint8_t> jpeg = encodeJpeg(image, 90);
  Image back{64, 48, std::vector<std::uint8_t>(image.rgb.size())};
  tjhandle decoder = tjInitDecompress();
  ASSERT_EQ(tjDecompress2(decoder, jpeg.data(), jpeg.size(), back.rgb.data(), 64, 0, 48, TJPF_RGB, 0), 0);
  tjDestroy(decoder);
  EXPECT_GT(compareImages(image, back).psnr_db, 38.0);
  EXPECT_LT(encodeJpeg(image, 20).size(), jpeg.size());
}

TEST(Jpeg, RefusesUnusableInput) {
  const Image image = makeImage(8, 8);
  EXPECT_THROW(encodeJpeg(image, 0), InputError);
  EXPECT_THROW(encodeJpeg(image, 101), InputError);
  EXPECT_THROW(encodeJpeg(Image{8, 8, {}}, 80), InputError);
}

TEST(CompareImages, MeasuresKnownDifferences) {
  const Image image = makeImage(10, 10);
  EXPECT_EQ(compareImages(image, image).rmse, 0.0);
  EXPECT_TRUE(std::isinf(compareImages(image, image).psnr_db));
  Image other = image;
  other.rgb[30] = std::uint8_t(other.rgb[30] ^ 0x10);
  const ImageDifference difference = compareImages(image, other);
  EXPECT_EQ(difference.pixels, 1U);
  EXPECT_EQ(difference.largest, 16);
  EXPECT_NEAR(difference.rmse, 16.0 / std::sqrt(300.0), 1e-12);
  EXPECT_NEAR(difference.psnr_db, 20.0 * std::log10(255.0 * std::sqrt(300.0) / 16.0), 1e-9);
  EXPECT_THROW(compareImages(image, makeImage(10, 11)), InputError);
}

/// `change(level, index)` of every byte.
template <typename Change>
Image changed(Image image, const Change& change) {
  for (std::size_t i = 0; i < image.rgb.size(); ++i)
    image.rgb[i] = std::uint8_t(std::clamp(change(int(image.rgb[i]), int(i)), 0, 255));
  return image;
}

/// The numbers are those of scikit-image 0.19.3: structural_similarity(a, b, channel_axis=2, data_range=255).
TEST(CompareImages, HasTheStructuralSimilarityOfScikitImage) {
  const Image image = makeImage(37, 23);
  EXPECT_EQ(compareImages(image, image).ssim, 1.0);
  const Image brighter = changed(image, [](int level, int) { return level + 20; });
  EXPECT_NEAR(compareImages(image, brighter).ssim, 0.9759080866070096, 1e-12);
  const Image noisy = changed(image, [](int level, int i) { return level + i * 7919 % 41 - 20; });
  EXPECT_NEAR(compareImages(image, noisy).ssim, 0.7840559573696405, 1e-12);
  EXPECT_NEAR(compareImages(noisy, image).ssim, 0.7840559573696405, 1e-12);
  const Image negative = changed(image, [](int level, int) { return 255 - level; });
  EXPECT_NEAR(compareImages(image, negative).ssim, -0.5583403131442485, 1e-12);
}

TEST(CompareImages, HasAStructuralSimilarityOfTinyImages) {
  const Image image = makeImage(1, 1);
  const Image other = changed(image, [](int level, int) { return level + 51; });
  const double c1 = 2.55 * 2.55;
  EXPECT_NEAR(compareImages(image, other).ssim, c1 / (51.0 * 51.0 + c1), 1e-12);
  EXPECT_LT(compareImages(makeImage(5, 40), changed(makeImage(5, 40), [](int l, int) { return 255 - l; })).ssim, 0.0);
}

}  // namespace
}  // namespace soft_volume::core
