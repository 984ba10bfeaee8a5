#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace soft_volume::core {

/// An 8-bit colour image: rows from the top, pixels from the left, red, green, blue. As sensor_msgs' rgb8.
struct Image {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgb;  ///< width * height * 3
};

/// Writes an 8-bit RGB PNG. Throws FileError.
void writePng(const std::string& path, const Image& image);
/// Writes a 16-bit grey PNG whose pixels are the numbers as they are; width * height of them. Throws FileError, and
/// InputError when their count does not match.
void writePng16(const std::string& path, int width, int height, const std::vector<std::uint16_t>& pixels);
/// Reads any PNG as 8-bit RGB; alpha is dropped. Throws FileError.
Image readPng(const std::string& path);

/// A JPEG file in memory, 4:2:0. `quality` is 1 to 100; throws InputError outside, and on an empty image.
std::vector<std::uint8_t> encodeJpeg(const Image& image, int quality);

/// How far two images are apart, over all pixels and channels in 8-bit levels.
struct ImageDifference {
  double rmse = 0.0;
  double psnr_db = 0.0;  ///< infinite when the images are the same
  int largest = 0;
  std::size_t pixels = 0;  ///< that differ in any channel
  /// Structural similarity, 1 when the images are the same: mean SSIM of Wang et al. (2004) over windows of 7 x 7
  /// pixels that lie in the image, of equal weights and with the sample covariance, K1 = 0.01, K2 = 0.03, averaged over
  /// the channels: scikit-image's default. Windows of smaller images are as large as the image.
  double ssim = 1.0;
};
/// Throws InputError when the sizes differ or an image is empty.
ImageDifference compareImages(const Image& a, const Image& b);

}  // namespace soft_volume::core
