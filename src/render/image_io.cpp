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
  return difference;
}

}  // namespace soft_volume::core
