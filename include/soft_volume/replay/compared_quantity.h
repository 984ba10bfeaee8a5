#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace soft_volume {

/// Recordings whose ends are no farther apart hold the same time: a run in lockstep ends some samples earlier.
constexpr double kSameDuration_s = 0.1;

/// Two runs at one simulated time.
struct ComparedSample {
  double time_s = 0.0;
  double first = 0.0;    ///< in the first run: largest displacement, size of a force, an energy; of images 0
  double second = 0.0;   ///< in the second
  double rms = 0.0;      ///< of the differences at this time; of ssim the index itself
  double largest = 0.0;  ///< of the differences at this time; of ssim the index itself
};

/// One quantity of two runs over simulated time.
///
/// | key          | unit     | subject      | what differs                                                            |
/// |--------------|----------|--------------|-------------------------------------------------------------------------|
/// | positions    | m        |              | places of material points; RMS over those that moved                    |
/// | force        | N        | tool         | force that the tissue feels                                             |
/// | device_force | N        | topic        | force sent to the device                                                |
/// | image_rmse   | levels   | camera       | RMSE of two frames, 0 to 255                                            |
/// | ssim         |          | camera       | structural similarity of two frames (image_io.h), 1: the same           |
/// | energy       | J        | kind         | kinetic and elastic energy                                              |
/// | cut_area     | m^2      |              | area at rest of what blades opened, one side                            |
/// | parts        |          |              | parts that the tissue fell into                                         |
/// | revision     |          |              | revisions of the topology                                               |
/// | active_cells |          |              | cells in the solve                                                      |
/// | step_time    | ms       |              | wall time of a step                                                     |
/// | duration     | s        |              | simulated time at the begin and the end that only one run holds         |
struct ComparedQuantity {
  std::string key;
  std::string subject;  ///< as above; empty for the whole run
  std::string title;    ///< in words
  std::string unit;
  std::size_t run = 0;   ///< which session of the bags, from 0
  double rms = 0.0;      ///< of the differences of all times; of ssim the mean index
  double largest = 0.0;  ///< of the differences of all times; of ssim the lowest index
  double largest_at_s = 0.0;
  double scale = 0.0;           ///< largest value of both runs, which relative limits refer to
  std::uint64_t compared = 0;   ///< vertices, values or frames, summed over time
  std::uint64_t left_out = 0;   ///< that have no counterpart
  std::string left_out_reason;  ///< empty when nothing was
  bool identical = true;        ///< bit for bit, as far as compared
  bool reproducible = true;     ///< false: wall times, which no two runs share; told, never judged bit for bit
  std::vector<ComparedSample> samples;

  /// Keeps a sample of `things` that were compared; the RMS counts `sum.count` of them.
  struct Squares {
    double sum = 0.0;
    std::uint64_t count = 0;
  };
  void add(const ComparedSample& sample, std::uint64_t things, const Squares& squares);
  /// Of a single value at a time.
  void addValues(double time_s, double first, double second, double apart);
  /// Of ssim: the index of one pair of frames.
  void addIndex(double time_s, double index);

 private:
  Squares squares_;
};

}  // namespace soft_volume
