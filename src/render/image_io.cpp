#include "soft_volume/render/image_io.h"

#include <png.h>
#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void requireImage(const Image& image) {
  const bool positive = image.width > 0 && image.height > 0;
  if (positive && image.rgb.size() == std::size_t(image.width) * std::size_t(image.height) * 3)
    return;
  throw InputError("the image is empty or its size does not match its pixels");
}

/// libpng's simple interface; frees what reading has left on every path.
struct PngImage : png_image {
  PngImage() : png_image() { version = PNG_IMAGE_VERSION; }
  ~PngImage() { png_image_free(this); }
  PngImage(const PngImage&) = delete;
  PngImage& operator=(const PngImage&) = delete;
};

constexpr int kSsimWindow = 7;

/// Sums over pixels of two images; whole numbers, so that a window may slide without rounding.
struct PixelSums {
  std::int64_t a = 0;
  std::int64_t b = 0;
  std::int64_t aa = 0;
  std::int64_t bb = 0;
  std::int64_t ab = 0;

  void add(std::int64_t level_a, std::int64_t level_b, std::int64_t sign) {
    a += sign * level_a;
    b += sign * level_b;
    aa += sign * level_a * level_a;
    bb += sign * level_b * level_b;
    ab += sign * level_a * level_b;
  }
  void add(const PixelSums& other, std::int64_t sign) {
    a += sign * other.a;
    b += sign * other.b;
    aa += sign * other.aa;
    bb += sign * other.bb;
    ab += sign * other.ab;
  }
};

/// Of one window of `count` pixels.
double ssimOf(const PixelSums& sums, double count) {
  constexpr double kC1 = (0.01 * 255.0) * (0.01 * 255.0);
  constexpr double kC2 = (0.03 * 255.0) * (0.03 * 255.0);
  const double mean_a = double(sums.a) / count;
  const double mean_b = double(sums.b) / count;
  const double unbiased = std::max(count - 1.0, 1.0);
  const double variances = (double(sums.aa + sums.bb) - count * (mean_a * mean_a + mean_b * mean_b)) / unbiased;
  const double covariance = (double(sums.ab) - count * mean_a * mean_b) / unbiased;
  return (2.0 * mean_a * mean_b + kC1) * (2.0 * covariance + kC2) /
         ((mean_a * mean_a + mean_b * mean_b + kC1) * (variances + kC2));
}

/// The sum of ssimOf() over one row of windows, whose columns are summed up already.
double ssimOfRow(const std::vector<PixelSums>& columns, int across, double count) {
  PixelSums window;
  double sum = 0.0;
  for (int u = 0; u < int(columns.size()); ++u) {
    window.add(columns[u], 1);
    if (u >= across)
      window.add(columns[u - across], -1);
    if (u >= across - 1)
      sum += ssimOf(window, count);
  }
  return sum;
}

double meanSsim(const Image& a, const Image& b, int channel) {
  const int across = std::min(kSsimWindow, a.width);
  const int down = std::min(kSsimWindow, a.height);
  std::vector<PixelSums> columns(a.width);
  const auto addRow = [&](int v, int sign) {
    for (int u = 0; u < a.width; ++u) {
      const std::size_t index = (std::size_t(v) * std::size_t(a.width) + std::size_t(u)) * 3 + std::size_t(channel);
      columns[u].add(a.rgb[index], b.rgb[index], sign);
    }
  };
  double sum = 0.0;
  for (int v = 0; v < a.height; ++v) {
    addRow(v, 1);
    if (v >= down)
      addRow(v - down, -1);
    if (v >= down - 1)
      sum += ssimOfRow(columns, across, double(across) * down);
  }
  return sum / (double(a.width - across + 1) * double(a.height - down + 1));
}

}  // namespace

void writePng(const std::string& path, const Image& image) {
  requireImage(image);
  PngImage png;
  png.width = png_uint_32(image.width);
  png.height = png_uint_32(image.height);
  png.format = PNG_FORMAT_RGB;
  if (png_image_write_to_file(&png, path.c_str(), 0, image.rgb.data(), 0, nullptr) == 0) {
    throw FileError(path + ": cannot write the PNG: " + png.message);
  }
}

void writePng16(const std::string& path, int width, int height, const std::vector<std::uint16_t>& pixels) {
  if (width < 1 || height < 1 || pixels.size() != std::size_t(width) * std::size_t(height))
    throw InputError("the image is empty or its size does not match its pixels");
  PngImage png;
  png.width = png_uint_32(width);
  png.height = png_uint_32(height);
  png.format = PNG_FORMAT_LINEAR_Y;
  if (png_image_write_to_file(&png, path.c_str(), 0, pixels.data(), 0, nullptr) == 0) {
    throw FileError(path + ": cannot write the PNG: " + png.message);
  }
}

Image readPng(const std::string& path) {
  PngImage png;
  if (png_image_begin_read_from_file(&png, path.c_str()) == 0) {
    throw FileError(path + ": cannot read the PNG: " + png.message);
  }
  png.format = PNG_FORMAT_RGBA;
  std::vector<std::uint8_t> rgba(PNG_IMAGE_SIZE(png));
  if (png_image_finish_read(&png, nullptr, rgba.data(), 0, nullptr) == 0) {
    throw FileError(path + ": cannot read the PNG: " + png.message);
  }
  Image image{int(png.width), int(png.height), std::vector<std::uint8_t>(rgba.size() / 4 * 3)};
  for (std::size_t pixel = 0; pixel < rgba.size() / 4; ++pixel) {
    std::copy_n(&rgba[pixel * 4], 3, &image.rgb[pixel * 3]);
  }
  return image;
}

std::vector<std::uint8_t> encodeJpeg(const Image& image, int quality) {
  requireImage(image);
  if (quality < 1 || quality > 100) {
    throw InputError("JPEG quality is " + std::to_string(quality) + ", use 1 to 100");
  }
  const std::unique_ptr<void, int (*)(tjhandle)> encoder(tjInitCompress(), tjDestroy);
  std::vector<std::uint8_t> jpeg(tjBufSize(image.width, image.height, TJSAMP_420));
  unsigned char* target = jpeg.data();
  unsigned long size = jpeg.size();
  if (!encoder || tjCompress2(encoder.get(), image.rgb.data(), image.width, 0, image.height, TJPF_RGB, &target, &size,
                              TJSAMP_420, quality, TJFLAG_NOREALLOC) != 0) {
    throw InputError(std::string("cannot encode the JPEG: ") + tjGetErrorStr2(encoder.get()));
  }
  jpeg.resize(size);
  return jpeg;
}

ImageDifference compareImages(const Image& a, const Image& b) {
  requireImage(a);
  requireImage(b);
  if (a.width != b.width || a.height != b.height)
    throw InputError("the images to compare have different sizes");
  ImageDifference difference;
  double squares = 0.0;
  for (std::size_t pixel = 0; pixel < a.rgb.size(); pixel += 3) {
    int largest = 0;
    for (std::size_t i = pixel; i < pixel + 3; ++i) {
      const int level = std::abs(int(a.rgb[i]) - int(b.rgb[i]));
      squares += double(level) * level;
      largest = std::max(largest, level);
    }
    difference.largest = std::max(difference.largest, largest);
    if (largest > 0)
      ++difference.pixels;
  }
  difference.rmse = std::sqrt(squares / double(a.rgb.size()));
  difference.psnr_db = 20.0 * std::log10(255.0 / difference.rmse);
  if (difference.largest > 0)
    difference.ssim = (meanSsim(a, b, 0) + meanSsim(a, b, 1) + meanSsim(a, b, 2)) / 3.0;
  return difference;
}

}  // namespace soft_volume::core
