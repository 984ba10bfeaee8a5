#include "video.h"

#include <cmath>
#include <csignal>

#include "findings.h"
#include "frame_source.h"
#include "progress_bar.h"
#include "soft_volume/replay/recorded_run.h"

namespace soft_volume::replay_program {
namespace {

constexpr int kShellFindsNoProgram = 127 << 8;  // as pclose() returns it

/// As one word of a shell.
std::string quoted(const std::string& text) {
  std::string word = "'";
  for (const char c : text)
    word += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return word + "'";
}

/// A path that is no option.
std::string asPath(const std::string& path) {
  return path[0] == '-' ? "./" + path : path;
}

std::string command(const std::string& path, int width, int height) {
  const std::string size = std::to_string(width) + "x" + std::to_string(height);
  return "exec ffmpeg -v error -y -f rawvideo -pix_fmt rgb24 -s " + size + " -r " +
         std::to_string(int(VideoFile::kRate_hz)) +
         " -i - -c:v libx264 -crf 20 -vf 'pad=ceil(iw/2)*2:ceil(ih/2)*2' -pix_fmt yuv420p -movflags +faststart " +
         quoted(asPath(path));
}

}  // namespace

VideoFile::VideoFile(const std::string& path, int width, int height) : path_(path), shown_{width, height, {}} {
  std::signal(SIGPIPE, SIG_IGN);  // an ffmpeg that ends early must not end us; the process is this work's alone
  ffmpeg_ = popen(command(path, width, height).c_str(), "w");
  if (ffmpeg_ == nullptr)
    throw ReplayError("ffmpeg cannot be started for lack of memory or processes");
}

VideoFile::~VideoFile() {
  if (ffmpeg_ != nullptr)
    pclose(ffmpeg_);
}

void VideoFile::fail(int status) const {
  if (status == kShellFindsNoProgram)
    throw ReplayError("ffmpeg is missing: install it (on Debian the package ffmpeg), or make no video");
  throw ReplayError(path_ + ": ffmpeg could not make the video; its own message is above. Is the folder writable?");
}

void VideoFile::write(const core::Image& image) {
  ++written_;
  if (std::fwrite(image.rgb.data(), 1, image.rgb.size(), ffmpeg_) == image.rgb.size())
    return;
  FILE* ended = ffmpeg_;
  ffmpeg_ = nullptr;
  fail(pclose(ended));
}

void VideoFile::add(double time_s, const core::Image& image) {
  if (image.width != shown_.width || image.height != shown_.height)
    throw ReplayError(path_ + ": the frames of a video must have one size");
  if (shown_.rgb.empty())
    begin_s_ = time_s;
  const long until = std::lround((time_s - begin_s_) * kRate_hz);
  while (!shown_.rgb.empty() && written_ < until)
    write(shown_);
  shown_ = image;
}

void VideoFile::finish() {
  if (!shown_.rgb.empty())
    write(shown_);
  FILE* ended = ffmpeg_;
  ffmpeg_ = nullptr;
  if (const int status = pclose(ended); status != 0)
    fail(status);
}

void video(const Arguments& arguments, Findings& findings) {
  if (arguments.video.empty())
    return;
  const RecordedBag bag(arguments.bag);
  const std::vector<ShownFrame> frames = framesOfVideo(bag.longest(), findings, arguments.threads);
  if (frames.empty())
    throw ReplayError(arguments.bag + ": there is no frame to make a video of; --render draws some");
  core::ProgressBar bar(arguments.no_progress);
  const core::Image first = frames.front().image();
  VideoFile file(arguments.video, first.width, first.height);
  for (std::size_t n = 0; n < frames.size(); ++n) {
    file.add(frames[n].time_s, frames[n].image());
    bar.update(double(n + 1), double(frames.size()));
  }
  file.finish();
  std::printf("  %s: %zu frames, %.2f s\n", arguments.video.c_str(), frames.size(),
              frames.back().time_s - frames.front().time_s);
}

}  // namespace soft_volume::replay_program
