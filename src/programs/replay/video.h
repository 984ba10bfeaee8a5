#pragma once

#include <cstdio>
#include <string>

#include "soft_volume/render/image_io.h"

namespace soft_volume::replay_program {

/// An MP4 (H.264) that ffmpeg makes of pictures of one size.
class VideoFile {
 public:
  static constexpr double kRate_hz = 30.0;

  /// Throws ReplayError when no process can be started.
  VideoFile(const std::string& path, int width, int height);
  /// Leaves an incomplete file when finish() was not called.
  ~VideoFile();
  VideoFile(const VideoFile&) = delete;
  VideoFile& operator=(const VideoFile&) = delete;

  /// Shows a picture from a time on, until the next one; times must not decrease. Throws ReplayError when ffmpeg ended
  /// or the picture has another size.
  void add(double time_s, const core::Image& image);
  /// Throws ReplayError when ffmpeg is missing or could not write the file.
  void finish();

 private:
  void write(const core::Image& image);
  [[noreturn]] void fail(int status) const;

  std::string path_;
  FILE* ffmpeg_ = nullptr;
  core::Image shown_;
  double begin_s_ = 0.0;
  long written_ = 0;
};

}  // namespace soft_volume::replay_program
