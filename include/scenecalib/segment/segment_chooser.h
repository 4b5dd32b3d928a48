#pragma once

#include <optional>
#include <string>
#include <vector>

#include "scenecalib/base/options.h"
#include "scenecalib/sensor/measurements.h"

namespace scenecalib {

/// Which stretches of a long recording are worth calibrating on (IV).
struct SegmentChoiceOptions {
  int max_segments = 5;
  double max_length_m = 1000.0;
  double min_recording_m = 2000.0;
  double bin_length_m = 10.0;
  double max_bin_duration_s = 10.0;
  int max_bins = 20000;
  double max_gap_s = 1.0;
  double turn_deg_m = 1.0;
  double tilt_deg_m = 0.1;
  double acceleration_m_s2 = 1.0;

  void Visit(OptionVisitor& v) {
    v.Field("max_segments", &max_segments, {1, 100}, "stretches chosen");
    v.Field("max_length_m", &max_length_m, {20.0, 1e5}, "of one stretch");
    v.Field("min_recording_m", &min_recording_m, {0.0, 1e9},
            "a shorter recording is used as a whole");
    v.Field("bin_length_m", &bin_length_m, {0.5, 1000.0}, "stretches are put together from these");
    v.Field("max_bin_duration_s", &max_bin_duration_s, {0.1, 1000.0},
            "a bin ends after this time too; what did not get half of its length is standing");
    v.Field("max_bins", &max_bins, {100, 10000000},
            "at this bound two neighbouring bins become one: memory does not grow further");
    v.Field("max_gap_s", &max_gap_s, {0.01, 100.0}, "no stretch goes over a longer gap");
    v.Field("turn_deg_m", &turn_deg_m, {1e-3, 90.0},
            "turning per metre that counts in full; more counts no more");
    v.Field("tilt_deg_m", &tilt_deg_m, {1e-3, 90.0}, "the same of pitch and roll");
    v.Field("acceleration_m_s2", &acceleration_m_s2, {1e-3, 100.0},
            "change of speed along the drive that counts in full");
  }
};

/// A stretch of driving and what it offers.
struct DriveSegment {
  Timestamp start_ns = 0;
  Timestamp end_ns = 0;
  double length_m = 0.0;
  double turn_rad = 0.0;  ///< sum of the turns' sizes
  double score = 0.0;     ///< metres that count in full, of turning, tilt and speed change
  std::string Description() const;  ///< for a person
};

/// Scans ego-motion as it comes and names the stretches with most excitation: turns (left and right
/// cancel nothing), pitch and roll, changes of speed. Needs neither images nor scans. Keeps one
/// record per bin, so that an hour of driving takes about a megabyte; at the bound bins are merged.
class SegmentChooser {
 public:
  explicit SegmentChooser(const SegmentChoiceOptions& options) : options_(options) {}

  /// Poses of a dead-reckoned body, in order; one whose stamp does not increase is skipped.
  void Add(const OdometrySample& sample);

  /// Metres driven so far.
  double path_length_m() const { return path_length_m_; }
  int num_bins() const { return static_cast<int>(bins_.size()); }

  /// Up to max_segments stretches that do not overlap, the best first. Empty when the recording is
  /// shorter than min_recording_m.
  std::vector<DriveSegment> Choose() const;

 private:
  struct Bin {
    Timestamp start_ns = 0;
    Timestamp end_ns = 0;
    double length_m = 0.0;
    double turn_rad = 0.0;
    double tilt_rad = 0.0;
    double speed_change_m_s = 0.0;
    bool after_gap = false;  ///< not joined to the bin before
  };
  void CloseBin();
  void MergeNeighbours();
  double Score(const Bin& bin) const;

  SegmentChoiceOptions options_;
  std::optional<OdometrySample> last_;
  double last_speed_m_s_ = 0.0;
  bool has_speed_ = false;
  double path_length_m_ = 0.0;
  double bin_length_m_ = 0.0;  ///< grows at the bound
  Bin open_;
  bool is_open_ = false;
  std::vector<Bin> bins_;
};

}  // namespace scenecalib
